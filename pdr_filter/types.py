"""Value types that flow between the parts: frozen, arrays read-only, units in every name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
# A small column table: `table.time_s` and `table["time_s"]` are columns, `len(table)` rows, and
# `pandas.DataFrame(table)` works, without pandas being needed here.
Table = np.recarray[Any, Any]

STANDARD_GRAVITY_MPS2 = 9.80665

# Order of the contexts everywhere: C1..C6 of Martinelli et al. 2018, Table I.
CONTEXTS: tuple[str, ...] = ("stationary", "walking", "upstairs", "downstairs", "sideways", "running")

# Order of the carrying modes everywhere.
CARRYING_MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket", "bag")


def read_only(values: ArrayLike) -> FloatArray:
    """Return a read-only contiguous float64 copy."""
    array = np.array(values, dtype=np.float64, order="C")
    array.flags.writeable = False
    return array


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Samples:
    """One sensor stream at its own timestamps.

    Parameters
    ----------
    time_s : (N,)
        Seconds from the first accelerometer sample; as recorded, so not always increasing.
    values : (N, d)
        In the units of the stream (`Recording` names them); NaN where a field was empty.
    """

    time_s: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_s", read_only(self.time_s))
        object.__setattr__(self, "values", read_only(self.values))
        if self.time_s.ndim != 1 or self.values.ndim != 2 or len(self.time_s) != len(self.values):
            raise ValueError(
                f"time_s must be (N,) and values (N, d), got {self.time_s.shape} and {self.values.shape}: "
                "give one time for each row"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Samples({len(self)} x {self.values.shape[1]})"


@dataclass(frozen=True, slots=True)
class Subject:
    """The pedestrian, as far as known."""

    id: str | None = None
    height_m: float | None = None
    weight_kg: float | None = None
    age: float | None = None
    gender: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What is known about the walk: tables with the columns of docs/formats.md, or None."""

    position: Table | None = None
    waypoints: Table | None = None
    steps: Table | None = None
    strides: Table | None = None
    segments: Table | None = None
    labels: Table | None = None

    def present(self) -> tuple[str, ...]:
        """Names of the tables that exist."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name) is not None)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recording:
    """One recording: sensor streams at their own timestamps, truth where it exists, meta data.

    Sensor frame: x right, y up along the screen, z out of it. Specific force reads +9.81 on z for a phone lying
    face up. Streams that the phone did not record are None.
    """

    name: str
    accelerometer: Samples  # specific force, m/s2, (N, 3)
    gyroscope: Samples | None = None  # angular rate, rad/s, (N, 3)
    magnetometer: Samples | None = None  # magnetic field, uT, (N, 3)
    barometer: Samples | None = None  # pressure, hPa, (N, 1)
    light: Samples | None = None  # illuminance, lux, (N, 1)
    proximity: Samples | None = None  # distance, cm, (N, 1)
    attitude: Samples | None = None  # sensor-to-world quaternion wxyz computed by the phone, (N, 4)
    location: Samples | None = None  # latitude and longitude deg, altitude m, horizontal accuracy m, (N, 4)
    truth: Truth = Truth()
    meta: Mapping[str, Any] = field(default_factory=dict[str, Any])
    source: str = ""  # path it was read from
    notes: tuple[str, ...] = ()  # what the reader repaired or found odd, in words

    def __repr__(self) -> str:
        return f"Recording({self.name!r}, {self.duration_s:.1f} s, {', '.join(self.streams)})"

    @property
    def subject(self) -> Subject:
        """The pedestrian, from meta; unknown fields are None."""
        known = self.meta.get("subject") or {}
        return Subject(**{f.name: known.get(f.name) for f in fields(Subject)})

    def of_height(self, height_m: float) -> Recording:
        """The same recording of a person of this height: step lengths follow it."""
        subject = {**(self.meta.get("subject") or {}), "height_m": height_m}
        return replace(self, meta={**self.meta, "subject": subject})

    def save(self, path: str | Path) -> Path:
        """Write it in the project's own format and return the path: a zip file, or a folder without suffix."""
        from pdr_filter.io.own_format import write_recording

        return write_recording(self, path)

    @property
    def streams(self) -> dict[str, Samples]:
        """The sensor streams that exist, by name."""
        return {f.name: value for f in fields(self) if isinstance(value := getattr(self, f.name), Samples)}

    @property
    def duration_s(self) -> float:
        """Time from the first to the last accelerometer sample."""
        time_s = self.accelerometer.time_s
        return float(time_s.max() - time_s.min()) if len(time_s) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ImuBlock:
    """Samples of all sensors on one time base, sensor frame; what `OnlineFilter.push` takes.

    NaN marks a missing value: a row without specific force is bridged or becomes a gap, angular rate may be missing
    for any stretch.
    """

    time_s: FloatArray  # (N,)
    specific_force_mps2: FloatArray  # (N, 3), norm about 9.81 at rest
    angular_rate_radps: FloatArray  # (N, 3)
    magnetic_field_ut: FloatArray  # (N, 3)


