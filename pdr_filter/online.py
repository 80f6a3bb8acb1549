"""The filter as the thin object that apps push samples into."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
from numpy.typing import ArrayLike

from pdr_filter import serialise
from pdr_filter.config import Config
from pdr_filter.filter.pedestrian import StepUpdate, present_position
from pdr_filter.filtering import State, add_fixes, add_location, add_pressure, finish, init, notes_of, step, untimely
from pdr_filter.io.recording import Subject
from pdr_filter.sensing.clock import moved
from pdr_filter.sensing.device import Device
from pdr_filter.values import Fix, FloatArray, ImuBlock, Origin


class OnlineFilter:
    """A filter for apps: push samples in blocks of any length, get the steps that became known.

    One filter belongs to one pedestrian and one thread.

    Parameters
    ----------
    config : Config, optional
        A recipe; the default recipe if not given.
    height_m : float, optional
        Of the person, for the default recipe: what `pdr_filter.track` takes from a recording that says it.

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

    def __init__(self, config: Config | None = None, height_m: float | None = None) -> None:
        if config is None:
            from pdr_filter import recipes

            config = recipes.default(Subject(height_m=height_m))
        elif height_m is not None:
            raise ValueError(
                f"height_m is for the default recipe, got {height_m} beside a config: give it to the recipe"
            )
        self.config = config
        self.state = init(config)

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
        block = imu_block(time_s, specific_force_mps2, angular_rate_radps, magnetic_field_ut)
        self.state, output = step(self.config, self.state, block)
        return output.updates

    def push_pressure(self, time_s: ArrayLike, pressure_hpa: ArrayLike) -> None:
        """Take samples of a barometer, (N,) each: the climb rate distinguishes stairs from flat walking.

        Push the pressure before the other samples of the same time. Raises ValueError for pressures in Pa or kPa.
        """
        time, pressure = (np.atleast_1d(np.asarray(values, dtype=float)) for values in (time_s, pressure_hpa))
        self.state = add_pressure(self.config, self.state, time, pressure)

    def push_location(
        self, time_s: ArrayLike, latitude_deg: ArrayLike, longitude_deg: ArrayLike, accuracy_m: ArrayLike
    ) -> None:
        """Take locations of the phone, (N,) or single numbers, as they come: they place and turn the track.

        For a configuration in the world frame, `config.in_world_frame()`, or `config.with_magnetic_north(...)` with the
        magnetometer's north until they have; ValueError otherwise. East and north are
        metres from the first location that can be used, `origin`. `accuracy_m` is the radius that holds 68 %, as phones
        report it.
        """
        if self.state.finished:
            raise ValueError("the filter is finished: start a new one for further locations")
        if self.config.model.frame.is_joined:
            raise ValueError(
                "locations are for a filter in the world frame, got a configuration in the frame of the start: make "
                "it of config.in_world_frame(), such as OnlineFilter(recipes.default().in_world_frame())"
            )
        columns = (time_s, latitude_deg, longitude_deg, accuracy_m)
        time, latitude, longitude, accuracy = (np.atleast_1d(np.asarray(values, dtype=float)) for values in columns)
        if not time.shape == latitude.shape == longitude.shape == accuracy.shape == (len(time),):
            raise ValueError(
                "time_s, latitude_deg, longitude_deg and accuracy_m must have one number for each location, got shapes "
                f"{time.shape}, {latitude.shape}, {longitude.shape} and {accuracy.shape}"
            )
        self.state = add_location(self.config, self.state, time, latitude, longitude, accuracy)

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
        fix, seen = moved(fix, self.state.clock_offset_s), self.state.sensing.conditioner.report
        wrong = "" if np.isnan(seen.first_time_s) else untimely(fix, seen.first_time_s, seen.last_time_s)
        if wrong:
            raise ValueError(wrong)
        self.state = add_fixes(self.config, self.state, (fix,))

    @property
    def position_m(self) -> FloatArray:
        """East and north of the last final step, shape (2,)."""
        return present_position(self.state.tracker.pedestrian)[0]

    @property
    def position_cov_m2(self) -> FloatArray:
        """Covariance of `position_m`, shape (2, 2)."""
        return present_position(self.state.tracker.pedestrian)[1]

    @property
    def origin(self) -> Origin | None:
        """Where on Earth `position_m` is zero; None before a location has placed the track."""
        frame, place = self.state.tracker.pedestrian.frame, self.state.locations.origin
        return frame.origin(place) if place is not None and frame.is_known else None

    @property
    def notes(self) -> tuple[str, ...]:
        """What to keep in mind about the track so far, in plain words."""
        return tuple(note.text for note in notes_of(self.config, self.state))

    @property
    def device(self) -> Device:
        """What the samples so far teach of the phone, for its next walk: `Config.with_device`."""
        return self.config.sensing.device(self.state.sensing)

    def save(self) -> bytes:
        """Bytes from which `load` continues as if nothing had happened, configuration and models included."""
        return serialise.to_bytes({"config": self.config, "state": self.state})

    @classmethod
    def load(cls, blob: bytes) -> OnlineFilter:
        """The filter that was saved; ValueError if the bytes are something else."""
        content = serialise.from_bytes(blob)
        whole = isinstance(content, dict) and {"config", "state"} <= content.keys()
        if not (whole and isinstance(content["config"], Config) and isinstance(content["state"], State)):
            raise ValueError("these bytes hold no filter; give what OnlineFilter.save returned")
        loaded = cls(content["config"])
        if _shape(content["state"]) != _shape(loaded.state):
            raise ValueError("these bytes hold a state of another configuration; save the filter again")
        loaded.state = content["state"]
        return loaded


def _shape(state: State) -> tuple[object, ...]:
    """What a configuration fixes of a state: the arrays of its modes, and the kinds of the stages' own states."""
    stages = (getattr(state.sensing, f.name) for f in fields(state.sensing))
    sensing = tuple(type(stage) for stage in stages if is_dataclass(stage))
    known = state.tracker.pedestrian
    return (type(state.tracker), known.mean.shape, known.cov.shape, known.prob.shape, known.shared_m.shape, sensing)


def imu_block(
    time_s: ArrayLike,
    specific_force_mps2: ArrayLike,
    angular_rate_radps: ArrayLike | None = None,
    magnetic_field_ut: ArrayLike | None = None,
) -> ImuBlock:
    """Samples as a block, shapes checked; missing sensors become NaN."""
    time = np.asarray(time_s, dtype=float)
    if time.size == 0:
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
        array = np.full((len(time), 3), np.nan) if values is None else np.asarray(values, dtype=float)
        if array.shape != (len(time), 3):
            raise ValueError(f"{name} must be ({len(time)}, 3), one row for each time_s, got {array.shape}")
        arrays.append(array)
    return ImuBlock(time, *arrays)
