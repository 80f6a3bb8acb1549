"""Online filter for apps that push samples as they arrive."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.filter.chain.handler import states_of
from pdr_filter.filter.chain.with_path import for_saving
from pdr_filter.filter.pedestrian import pedestrian_state as pedestrian
from pdr_filter.filter.pedestrian.pedestrian_state import StepUpdate
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.recipes.config import Config, check_config
from pdr_filter.sensing.clock import on_track_clock
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.features.barometer import checked_pressure
from pdr_filter.sensing.stream_merging import SENSORS, Sensor
from pdr_filter.tracking.extrapolation import Now, now
from pdr_filter.tracking.filtering import (
    Output,
    State,
    add_fixes,
    add_location,
    add_pressure,
    check_unfinished,
    estimate_on_plan,
    finish_filter,
    init_filter,
    outcome_now,
    person_of,
    present_position,
    timing_error,
    update_filter,
    update_streams,
)
from pdr_filter.tracking.walked_path import WalkedPath, walked_path
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import (
    Fix,
    FixResult,
    FloatArray,
    ImuBlock,
    OnPlan,
    Origin,
    Plan,
    PositionFix,
    Samples,
    as_floats,
    check_fix,
    median,
)
from pdr_filter.values import serialisation as serialise
from pdr_filter.values.fixes import OWN_FIXES
from pdr_filter.values.georeference import Georeference
from pdr_filter.values.limits import MIN_SAMPLES
from pdr_filter.values.plausibility import unit_of_rate, wrong_rate, wrong_time
from pdr_filter.values.recording import Subject


class OnlineFilter:
    """Online filter: takes blocks of samples of any length and returns the steps they complete.

    One filter serves one pedestrian and must be used by one thread at a time.

    Parameters
    ----------
    config : Config, optional
        Configuration, as returned by a recipe. The default is the default recipe.
    height_m : float, optional
        Height of the person for the default recipe, m. Not allowed together with `config`.
    plan : FloorPlan, optional
        Floor plan that constrains the track to walkable areas.
    start : PositionFix or str, optional
        Start of the walk on the plan: a position, the name of an area, or "anywhere". The default is the position from
        the fixes, or the origin of the plan, facing its north.
    weighting : {"imm", "wc", "hc"}, optional
        Combination of the context probabilities into step lengths: interacting multiple model, weighted context or
        highest context. The default is the weighting of the configuration.

    Attributes
    ----------
    config : Config
        Configuration in use, with plan, start and weighting.
    state : State
        State of the filter. It is immutable and replaced by every method that takes data.

    Raises
    ------
    ValueError
        If the arguments contradict each other.

    See Also
    --------
    pdr_filter.track : Track of a whole recording, with results identical to this filter.

    Examples
    --------
    An app pushes blocks of any length, adds a fix when it arrives, and shows `now`:

    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> samples = pdr.merge_streams(pdr.simulate.demo_walk())
    >>> online = pdr.OnlineFilter()
    >>> updates = []
    >>> for i in range(0, len(samples.time_s), 37):
    ...     block = slice(i, i + 37)
    ...     updates += online.push(
    ...         samples.time_s[block], samples.specific_force_mps2[block], samples.angular_rate_radps[block]
    ...     )
    ...     if i == 37 * 160:
    ...         fix = pdr.PositionFix(online.now().time_s, (35.0, 27.0), 2.0**2 * np.eye(2))
    ...         result = online.add_fix(fix)  # "waiting" for the step at its time
    >>> updates += online.finish()  # when no more samples come
    >>> len(updates) > 100, result.outcome, online.now().fixes[-1].outcome
    (True, 'waiting', 'used')
    >>> online.now().position_m.shape, online.now().position_cov_m2.shape
    ((2,), (2, 2))
    """

    def __init__(
        self,
        config: Config | None = None,
        *,
        height_m: float | None = None,
        plan: Plan | None = None,
        start: PositionFix | str | None = None,
        weighting: str | None = None,
    ) -> None:
        if config is None:
            from pdr_filter import recipes

            config = recipes.default(Subject(height_m=height_m))
        elif height_m is not None:
            raise ValueError(
                f"height_m is for the default recipe, got {height_m} together with a config: pass the height to the "
                "recipe that makes the config, such as recipes.default(Subject(height_m=...))"
            )
        check_config(config)
        config = config.with_georeference(Georeference(plan=plan, start=start))
        self.config = config if weighting is None else config.with_weighting(weighting)
        self.state = init_filter(self.config)

    @property
    def state(self) -> State:
        """State of the filter after all samples."""
        if self._waiting:
            self.state, _ = update_filter(self.config, self._state, self._with_waiting(), provisional=True)
        return self._state

    @state.setter
    def state(self, state: State) -> None:
        """Replace the state. Samples that wait are part of the earlier state, and are dropped."""
        self._state: State = state
        # Samples (N, 10) whose processing would complete no hop. Each costs some microseconds here, and together they
        # cost as much as one. They are immutable, so that copies of the filter can share them.
        self._waiting: tuple[FloatArray, ...] = ()
        is_merged = not (state.finished or state.waiting_fixes or state.merger.has_received)
        quiet = self.config.sensing.conditioner.quiet_s(state.sensing.conditioner) if is_merged else (np.inf, -np.inf)
        self._after_s, self._until_s = quiet

    def _waits(self, block: ImuBlock) -> bool:
        """Return True if a block completes no hop, and store its samples."""
        time_s = block.time_s
        n = len(time_s)
        if not n or not self._after_s < time_s[0] <= time_s[-1] <= self._until_s:
            return False
        if n > 1 and not (time_s[1:] > time_s[:-1]).all():
            return False
        rows = np.empty((n, 10))
        rows[:, 0], rows[:, 1:4] = time_s, block.specific_force_mps2
        rows[:, 4:7], rows[:, 7:] = block.angular_rate_radps, block.magnetic_field_ut
        self._waiting = (*self._waiting, rows)
        self._after_s = time_s[-1]
        return True

    def _with_waiting(self, *blocks: ImuBlock) -> ImuBlock:
        """Return the samples that wait, and the blocks after them, as one block."""
        rows = np.concatenate(self._waiting)
        parts = ImuBlock(rows[:, 0], rows[:, 1:4], rows[:, 4:7], rows[:, 7:]), *blocks
        columns = [(b.time_s, b.specific_force_mps2, b.angular_rate_radps, b.magnetic_field_ut) for b in parts]
        return ImuBlock(*map(np.concatenate, zip(*columns, strict=True)))

    def __repr__(self) -> str:
        now = self.now()
        so_far = f"{now.n_steps} steps, {now.distance_m:.1f} m" if now.n_steps else "no steps"
        return f"OnlineFilter({self.config!r}, {so_far})"

    def push(
        self,
        time_s: ArrayLike,
        specific_force_mps2: ArrayLike,
        angular_rate_radps: ArrayLike | None = None,
        magnetic_field_ut: ArrayLike | None = None,
    ) -> list[StepUpdate]:
        """Process merged samples of all sensors and return the steps that they complete.

        Use either this method or the methods for single sensors (`push_accelerometer`, `push_streams`), not both.

        Parameters
        ----------
        time_s : array_like, shape (N,)
            Increasing times, s. Samples with a repeated or earlier time are dropped and counted.
        specific_force_mps2 : array_like, shape (N, 3)
            Accelerometer in the sensor frame, m/s^2: +9.81 on z for a phone lying face up.
        angular_rate_radps : array_like, shape (N, 3), optional
            Gyroscope at the same times, rad/s. Rows without a measurement are NaN. The default is no gyroscope.
        magnetic_field_ut : array_like, shape (N, 3), optional
            Magnetometer at the same times, microtesla. Rows without a measurement are NaN. The default is no
            magnetometer.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.

        Raises
        ------
        ValueError
            If shapes or units are wrong, if the filter is finished, or if it has received samples of single sensors.
        """
        if self._state.merger.has_received:
            raise ValueError(
                "push takes merged samples, but this filter has received the samples of each sensor separately "
                "(push_accelerometer, push_streams): use only one of the two ways"
            )
        block = imu_block(time_s, specific_force_mps2, angular_rate_radps, magnetic_field_ut)
        if self._waits(block):
            return []
        _check_times(block.time_s, np.empty(0), self._state)
        block = self._with_waiting(block) if self._waiting else block
        return self._commit(*update_filter(self.config, self._state, block, provisional=True))

    def push_accelerometer(self, time_s: ArrayLike, specific_force_mps2: ArrayLike) -> list[StepUpdate]:
        """Process accelerometer samples and return the steps that they complete.

        For sensors whose samples arrive separately, out of order, or some seconds late. The filter merges the sensors
        (`pdr_filter.sensing.stream_merging`). The track equals the track of `merge_streams` on all samples.

        Parameters
        ----------
        time_s : float or array_like, shape (N,)
            Times on the clock shared by all sensors, s.
        specific_force_mps2 : array_like, shape (3,) or (N, 3)
            Samples in the sensor frame, m/s^2: +9.81 on z for a phone lying face up.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.

        Raises
        ------
        ValueError
            If shapes or units are wrong, if the filter is finished, or if it has received merged samples.
        """
        return self._push_sensor("accelerometer", time_s, specific_force_mps2, "specific_force_mps2")

    def push_gyroscope(self, time_s: ArrayLike, angular_rate_radps: ArrayLike) -> list[StepUpdate]:
        """Process gyroscope samples and return the steps that they complete.

        For sensors whose samples arrive separately, as in `push_accelerometer`.

        Parameters
        ----------
        time_s : float or array_like, shape (N,)
            Times on the clock shared by all sensors, s.
        angular_rate_radps : array_like, shape (3,) or (N, 3)
            Samples in the sensor frame, rad/s.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.

        Raises
        ------
        ValueError
            If shapes or units are wrong, if the filter is finished, or if it has received merged samples.
        """
        return self._push_sensor("gyroscope", time_s, angular_rate_radps, "angular_rate_radps")

    def push_magnetometer(self, time_s: ArrayLike, magnetic_field_ut: ArrayLike) -> list[StepUpdate]:
        """Process magnetometer samples and return the steps that they complete.

        For sensors whose samples arrive separately, as in `push_accelerometer`.

        Parameters
        ----------
        time_s : float or array_like, shape (N,)
            Times on the clock shared by all sensors, s.
        magnetic_field_ut : array_like, shape (3,) or (N, 3)
            Samples in the sensor frame, microtesla.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.

        Raises
        ------
        ValueError
            If shapes or units are wrong, if the filter is finished, or if it has received merged samples.
        """
        return self._push_sensor("magnetometer", time_s, magnetic_field_ut, "magnetic_field_ut")

    def push_pressure(self, time_s: ArrayLike, pressure_hpa: ArrayLike) -> list[StepUpdate]:
        """Process barometer samples: they determine the height, and their climb rate helps to detect stairs.

        With `push`, give the pressure of a time before the other samples of that time. With `push_accelerometer` and
        the other methods for single sensors, pressure samples may be late.

        Parameters
        ----------
        time_s : float or array_like, shape (N,)
            Times on the clock shared by all sensors, s.
        pressure_hpa : float or array_like, shape (N,)
            Air pressure, hPa.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time. Always empty if the filter receives merged samples.

        Raises
        ------
        ValueError
            If the pressures are in Pa or kPa, if shapes are wrong, or if the filter is finished.
        """
        check_unfinished(self.state, "samples")
        time, pressure = _checked_pressure(time_s, pressure_hpa)
        if not self.state.merger.is_used:
            self.state = add_pressure(self.config, self.state, time, pressure)
            return []
        return self._commit_streams({"barometer": (time, pressure[:, None])})

    def push_streams(self, streams: Mapping[Sensor, Samples]) -> list[StepUpdate]:
        """Process samples of several sensors, such as one message of a phone, and return the completed steps.

        The result equals separate calls of `push_accelerometer`, `push_gyroscope`, `push_magnetometer` and
        `push_pressure`, at the cost of one call.

        Parameters
        ----------
        streams : mapping of str to Samples
            Samples for the keys "accelerometer", "gyroscope", "magnetometer" and "barometer". Sensors may be missing.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.

        Raises
        ------
        ValueError
            For an unknown key, and for wrong shapes or units, a finished filter, or a filter that has received merged
            samples.
        """
        arrived: dict[Sensor, tuple[FloatArray, FloatArray]] = {}
        for sensor, samples in streams.items():
            if sensor not in SENSORS:
                raise ValueError(f"keys of streams must be {', '.join(SENSORS)}, got {sensor!r}: leave it out")
            if sensor == "barometer":
                time_s, pressure_hpa = _checked_pressure(samples.time_s, samples.values[:, 0])
                arrived[sensor] = time_s, pressure_hpa[:, None]
            else:
                arrived[sensor] = self._checked(sensor, samples.time_s, samples.values, f"values of {sensor}")
        return self._commit_streams(arrived)

    def _push_sensor(self, sensor: Sensor, time_s: ArrayLike, values: ArrayLike, name: str) -> list[StepUpdate]:
        return self._commit_streams({sensor: self._checked(sensor, time_s, values, name)})

    def _checked(
        self, sensor: Sensor, time_s: ArrayLike, values: ArrayLike, name: str
    ) -> tuple[FloatArray, FloatArray]:
        """Return times (N,) and values (N, 3) of one sensor, or raise ValueError if the filter cannot use them."""
        time, rows = np.atleast_1d(as_floats(time_s, "time_s")), as_floats(values, name)
        rows = rows.reshape(-1, 3) if rows.shape in ((3,), (0,)) else rows
        if time.ndim != 1:
            raise ValueError(f"time_s must be one-dimensional, got shape {time.shape}: give one time for each sample")
        if rows.shape != (len(time), 3):
            raise ValueError(f"{name} must be ({len(time)}, 3), one row for each time_s, got {np.shape(values)}")
        if not self.state.merger.is_used and self.state.sensing.conditioner.report.n_received:
            raise ValueError(
                f"samples of the {sensor} arrive separately (push_{sensor}, push_streams), but this filter has "
                "received merged samples (push): use only one of the two ways"
            )
        recent_s = self.state.merger.stream(sensor).recent_s if sensor == "accelerometer" else time[:0]
        _check_times(time, recent_s, self.state)
        return time, rows

    def _commit_streams(self, streams: Mapping[Sensor, tuple[FloatArray, FloatArray]]) -> list[StepUpdate]:
        """Process checked samples of single sensors, and return the completed steps."""
        return self._commit(*update_streams(self.config, self.state, streams, provisional=True))

    def _commit(self, state: State, output: Output) -> list[StepUpdate]:
        """Store the new state and return the steps of the output.

        Raise ValueError once if no specific force so far had the right unit. The samples of the block are then
        discarded.
        """
        conditioner, units = self._state.sensing.conditioner, state.sensing.conditioner.units
        if units.is_wrong and not conditioner.units.n:
            # The unit check is kept, so that the warning appears in `notes`; the rest of the block is discarded.
            sensing = replace(self._state.sensing, conditioner=replace(conditioner, units=units))
            self.state = replace(self._state, sensing=sensing)
            raise ValueError(f"{units.wrong_force}; then start a new filter, because this one has refused the samples")
        self.state = state
        return output.updates

    def push_location(
        self,
        time_s: ArrayLike,
        latitude_deg: ArrayLike,
        longitude_deg: ArrayLike,
        accuracy_m: ArrayLike,
        altitude_m: ArrayLike | None = None,
    ) -> list[StepUpdate]:
        """Take geographic locations from the phone, which position and rotate the track.

        The configuration must be in the world frame: `config.in_world_frame()`, or `config.with_magnetic_north(...)`,
        which takes north from the magnetometer until the locations determine it. Positions are then in metres east and
        north of the first usable location (`origin`). A location does not wait for the other sensors: if it is later
        than `Config.fix_delay_s`, it is used later than in the recording.

        Parameters
        ----------
        time_s : float or array_like, shape (N,)
            Times on the clock of the samples, s.
        latitude_deg, longitude_deg : float or array_like, shape (N,)
            WGS 84 coordinates, degrees.
        accuracy_m : float or array_like, shape (N,)
            Radius that contains the true position with 68 % probability, m, as phones report it.
        altitude_m : float or array_like, shape (N,), optional
            Altitudes, m. They determine the altitude of the start, which is the height of `origin`. NaN and 0 mean
            unknown.

        Returns
        -------
        list of StepUpdate
            Always empty: locations change later steps.

        Raises
        ------
        ValueError
            If the filter is finished, if its configuration or floor plan has no geographic frame, or if lengths differ.
        """
        check_unfinished(self.state, "locations")
        if self.config.model.frame.is_joined:
            raise ValueError(
                "locations need a filter in the world frame, got a configuration in the frame of the start: use "
                "config.in_world_frame(), for example OnlineFilter(recipes.default().in_world_frame())"
            )
        if self.config.on_plan is not None and self.config.on_plan.plan.origin is None:
            raise ValueError(
                "locations need the geographic position of the floor plan, got a plan in metres without origin: use a "
                "plan in longitude and latitude, or give the origin to FloorPlan.read"
            )
        columns = {
            "time_s": time_s,
            "latitude_deg": latitude_deg,
            "longitude_deg": longitude_deg,
            "accuracy_m": accuracy_m,
            "altitude_m": np.full(np.shape(time_s), np.nan) if altitude_m is None else altitude_m,
        }
        rows = {name: np.atleast_1d(as_floats(values, name)) for name, values in columns.items()}
        if any(row.shape != (len(rows["time_s"]),) for row in rows.values()):
            shapes = ", ".join(f"{name} {row.shape}" for name, row in rows.items())
            raise ValueError(
                f"all columns of locations must have the same length, got shapes {shapes}: give one value for each "
                "time_s"
            )
        time, latitude, longitude, accuracy, altitude = rows.values()
        location = Samples(time, np.column_stack([latitude, longitude, altitude, accuracy]))
        self.state = add_location(self.config, self.state, location)
        return []

    def finish(self) -> list[StepUpdate]:
        """Process the samples that still wait, and return the last steps.

        Call it when no further sample will come. The filter then takes no more data. A second call returns an empty
        list.

        Returns
        -------
        list of StepUpdate
            Steps that became known, in order of time.
        """
        self.state, output = finish_filter(self.config, self.state)
        return output.updates

    def add_fix(self, fix: Fix) -> FixResult:
        """Add a fix: a position, heading, range or speed, or a standstill, and return its outcome.

        The filter uses the fix when it has been received and the step at its time is known. A fix that is added before
        the first sample is checked when it is used, and is then rejected if its time is wrong.

        Parameters
        ----------
        fix : PositionFix, GridFix, HeadingFix, RangeFix, SpeedFix, Standstill or Measurement
            The fix, on the clock of the samples. Positions are in metres from the start, with north along the first
            heading, unless the configuration is for a frame with unknown origin and north
            (`OnlineFilter(pdr_filter.recipes.default().in_world_frame())`). A GridFix requires a floor plan.

        Returns
        -------
        FixResult
            Outcome of the fix, such as "used", "placed" or "rejected", if the step at its time is known already. A NIS
            above the gate means that the fix contradicts the track. Usually the outcome is "waiting", and `Now.fixes`
            has the result after a second or two. `help(type(result))` explains each outcome.

        Raises
        ------
        ValueError
            If the filter is finished, or if the time of the fix (the end of a standstill) is more than a second before
            the first sample, more than a minute before the last sample, or more than a minute after it. The filter does
            not change then.
        """
        check_unfinished(self.state, "fixes")
        check_fix(fix, self.config.on_plan is not None)
        fix, conditioner = on_track_clock(fix, self.state.clock_offset_s), self.state.sensing.conditioner
        seen = conditioner.report
        # After a gap of over a minute, samples are held until later samples confirm their clock. A fix may belong to
        # the time before or after the gap.
        latest_s = (seen.last_time_s, *(float(row[0]) for row in conditioner.clock.held[-1:]))
        wrong = [timing_error(fix, seen.first_time_s, last_s) for last_s in latest_s]
        if np.isfinite(seen.first_time_s) and all(wrong):
            raise ValueError(wrong[0])
        self.state = add_fixes(self.config, self.state, (fix,))
        return outcome_now(self.config, self.state, fix)

    def now(self) -> Now:
        """Return the estimate at the time of the newest sample, including steps that are not accepted yet.

        Returns
        -------
        Now
            Position, heading, speed, contexts and more. The filter does not change.
        """
        return now(self.config, self.state)

    def path(self) -> WalkedPath:
        """Return the smoothed path of the whole walk so far, as an app draws it.

        Returns
        -------
        WalkedPath
            Positions of all steps, corrected by later fixes. The filter does not change.

        Raises
        ------
        ValueError
            If the filter has a floor plan.
        """
        return walked_path(self.config, self.state)

    @property
    def position_m(self) -> FloatArray:
        """Position east and north after the last final step, shape (2,), m."""
        return present_position(self.config, self.state)[0]

    @property
    def position_cov_m2(self) -> FloatArray:
        """Covariance of `position_m`, shape (2, 2), m^2."""
        return present_position(self.config, self.state)[1]

    @property
    def on_plan(self) -> OnPlan | None:
        """Position estimate of the particle filter on the floor plan, or None without a plan or before its start."""
        if self.config.on_plan is None:
            return None
        return estimate_on_plan(self.config, self.state, pedestrian.reckoned_position(self.state.pedestrian))

    @property
    def height_m(self) -> float:
        """Current height above the start, m. It also changes between steps, for example in a lift."""
        return self.state.height.known.height_m

    @property
    def height_std_m(self) -> float:
        """Standard deviation of `height_m`, m."""
        return self.state.height.known.height_std_m

    @property
    def floor(self) -> int:
        """Current storey. The start is on storey 0, unless a fix names the storey."""
        return self.state.height.known.floors.floor

    @property
    def origin(self) -> Origin | None:
        """Geographic origin of `position_m`, or None before the track is in the frame of the locations.

        With a floor plan it is the origin of the plan, or None before the particle filter has started.
        """
        if self.config.on_plan is not None:
            return None if self.on_plan is None else self.config.on_plan.plan.origin
        frame, place = self.state.pedestrian.frame, self.state.locations.origin
        if place is None or not frame.is_known:
            return None
        return self.state.height.start_altitude.of(frame.origin(place))

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings about the track so far: problem, likely cause and remedy."""
        return tuple(note.text for note in notes_of(self.config, self.state))

    @property
    def device(self) -> Device:
        """Gyroscope bias estimated so far, for the next walk with the same phone (`Config.with_device`)."""
        return self.config.sensing.device(self.state.sensing)

    @property
    def person(self) -> Person | None:
        """Step length of the person from earlier walks (`config.person`) and the fixes of this one.

        It is for the next walk (`Config.with_person`), and None if there is neither.
        """
        return person_of(self.config, self.state)

    def save(self, *, models: bool = False, path: bool = True) -> bytes:
        """Serialise the filter, so that `load` continues with identical results.

        The bytes contain the state, the configuration and models of your own, but no code. They have 35 to 65 kB, and
        0.1 kB more for each step of the path. A configuration with parts of classes outside of pdr_filter is not
        included: `load` then needs it as an argument, with classes of the same names and modules. Waiting measurements
        of such classes are omitted with a UserWarning.

        Parameters
        ----------
        models : bool, default False
            Whether models of the package are stored whole, in up to 4 MB. By default they are stored by name and
            checksum, so that `load` needs a version with the same models.
        path : bool, default True
            Whether the past steps of `path` are stored. Without them the bytes do not grow with the walk, and `path`
            begins at the next step. Nothing else changes.

        Returns
        -------
        bytes
            Versioned bytes with a checksum.

        Raises
        ------
        ValueError
            If the state of a part cannot be saved.
        """
        state, n_waiting = self.state, len(self.state.waiting_fixes)
        own = tuple(fix for fix in state.waiting_fixes if isinstance(fix, OWN_FIXES))
        if len(own) < n_waiting:
            text = f"{n_waiting - len(own)} waiting measurements are not saved, because their classes are not of"
            warnings.warn(f"{text} pdr_filter: add these measurements to the loaded filter again", stacklevel=2)
            state = replace(state, waiting_fixes=own)
        sensing = self.config.sensing.trimmed(state.sensing)
        state = replace(state, sensing=sensing, chain=for_saving(state.chain, path))
        try:
            content = {"config": self.config, "state": state}
            return serialise.to_bytes(content, whole=models, constant=self.config)
        except TypeError:  # classes of other packages in the configuration or in the state of a part
            pass
        try:
            first = init_filter(self.config)
            blob = serialise.to_bytes({"config": None, "state": state}, first)
            serialise.from_bytes(blob, first)
        except (TypeError, ValueError) as error:  # found when it is saved, not when it is loaded
            raise ValueError(
                f"the filter cannot be saved because of the state of one of your own parts: {error}"
            ) from None
        return blob

    @classmethod
    def load(cls, blob: bytes, config: Config | None = None) -> OnlineFilter:
        """Restore a filter from the bytes of `save`.

        No code in the bytes is executed. Bytes with a forged checksum can still produce a filter with wrong positions.

        Parameters
        ----------
        blob : bytes
            Bytes returned by `save`.
        config : Config, optional
            Configuration of the saved filter. Required only if it has parts of classes outside of pdr_filter, or models
            of the package that this version does not have.

        Returns
        -------
        OnlineFilter
            The restored filter. Filters saved by version 0.2.0 or later can be loaded.

        Raises
        ------
        ValueError
            If the bytes are damaged, come from a version before 0.2.0 or after this one, contain no filter, do not fit
            `config`, or refer to a model that this version does not have.
        """
        if config is None:
            content = serialise.from_bytes(blob)
        else:
            content = serialise.from_bytes(blob, init_filter(config), without="config")
        whole = isinstance(content, dict) and {"config", "state"} <= content.keys()
        known = whole and isinstance(content["config"], Config | None)
        if not (known and isinstance(content["state"], State)):
            raise ValueError("the bytes do not contain a filter: give bytes that OnlineFilter.save returned")
        if config is None and content["config"] is None:
            raise ValueError(
                "the bytes contain no configuration, because the saved one has parts of classes outside of pdr_filter: "
                "give the same configuration again, OnlineFilter.load(blob, config=config)"
            )
        loaded = cls(config or content["config"])
        if config is not None:
            _check_state(config, content["state"], loaded.state)
        loaded.state = content["state"]
        return loaded