@dataclass(frozen=True, slots=True)
class Step:
    """One step: from a contact of one foot to the next contact of the other.

    Statistics are over the samples of the step. `magnitude` is of the specific force, `vertical` its component along
    gravity minus standard gravity (up positive).
    """

    time_s: float  # contact that ends the step
    detected_time_s: float  # when it became known, causally
    duration_s: float
    frequency_hz: float  # 1 / duration_s
    variance: float  # of the magnitude, m2/s4 (sigma_f^2 of Martinelli et al. 2018, eq. 12)
    vertical_max_mps2: float
    vertical_min_mps2: float
    magnitude_max_mps2: float
    magnitude_min_mps2: float
    mean_abs_mps2: float  # mean of | magnitude - g |
    heading_change_rad: float  # of the device over the step, clockwise positive
    device_heading_rad: float  # mean over the step, clockwise from the first heading, not wrapped
    heading_unknown_s: float = 0.0  # time since the step before without angular rate: the heading stood still
    # Where the person walked, as the samples show it without the device's axes: same zero as `device_heading_rad`,
    # clockwise, any number of turns. A measurement for the filter; nothing is known where its deviation is infinite.
    walking_direction_rad: float = 0.0
    walking_direction_std_rad: float = np.inf
    # How much the angle between walking and device may have changed since the step before (standard deviation): 0
    # while the phone stays where it is, large when it was moved to another place.
    offset_change_std_rad: float = 0.0
    # Standard deviation of the gyroscope's bias about the vertical at this step, after correction.
    yaw_bias_std_radps: float = 0.0
    # Of the sinusoid at the step's own frequency in the vertical: the bounce of the body without heel strikes.
    vertical_amplitude_mps2: float = 0.0
    # Geometric mean of that over the person's last steps, this one included; 0 before the second step of a bout.
    usual_amplitude_mps2: float = 0.0
    from_rest: bool = False  # the first of a bout, or after a pause: it began with the feet together

    @property
    def vertical_range_mps2(self) -> float:
        """Peak-to-peak vertical specific force."""
        return self.vertical_max_mps2 - self.vertical_min_mps2


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Windows:
    """Context and carrying-mode probabilities of all windows of a recording."""

    time_s: FloatArray  # (W,) window ends
    context_prob: FloatArray  # (W, C)
    contexts: tuple[str, ...]
    carrying_prob: FloatArray  # (W, D) after each window, of all windows so far
    carrying_modes: tuple[str, ...]
    unknown_share: FloatArray  # (W,) how unlike the classifier's training windows, 0 to 1; `context_prob` has it in
    irregular_prob: FloatArray  # (W,) that the motion moves nobody: the phone taken out, turned, put away
    climb_rate_mps: FloatArray  # (W,) from the barometer, up positive; NaN without
    model: tuple[str, ...]  # (W,) name of the model that classified the context

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return f"Windows({len(self)} windows)"


