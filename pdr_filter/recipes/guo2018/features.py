"""Features of Guo et al. 2018 in windows of 0.6 s: 18 pose features (Table 1) and the level of motion (eq. 1).

Pitch and roll are in radians and follow from the vertical direction in the sensor frame. Roll is undefined for a
vertical y-axis, and noisy near it, as in a trouser pocket. The level of motion is computed at every sample (Table 2).

Deviation from the paper: roll is about the y-axis, unwrapped within a window, with its mean in [-pi, pi). The paper has
it about the z-axis, which is the heading and cannot be seen in gravity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.features.sliding_windows import DescribedWindow, SlidingWindows, WindowBuffer, no_samples
from pdr_filter.values import BoolArray, FloatArray, Samples, check_numbers
from pdr_filter.values.recording import Recording

_ANGLE_STATISTICS = ("mean", "median", "max", "min", "rms", "range")
_AMBIENT_STATISTICS = ("mean", "median", "rms")
# Table 1 from top to bottom. Angles are in radians, light in lux, proximity in centimetres.
NAMES: tuple[str, ...] = (
    *(f"{s}_pitch" for s in _ANGLE_STATISTICS),
    *(f"{s}_roll" for s in _ANGLE_STATISTICS),
    *(f"{s}_light" for s in _AMBIENT_STATISTICS),
    *(f"{s}_proximity" for s in _AMBIENT_STATISTICS),
)
WITHOUT_LIGHT_AND_PROXIMITY: tuple[str, ...] = NAMES[:12]


def pitch_and_roll(up_sensor: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pitch in [-pi/2, pi/2] and roll in [-pi, pi] of a device, each (N,), from unit vectors up (N, 3).

    The rotation from sensor to world is R = R_z(yaw) R_x(pitch) R_y(roll), with right-handed rotations from a device
    that lies flat, face up, with y to the north. Then up = [-sin(roll) cos(pitch), sin(pitch),
    cos(roll) cos(pitch)]. Pitch is positive with the top edge up, roll with the right edge down. (Android's
    `getOrientation` has the same roll and the opposite pitch.)
    """
    x, y, z = up_sensor.T
    return np.arcsin(np.clip(y, -1.0, 1.0)), np.arctan2(-x, z)


def pose_features(window: FloatArray) -> FloatArray:
    """Return the features of a window in the order of `NAMES`: (18,), or (12,) without light and proximity.

    The rows of the window, (2, N) or (4, N), are pitch and roll in radians, light in lux and proximity in cm.
    """
    if window.ndim != 2 or window.shape[0] not in (2, 4) or window.shape[1] == 0:
        raise ValueError(
            f"window must have 2 rows (pitch, roll) or 4 rows (also light, proximity) and at least one sample, got "
            f"shape {window.shape}"
        )
    angles = [_angle_statistics(window[0]), _angle_statistics(_continuous(window[1]))]
    return np.concatenate([*angles, *(_ambient_statistics(row) for row in window[2:])])


def _angle_statistics(angle_rad: FloatArray) -> FloatArray:
    highest, lowest = angle_rad.max(), angle_rad.min()
    return np.array([angle_rad.mean(), np.median(angle_rad), highest, lowest, _rms(angle_rad), highest - lowest])


def _ambient_statistics(values: FloatArray) -> FloatArray:
    return np.array([values.mean(), np.median(values), _rms(values)])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values * values).mean()))


def _continuous(angle_rad: FloatArray) -> FloatArray:
    """Return the unwrapped angle, shifted so that its mean is in [-pi, pi)."""
    continuous = np.unwrap(angle_rad)
    turns = np.floor((continuous.mean() + np.pi) / (2 * np.pi))
    return continuous - 2 * np.pi * turns


# Factor alpha of eq. 1.
RATE_SCALE = 9.8


@dataclass(frozen=True, slots=True, eq=False)
class MotionLevelState:
    """Samples of the last window, from which the next levels of motion are computed."""

    n_samples: int  # samples of this segment so far
    # (6, L - 1): specific force, its squared norm, squared norm of the angular rate, 1 for samples without angular rate
    delay_line: FloatArray


@dataclass(frozen=True)
class MotionLevel:
    """Level of motion T_n of a phone in m2/s4 (Guo et al. 2018, eq. 1), causal, at every sample.

    It is the variance of the specific force plus 9.8 times the mean squared angular rate, and shows whether a person
    moves.

    T_n = (1/N) sum_k (|f_k - mean f|^2 + 9.8 |w_k|^2), with specific force f in m/s2 and angular rate w in rad/s. The
    sum is over the samples of the last `window_s`, or over all samples so far at the start of a segment.
    """

    rate_hz: float = 100.0
    window_s: float = 0.6

    def __post_init__(self) -> None:
        check_numbers(self)

    @property
    def window_samples(self) -> int:
        """Length of the window in samples."""
        return round(self.window_s * self.rate_hz)

    def init(self) -> MotionLevelState:
        """Return the state at the start of a segment, that is, of samples without a gap."""
        return MotionLevelState(0, np.zeros((6, self.window_samples - 1)))

    def update(self, state: MotionLevelState, block: UniformBlock) -> tuple[MotionLevelState, FloatArray, BoolArray]:
        """Return the new state, the levels of motion, and whether the angular rate is known.

        Both arrays (N,) have one value for the window that ends at each sample.
        """
        x, y, z = block.specific_force_mps2.T
        u, v, w = block.angular_rate_radps.T
        known = block.angular_rate_known
        new = np.stack(
            [x, y, z, x * x + y * y + z * z, np.where(known, u * u + v * v + w * w, 0.0), (~known).astype(float)]
        )
        line = np.concatenate([state.delay_line, new], axis=1)
        # each output is one dot product over the window, so that results are bit-identical for any split into blocks
        sums = np.stack([np.convolve(row, np.ones(self.window_samples), mode="valid") for row in line])
        seen = np.minimum(state.n_samples + 1 + np.arange(sums.shape[1]), self.window_samples)
        x, y, z, force, rate, missing = sums / seen
        has_rate = missing == 0.0
        # rounding can make the difference of two numbers near g^2 slightly negative
        level = np.maximum(force - (x * x + y * y + z * z), 0.0) + np.where(has_rate, RATE_SCALE * rate, 0.0)
        return MotionLevelState(state.n_samples + len(known), line[:, len(known) :]), level, has_rate