def _check_state(config: Config, state: State, first: State) -> None:
    """Raise ValueError if a loaded state does not fit the configuration, whose initial state is `first`."""
    try:
        saved, expected = map(_parts_of, (state, first))
        if saved != expected:
            raise ValueError(f"it has {saved} instead of {expected}")
    except Exception as error:  # a forged state can have any parts
        raise ValueError(
            f"the filter was saved with another configuration than {config.name!r} ({error}): give the configuration "
            "with which the filter was created"
        ) from error


def _parts_of(state: State) -> str:
    """Return the names of the classes of the states of a chain, and the number of its modes."""
    names = ", ".join(type(part).__name__ for part in states_of(state.chain))
    return f"{names} with {len(state.pedestrian.estimates.prob)} modes"


def _checked_pressure(time_s: ArrayLike, pressure_hpa: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return times and pressures (N,) of a barometer, or raise ValueError for wrong units or shapes."""
    time, pressure = as_floats(time_s, "time_s"), as_floats(pressure_hpa, "pressure_hpa")
    time, pressure = checked_pressure(np.atleast_1d(time), np.atleast_1d(pressure))
    return time, pressure


def _check_times(time_s: FloatArray, before_s: FloatArray, state: State) -> None:
    """Raise ValueError for times that are not in seconds.

    Such times are too large, or their intervals fit another unit. Intervals are checked before the first sample has
    been processed, together with the earlier times `before_s`.
    """
    finite_s = time_s[np.isfinite(time_s)]
    wrong = wrong_time(median(finite_s)) if len(finite_s) else ""
    if not wrong and state.sensing.conditioner.report.n_emitted == 0:
        known_s = np.concatenate([before_s, time_s])
        intervals_s = np.diff(known_s)
        forward_s = intervals_s[intervals_s > 0]
        rate_hz = 1.0 / median(forward_s) if len(forward_s) >= MIN_SAMPLES else np.inf
        wrong = wrong_rate(rate_hz) if unit_of_rate(rate_hz) else ""
    if wrong:
        raise ValueError(wrong)


def imu_block(
    time_s: ArrayLike,
    specific_force_mps2: ArrayLike,
    angular_rate_radps: ArrayLike | None = None,
    magnetic_field_ut: ArrayLike | None = None,
) -> ImuBlock:
    """Return samples as a block with checked shapes. Missing sensors become NaN. ValueError for wrong shapes."""
    time = as_floats(time_s, "time_s")
    if time.size == 0 and np.size(specific_force_mps2) == 0:
        return ImuBlock(np.empty(0), *(np.empty((0, 3)) for _ in range(3)))
    if time.ndim != 1:
        raise ValueError(f"time_s must be one-dimensional, got shape {time.shape}: give one time for each sample")
    columns = {
        "specific_force_mps2": specific_force_mps2,
        "angular_rate_radps": angular_rate_radps,
        "magnetic_field_ut": magnetic_field_ut,
    }
    arrays: list[FloatArray] = []
    for name, values in columns.items():
        array = np.full((len(time), 3), np.nan) if values is None else as_floats(values, name)
        if array.shape != (len(time), 3):
            raise ValueError(f"{name} must be ({len(time)}, 3), one row for each time_s, got {array.shape}")
        arrays.append(array)
    return ImuBlock(time, *arrays)