@dataclass(frozen=True, slots=True, eq=False)
class PositionFix:
    """A position from elsewhere (GNSS, Wi-Fi, a waypoint) with its covariance.

    Parameters
    ----------
    time_s : float
        When the position was true, on the time base of the samples.
    position_m : (2,)
        East, north.
    cov_m2 : (2, 2)
        Covariance, positive definite.
    received_time_s : float, optional
        When it arrived, not before `time_s`; `time_s` if not given.
    """

    time_s: float
    position_m: FloatArray
    cov_m2: FloatArray
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", read_only(self.position_m))
        object.__setattr__(self, "cov_m2", read_only(self.cov_m2))
        if self.position_m.shape != (2,) or not np.isfinite(self.position_m).all():
            raise ValueError(f"position_m must be two finite numbers (east, north), got {self.position_m}")
        symmetric = self.cov_m2.shape == (2, 2) and np.allclose(self.cov_m2, self.cov_m2.T)
        if not (symmetric and np.isfinite(self.cov_m2).all() and (np.linalg.eigvalsh(self.cov_m2) > 0).all()):
            raise ValueError(f"cov_m2 must be a symmetric positive definite (2, 2) array in m2, got {self.cov_m2}")
        _check_times(self.time_s, self.received_time_s)


# A deviation beyond this says nothing, and its square must stay a number.
_MAX_STD = 1e100


@dataclass(frozen=True, slots=True)
class HeadingFix:
    """A walking heading from elsewhere: a corridor, a compass that is trusted, the course of a GNSS receiver.

    Parameters
    ----------
    time_s : float
        When it was true, on the time base of the samples.
    walking_heading_rad : float
        Clockwise from the track's north, any number of turns.
    std_rad : float
        Standard deviation.
    received_time_s : float, optional
        When it arrived, not before `time_s`; `time_s` if not given.
    """

    time_s: float
    walking_heading_rad: float
    std_rad: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _check_times(self.time_s, self.received_time_s)
        if not (np.isfinite(self.walking_heading_rad) and 0 < self.std_rad < _MAX_STD):
            raise ValueError(
                f"walking_heading_rad must be finite and std_rad positive, got {self.walking_heading_rad} and "
                f"{self.std_rad}"
            )


@dataclass(frozen=True, slots=True)
class SpeedFix:
    """A walking speed from elsewhere, such as a GNSS receiver's: it teaches the person's step scale.

    Parameters
    ----------
    time_s : float
        When it was true, on the time base of the samples.
    speed_mps, std_mps : float
        Speed over ground, positive, and its standard deviation.
    received_time_s : float, optional
        When it arrived, not before `time_s`; `time_s` if not given.
    """

    time_s: float
    speed_mps: float
    std_mps: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _check_times(self.time_s, self.received_time_s)
        if not (0 < self.speed_mps < np.inf and 0 < self.std_mps < _MAX_STD):
            raise ValueError(
                f"speed_mps and std_mps must be positive, got {self.speed_mps} and {self.std_mps}; somebody who stands "
                "is a Standstill"
            )


@dataclass(frozen=True, slots=True)
class Standstill:
    """The person is known to stand: steps in this time were not walked.

    Parameters
    ----------
    time_s, end_s : float
        Begin and end, on the time base of the samples.
    received_time_s : float, optional
        When it became known, not before `time_s`; steps that were told before are not taken back.
    """

    time_s: float
    end_s: float
    received_time_s: float | None = None

    def __post_init__(self) -> None:
        _check_times(self.time_s, self.received_time_s)
        if not self.time_s < self.end_s < np.inf:
            raise ValueError(f"a standstill must end after its begin, got {self.time_s} to {self.end_s} s")