@dataclass(frozen=True, slots=True, eq=False)
class AmbientSamples:
    """Light and proximity of a recording, which the features of the pose use.

    Phones report both only when they change. A value holds until the next one, and the first one also before.

    Attributes
    ----------
    light, proximity : Samples
        Illuminance in lux and distance in cm, values of shape (N, 1).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.recipes.guo2018.features import AmbientSamples
    >>> from pdr_filter.values import Samples
    >>> light, near = (Samples(np.array([1.0, 2.0]), np.array([[v], [0.0]])) for v in (300.0, 5.0))
    >>> AmbientSamples(light, near).at(np.array([0.0, 1.9, 2.0]))
    array([[300., 300.,   0.],
           [  5.,   5.,   0.]])
    """

    light: Samples
    proximity: Samples

    @classmethod
    def of(cls, recording: Recording) -> AmbientSamples:
        """Return the samples of a recording.

        Parameters
        ----------
        recording : Recording
            Recording with light and proximity.

        Returns
        -------
        AmbientSamples
            Its finite samples, ordered by time.

        Raises
        ------
        ValueError
            If light or proximity is missing or has no finite value.
        """
        streams: list[Samples] = []
        for name in ("light", "proximity"):
            samples = recording.streams.get(name)
            known = np.zeros(0, bool) if samples is None else np.isfinite(samples.values[:, 0])
            if samples is None or not known.any():
                raise ValueError(
                    f"{recording.name or 'the recording'} has no {name}, which 6 of the 18 features of the pose need: "
                    "use a model of the 12 features of pitch and roll"
                )
            order = np.argsort(samples.time_s[known], kind="stable")
            streams.append(Samples(samples.time_s[known][order], samples.values[known][order]))
        return cls(*streams)

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return light and proximity at some times.

        Parameters
        ----------
        time_s : (N,) array
            Times in s.

        Returns
        -------
        (2, N) array
            Illuminance in lux and distance in cm.
        """
        rows: list[FloatArray] = []
        for samples in (self.light, self.proximity):
            last = np.searchsorted(samples.time_s, time_s, side="right") - 1
            rows.append(samples.values[np.maximum(last, 0), 0])
        return np.stack(rows)


@dataclass(frozen=True, slots=True, eq=False)
class PoseWindow(DescribedWindow):
    """Features of one window, and the level of motion at its end in m2/s4.

    `has_gyroscope` is True if the level includes the angular rate.
    """

    features: FloatArray  # (18,), or (12,) without light and proximity
    level: float  # level of motion in this window
    has_gyroscope: bool


@dataclass(frozen=True, slots=True, eq=False)
class PoseWindowState:
    """State of the level of motion, and samples of the signals that later windows need."""

    level: MotionLevelState
    # rows: pitch, roll, light and proximity if known, level of motion, 1 if its window has an angular rate
    buffer: WindowBuffer


@dataclass(frozen=True)
class PoseWindows(SlidingWindows[PoseWindowState, PoseWindow]):
    """Causal windows of pitch and roll, with their features and the level of motion.

    With `ambient`, the light and proximity of the recording, windows have all 18 features.
    """

    window_s: float = 0.6
    hop_s: float = 0.6
    ambient: AmbientSamples | None = None

    @cached_property
    def _level(self) -> MotionLevel:
        return MotionLevel(self.rate_hz, self.window_s)

    def init(self) -> PoseWindowState:
        return PoseWindowState(self._level.init(), no_samples(4 if self.ambient is None else 6))

    def update(
        self, state: PoseWindowState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[PoseWindowState, list[tuple[int, PoseWindow]]]:
        level_state, level, has_rate = self._level.update(state.level, block)
        ambient = () if self.ambient is None else self.ambient.at(block.time_s)
        signals = np.vstack([*pitch_and_roll(attitude.up_sensor), *ambient, level, has_rate.astype(float)])
        buffer, windows = self.cut(state.buffer, block.time_s, signals)
        found = [
            (
                w.last,
                PoseWindow(
                    start_s=w.start_s,
                    time_s=w.end_s,
                    features=pose_features(w.samples[:-2]),
                    level=float(w.samples[-2, -1]),
                    has_gyroscope=bool(w.samples[-1, -1]),
                ),
            )
            for w in windows
        ]
        return PoseWindowState(level_state, buffer), found
