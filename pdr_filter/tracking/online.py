"""The filter as the thin object that apps push samples into."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter.filter.imm import pedestrian_state as pedestrian
from pdr_filter.filter.imm.pedestrian_state import StepUpdate
from pdr_filter.filter.step_length.person import Person
from pdr_filter.recipes.config import Config, check_config
from pdr_filter.sensing.clock import moved
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
    arrive,
    finish,
    init,
    person_of,
    present_position,
    untimely,
    update,
)
from pdr_filter.tracking.walked_path import WalkedPath, walked_path
from pdr_filter.tracking.warnings import notes_of
from pdr_filter.values import (
    Fix,
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
from pdr_filter.values.limits import MIN_SAMPLES
from pdr_filter.values.plausibility import unit_of_rate, wrong_rate, wrong_time
from pdr_filter.values.recording import Subject
from pdr_filter.values.track_placement import TrackPlacement


class OnlineFilter:
    """A filter for apps: push samples in blocks of any length, get the steps that became known.

    One filter belongs to one pedestrian and one thread.

    Parameters
    ----------
    config : Config, optional
        A recipe; the default recipe if not given.
    height_m : float, optional
        Of the person, for the default recipe: what `pdr_filter.track` takes from a recording that says it.
    plan, start, weighting
        As in `pdr_filter.track`.

    Examples
    --------
    >>> import numpy as np, pdr_filter as pdr
    >>> walk = pdr.simulate.demo_walk()
    >>> samples = pdr.merge_streams(walk)
    >>> online = pdr.OnlineFilter()
    >>> updates = []
    >>> for i in range(0, len(samples.time_s), 37):
    ...     block = slice(i, i + 37)
    ...     updates += online.push(
    ...         samples.time_s[block], samples.specific_force_mps2[block], samples.angular_rate_radps[block]
    ...     )
    >>> len(updates) > 100
    True
    """

    def __init__(
        self,
        config: Config | None = None,
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
                f"height_m is for the default recipe, got {height_m} beside a config: give it to the recipe"
            )
        check_config(config)
        config = config.placed(TrackPlacement(plan=plan, start=start))
        self.config = config if weighting is None else config.with_weighting(weighting)
        self.state = init(self.config)

    def push(
        self,
        time_s: ArrayLike,
        specific_force_mps2: ArrayLike,
        angular_rate_radps: ArrayLike | None = None,
        magnetic_field_ut: ArrayLike | None = None,
    ) -> list[StepUpdate]:
        """Updates of the steps that these samples made known, in order.

        Parameters
        ----------
        time_s : (N,)
            Seconds, increasing; repeated and backward times are dropped and counted.
        specific_force_mps2 : (N, 3)
            Sensor frame, +9.81 on z for a phone lying face up.
        angular_rate_radps, magnetic_field_ut : (N, 3), optional
            At the same times; NaN rows, or nothing, where there is no measurement.
        """
        if self.state.merger.has_received:
            raise ValueError(
                "push takes samples that are merged, and this filter takes sensors apart: use one of the two"
            )
        block = imu_block(time_s, specific_force_mps2, angular_rate_radps, magnetic_field_ut)
        _check_times(block.time_s, np.empty(0), self.state)
        return self._took(*update(self.config, self.state, block))

    def push_accelerometer(self, time_s: ArrayLike, specific_force_mps2: ArrayLike) -> list[StepUpdate]:
        """Updates of the steps that became known, after samples of the accelerometer: one row (3,) or a block (N, 3).

        For sensors that arrive apart, out of step and late by some seconds (`pdr_filter.sensing.stream_merging`);
        `push` takes samples that are merged already. The track is that of `merge_streams` on all of them.
        """
        return self._arrive("accelerometer", time_s, specific_force_mps2, "specific_force_mps2")

    def push_gyroscope(self, time_s: ArrayLike, angular_rate_radps: ArrayLike) -> list[StepUpdate]:
        """The same of a gyroscope."""
        return self._arrive("gyroscope", time_s, angular_rate_radps, "angular_rate_radps")

    def push_magnetometer(self, time_s: ArrayLike, magnetic_field_ut: ArrayLike) -> list[StepUpdate]:
        """The same of a magnetometer."""
        return self._arrive("magnetometer", time_s, magnetic_field_ut, "magnetic_field_ut")

    def push_pressure(self, time_s: ArrayLike, pressure_hpa: ArrayLike) -> list[StepUpdate]:
        """Take samples of a barometer, (N,) each: the height follows it, and its climb rate distinguishes stairs.

        With `push`, give the pressure before the other samples of the same time; with `push_accelerometer` it may be
        late as they may. Raises ValueError for pressures in Pa or kPa.
        """
        if self.state.finished:
            raise ValueError("the filter is finished: start a new one for further samples")
        time, pressure = _checked_pressure(time_s, pressure_hpa)
        if not self.state.merger.is_used:
            self.state = add_pressure(self.config, self.state, time, pressure)
            return []
        return self._took(*arrive(self.config, self.state, {"barometer": (time, pressure[:, None])}))

    def push_streams(self, streams: Mapping[Sensor, Samples]) -> list[StepUpdate]:
        """Updates of the steps that became known, after samples of several sensors, such as those of one message.

        The track is that of `push_accelerometer`, `push_gyroscope` and the others, for the cost of one call. Keys of
        `streams` are "accelerometer", "gyroscope", "magnetometer" and "barometer". Raises ValueError for other keys,
        and as those methods do.
        """
        arrived: dict[Sensor, tuple[FloatArray, FloatArray]] = {}
        for sensor, samples in streams.items():
            if sensor not in SENSORS:
                raise ValueError(f"streams must be of {', '.join(SENSORS)}, got {sensor!r}: leave it out")
            if sensor == "barometer":
                time_s, pressure_hpa = _checked_pressure(samples.time_s, samples.values[:, 0])
                arrived[sensor] = time_s, pressure_hpa[:, None]
            else:
                arrived[sensor] = self._checked(sensor, samples.time_s, samples.values, f"values of {sensor}")
        return self._took(*arrive(self.config, self.state, arrived))

    def _arrive(self, sensor: Sensor, time_s: ArrayLike, values: ArrayLike, name: str) -> list[StepUpdate]:
        return self._took(*arrive(self.config, self.state, {sensor: self._checked(sensor, time_s, values, name)}))

    def _checked(
        self, sensor: Sensor, time_s: ArrayLike, values: ArrayLike, name: str
    ) -> tuple[FloatArray, FloatArray]:
        """Times (N,) and values (N, 3) of one sensor; ValueError if the filter cannot take them."""
        time, rows = np.atleast_1d(as_floats(time_s, "time_s")), as_floats(values, name)
        rows = rows.reshape(-1, 3) if rows.shape in ((3,), (0,)) else rows
        if time.ndim != 1 or rows.shape != (len(time), 3):
            raise ValueError(f"{name} must be ({time.size}, 3), one row for each time_s, got {rows.shape}")
        if not self.state.merger.is_used and self.state.sensing.conditioner.report.n_received:
            raise ValueError(
                f"push_{sensor} takes sensors apart, and this filter takes samples that are merged: use one of the two"
            )
        recent_s = self.state.merger.stream(sensor).recent_s if sensor == "accelerometer" else time[:0]
        _check_times(time, recent_s, self.state)
        return time, rows

    def _took(self, state: State, output: Output) -> list[StepUpdate]:
        """The updates, with the new state; ValueError, once, if no specific force yet was in the right unit."""
        conditioner, units = self.state.sensing.conditioner, state.sensing.conditioner.units
        if units.is_wrong and not conditioner.units.n:
            # the note stays, and nothing of the block
            sensing = replace(self.state.sensing, conditioner=replace(conditioner, units=units))
            self.state = replace(self.state, sensing=sensing)
            raise ValueError(f"{units.wrong_force}; start a new filter with such samples")
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
        """Take locations of the phone, (N,) or single numbers, as they come: they place and turn the track.

        For a configuration in the world frame, `config.in_world_frame()`, or `config.with_magnetic_north(...)` with the
        magnetometer's north until they have; ValueError otherwise. East and north are
        metres from the first location that can be used, `origin`. `accuracy_m` is the radius that holds 68 %, as phones
        report it. Altitudes show that of the start, the height of `origin`; NaN and 0 are none.
        """
        if self.state.finished:
            raise ValueError("the filter is finished: start a new one for further locations")
        if self.config.model.frame.is_joined:
            raise ValueError(
                "locations are for a filter in the world frame, got a configuration in the frame of the start: make "
                "it of config.in_world_frame(), such as OnlineFilter(recipes.default().in_world_frame())"
            )
        if self.config.on_plan is not None and self.config.on_plan.plan.origin is None:
            raise ValueError(
                "locations need to know where on Earth the plan is, got a plan in metres: give one in longitude and "
                "latitude, or FloorPlan.read its origin"
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
            raise ValueError(f"locations must have one number of each for each location, got shapes {shapes}")
        self.state = add_location(self.config, self.state, *rows.values())
        return []

    def finish(self) -> list[StepUpdate]:
        """Updates of the last steps, when no further sample will come."""
        self.state, output = finish(self.config, self.state)
        return output.updates

    def add_fix(self, fix: Fix) -> None:
        """Take a fix of position, heading or speed, or a standstill.

        It is used when it was received and the step that it falls into is known. Raises ValueError, and stays as it
        is, for a fix from before the first sample, more than a minute older than the last one, or more than a minute
        ahead of it; for a standstill its end counts. A fix that is given before the first sample is looked at when it
        is used, and then rejected.
        """
        if self.state.finished:
            raise ValueError("the filter is finished: start a new one for further fixes")
        check_fix(fix, self.config.on_plan is not None)
        fix, conditioner = moved(fix, self.state.clock_offset_s), self.state.sensing.conditioner
        seen = conditioner.report
        # after a gap of over a minute samples wait until those that follow confirm them
        latest_s = (seen.last_time_s, *(float(row[0]) for row in conditioner.clock.held[-1:]))
        wrong = [untimely(fix, seen.first_time_s, last_s) for last_s in latest_s]
        if np.isfinite(seen.first_time_s) and all(wrong):
            raise ValueError(wrong[0])
        self.state = add_fixes(self.config, self.state, (fix,))

    def now(self) -> Now:
        """What is known at this moment, with the steps that are not accepted yet; changes nothing."""
        return now(self.config, self.state)

    def path(self) -> WalkedPath:
        """The whole path as it is estimated now, past steps smoothed; changes nothing. What an app draws."""
        return walked_path(self.config, self.state)

    @property
    def position_m(self) -> FloatArray:
        """East and north of the last final step, shape (2,)."""
        return present_position(self.config, self.state)[0]

    @property
    def position_cov_m2(self) -> FloatArray:
        """Covariance of `position_m`, shape (2, 2)."""
        return present_position(self.config, self.state)[1]

    @property
    def on_plan(self) -> OnPlan | None:
        """Where the particles on the floor plan are, in one place or several; None before there are some."""
        if self.config.on_plan is None:
            return None
        reckoned = pedestrian.present_position(self.state.tracker.pedestrian)
        return self.config.on_plan.place(self.state.particles, reckoned)

    @property
    def height_m(self) -> float:
        """Height above the start now, with or without steps."""
        return self.state.height.known.height_m

    @property
    def height_std_m(self) -> float:
        """Standard deviation of `height_m`."""
        return self.state.height.known.height_std_m

    @property
    def floor(self) -> int:
        """The storey now: from that of the start, which is 0, or as a fix has named it."""
        return self.state.height.known.floors.floor

    @property
    def origin(self) -> Origin | None:
        """Where on Earth `position_m` is zero; None before a location has placed the track."""
        if self.config.on_plan is not None:
            return None if self.on_plan is None else self.config.on_plan.plan.origin
        frame, place = self.state.tracker.pedestrian.frame, self.state.locations.origin
        if place is None or not frame.is_known:
            return None
        return self.state.height.start_altitude.of(frame.origin(place))

    @property
    def notes(self) -> tuple[str, ...]:
        """What to keep in mind about the track so far, in plain words."""
        return tuple(note.text for note in notes_of(self.config, self.state))

    @property
    def device(self) -> Device:
        """What the samples so far teach of the phone, for its next walk: `Config.with_device`."""
        return self.config.sensing.device(self.state.sensing)

    @property
    def person(self) -> Person | None:
        """What walks so far teach of the person, for the next one (`Config.with_person`); None without fixes."""
        return person_of(self.config, self.state)

    def save(self) -> bytes:
        """Bytes from which `load` continues as if nothing had happened, configuration and models included.

        Bytes never name a class outside of this package. Where the configuration holds parts of other classes, it is
        not in the bytes, and `load` needs it. Measurements of other classes that still wait are left out, with a
        UserWarning. Raises ValueError for a part whose state cannot be saved.
        """
        state, n_waiting = self.state, len(self.state.waiting_fixes)
        own = tuple(fix for fix in state.waiting_fixes if isinstance(fix, OWN_FIXES))
        if len(own) < n_waiting:
            text = f"{n_waiting - len(own)} measurements of classes of yours wait for their steps and are not saved"
            warnings.warn(f"{text}: add them again after load", stacklevel=2)
            state = replace(state, waiting_fixes=own)
        try:
            return serialise.to_bytes({"config": self.config, "state": state})
        except TypeError:  # classes of other packages in the configuration or in the state of a part
            pass
        try:
            blob = serialise.to_bytes({"config": None, "state": state}, foreign=True)
            serialise.restored(serialise.from_bytes(blob)["state"], init(self.config))
        except (TypeError, ValueError) as error:  # now, and not when it is loaded
            raise ValueError(f"the state of a part of yours cannot be saved: {error}") from None
        return blob

    @classmethod
    def load(cls, blob: bytes, config: Config | None = None) -> OnlineFilter:
        """The filter that was saved; ValueError for damaged bytes, those of another version, and anything else.

        `config` is the configuration of that filter, needed if it holds parts of classes outside of this package. No
        code in the bytes is executed, but bytes with a forged checksum can make a filter with wrong positions.
        """
        content = serialise.from_bytes(blob)
        whole = isinstance(content, dict) and {"config", "state"} <= content.keys()
        if not (whole and isinstance(content["config"], Config | None) and isinstance(content["state"], State)):
            raise ValueError("these bytes hold no filter; give what OnlineFilter.save returned")
        if config is None and content["config"] is None:
            raise ValueError(
                "this filter was saved with parts of classes outside of pdr_filter, which its bytes do not hold: give "
                "the same configuration again, OnlineFilter.load(blob, config=config)"
            )
        loaded = cls(config or content["config"])
        loaded.state = content["state"] if config is None else _of_config(config, content["state"], loaded.state)
        return loaded


def _of_config(config: Config, state: State, first: State) -> State:
    """A loaded state whose parts have the classes of a configuration, given its first state."""
    try:
        state = serialise.restored(state, first)
        n_filters = len(state.tracker.pedestrian.estimates.prob)
        if type(state.tracker) is not type(first.tracker) or n_filters != len(first.tracker.pedestrian.estimates.prob):
            raise ValueError(f"it has {n_filters} modes and another tracker")
    except Exception as error:  # whatever forged bytes provoke in the classes of a caller
        raise ValueError(
            f"this filter was saved with another configuration than {config.name!r} ({error}): give the one that "
            "the filter was made with"
        ) from error
    return state


def _checked_pressure(time_s: ArrayLike, pressure_hpa: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Times and pressures (N,) of a barometer; ValueError for other units or shapes."""
    columns = {"time_s": time_s, "pressure_hpa": pressure_hpa}
    time, pressure = (np.atleast_1d(as_floats(values, name)) for name, values in columns.items())
    time, pressure = checked_pressure(time, pressure)
    return time, pressure


def _check_times(time_s: FloatArray, before_s: FloatArray, state: State) -> None:
    """ValueError for times that cannot be seconds: too large, or from the first on as far apart as of another unit."""
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
    """Samples as a block, shapes checked; missing sensors become NaN."""
    time = as_floats(time_s, "time_s")
    if time.size == 0 and np.size(specific_force_mps2) == 0:
        return ImuBlock(np.empty(0), *(np.empty((0, 3)) for _ in range(3)))
    if time.ndim != 1:
        raise ValueError(f"time_s must be one-dimensional, got shape {time.shape}")
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