def _check_times(time_s: float, received_time_s: float | None) -> None:
    received_s = time_s if received_time_s is None else received_time_s
    if not (np.isfinite(time_s) and np.isfinite(received_s) and received_s >= time_s):
        raise ValueError(
            f"time_s of a fix must be finite and received_time_s not before it, got {time_s} and {received_time_s}"
        )


# What a filter takes besides samples.
Fix = PositionFix | HeadingFix | SpeedFix | Standstill


def received_s(fix: Fix) -> float:
    """When a fix became known: when it was received, or at once."""
    return fix.time_s if fix.received_time_s is None else fix.received_time_s


@dataclass(frozen=True, slots=True)
class FixResult:
    """What the filter made of a fix."""

    kind: str  # "position", "heading", "speed", "standstill"
    time_s: float  # when it was true
    used_s: float  # when the filter took it
    # Normalised innovation squared in the mode that explains it best; infinite if it is of another time, NaN where
    # there was nothing to compare it with.
    nis: float
    accepted: bool

    @classmethod
    def of(cls, fix: Fix, used_s: float, nis: float, accepted: bool) -> FixResult:
        """That of a fix."""
        return cls(type(fix).__name__.removesuffix("Fix").lower(), fix.time_s, used_s, nis, accepted)


class MissingSensorError(ValueError):
    """A recording lacks a sensor that the recipe needs; the message names both."""


def table(columns: Mapping[str, ArrayLike]) -> Table:
    """Return a read-only column table from equally long columns."""
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    length = len(next(iter(arrays.values())))
    result = np.zeros(length, dtype=[(name, array.dtype) for name, array in arrays.items()])
    for name, array in arrays.items():
        result[name] = array
    result.flags.writeable = False
    return result.view(np.recarray)


def step_table(steps: Sequence[Step]) -> Table:
    """Return one row for each step, one float column for each field of `Step`."""
    return table({f.name: np.array([getattr(s, f.name) for s in steps], dtype=float) for f in fields(Step)})


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Track:
    """Where the pedestrian walked: one row for each step, positions in metres with covariance.

    East and north are relative to the start; "north" is true north only where an absolute heading was available,
    otherwise the direction of the device's heading at the start.

    `context_prob` is what the classifier said of the window, `mode_prob` what the filter made of it over time; step
    lengths come from the latter. With `imm` a position is the best estimate at its step: when the evidence changes
    from one context to another, the past is seen anew and a position may move by more or less than its step length.
    """

    name: str
    time_s: FloatArray  # (K,) foot contacts
    position_m: FloatArray  # (K, 2) east, north
    position_cov_m2: FloatArray  # (K, 2, 2)
    step_length_m: FloatArray  # (K,)
    walking_heading_rad: FloatArray  # (K,) clockwise from north (or from the first heading)
    step_speed_mps: FloatArray  # (K,) length over duration of each step
    step_speed_std_mps: FloatArray  # (K,)
    smoothed_speed_mps: FloatArray  # (K,) after each step, of the steps of its bout so far
    smoothed_speed_std_mps: FloatArray  # (K,)
    context_prob: FloatArray  # (K, C)
    contexts: tuple[str, ...]
    mode_prob: FloatArray  # (K, M)
    modes: tuple[str, ...]
    steps: Table  # (K,) rows of Step
    windows: Windows
    start_time_s: float
    duration_s: float
    weighting: str
    notes: tuple[str, ...] = field(default=())  # what was odd about it, in plain words
    fixes: tuple[FixResult, ...] = field(default=())
    start_position_m: FloatArray = field(default_factory=lambda: read_only(np.zeros(2)))  # (2,) before the first step

    def __repr__(self) -> str:
        return f"Track({self.name!r}, {self.n_steps} steps, {self.distance_m:.1f} m, {self.weighting})"

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return len(self.time_s)

    @property
    def distance_m(self) -> float:
        """Walked distance: the sum of the step lengths."""
        return float(self.step_length_m.sum())

    @property
    def mode_entropy(self) -> FloatArray:
        """Entropy of the mode probabilities after each step, shape (K,), nats: 0 where one mode is certain."""
        p = self.mode_prob
        return -(p * np.log(p, where=p > 0, out=np.zeros_like(p))).sum(axis=1)

    @property
    def effective_modes(self) -> FloatArray:
        """Number of modes that are as good as alive after each step, shape (K,): e to the entropy, 1 to M."""
        return np.exp(self.mode_entropy)

    def report(self) -> str:
        """What the track is, how sure it is, and where not to trust it, in plain words; see `pdr_filter.trust`."""
        from pdr_filter import trust

        return trust.report(self)

    def speed_mps(self, t: ArrayLike) -> FloatArray:
        """Walking speed at times t, m/s, same shape as t: step length over duration during a step, else zero."""
        at = np.asarray(t, dtype=float)
        if self.n_steps == 0:
            return np.zeros_like(at)
        index = np.searchsorted(self.time_s, at)  # the first contact at or after t ends the step that t is in
        inside = np.minimum(index, self.n_steps - 1)
        duration = np.asarray(self.steps.duration_s)[inside]
        walking = (index < self.n_steps) & (at >= self.time_s[inside] - duration)
        return np.where(walking, self.step_length_m[inside] / duration, 0.0)

    def context_seconds(self) -> dict[str, float]:
        """Seconds spent in each context: every window votes for its most probable one."""
        if len(self.windows) == 0:
            return dict.fromkeys(self.contexts, 0.0)
        starts = np.concatenate([[self.start_time_s], self.windows.time_s[:-1]])
        seconds = np.minimum(self.windows.time_s - starts, 2.0)  # the first window, or the first after a gap, is 2 s
        best = self.windows.context_prob.argmax(axis=1)
        return {name: float(seconds[best == c].sum()) for c, name in enumerate(self.contexts)}

    def summary(self) -> dict[str, Any]:
        """What `pdr-filter track --json` prints: name, n_steps, distance_m, duration_s, end, contexts."""
        end = self.position_m[-1] if self.n_steps else np.zeros(2)
        return {
            "name": self.name,
            "n_steps": self.n_steps,
            "distance_m": round(self.distance_m, 3),
            "duration_s": round(self.duration_s, 3),
            "end_east_m": round(float(end[0]), 3),
            "end_north_m": round(float(end[1]), 3),
            "contexts": {name: round(seconds, 1) for name, seconds in self.context_seconds().items()},
        }

    def to_csv(self, path: str | Path) -> Path:
        """Write one line for each step and return the path; see `pdr_filter.io.writers.write_csv`."""
        from pdr_filter.io import writers

        return writers.write_csv(self, path)

    def to_parquet(self, path: str | Path) -> Path:
        """Write the columns of `to_csv` with all digits and return the path; needs the extra `parquet`."""
        from pdr_filter.io import writers

        return writers.write_parquet(self, path)

    def to_geojson(self, path: str | Path, origin: tuple[float, float]) -> Path:
        """Write a GeoJSON line in WGS 84 and return the path; `origin` is (lat_deg, lon_deg) of the start."""
        from pdr_filter.io import writers

        return writers.write_geojson(self, path, origin)

    def to_gpx(self, path: str | Path, origin: tuple[float, float], epoch_s: float = 0.0) -> Path:
        """Write a GPX 1.1 track and return the path; `epoch_s` is the unix time of time zero."""
        from pdr_filter.io import writers

        return writers.write_gpx(self, path, origin, epoch_s)

    def to_tum(self, path: str | Path) -> Path:
        """Write TUM lines (timestamp tx ty tz qx qy qz qw) and return the path."""
        from pdr_filter.io import writers

        return writers.write_tum(self, path)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw the track with covariance ellipses above its context probabilities; saved if a path is given."""
        from pdr_filter import plotting

        return plotting.plot_track(self, path)
