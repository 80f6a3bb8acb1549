"""Attitude of the device: the direction of up and the heading change, from the VQF filter as a causal stage.

VQF: D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
rejection", Information Fusion 91 (2023), doi:10.1016/j.inffus.2022.10.014. The state of VQF is carried as plain values,
so that a filter can be saved during a walk. The bias estimation of VQF is off, because it takes walking for a bias:
`pdr_filter.sensing.gyroscope_bias` estimates the bias.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from vqf import VQF

from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.gyroscope_bias import BiasWindow, GyroBias, GyroBiasState
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, check_numbers, replace_unchecked

# Cosine of the largest tilt against the reference attitude, 60 degrees. At a tilt theta, an error of the inclination
# enters the heading (the twist about up) times tan(theta / 2), which is 0.6 at 60 degrees. Beyond that a new reference
# attitude is taken.
_MAX_TILT_COS = 0.5

# Columns of the samples buffered for a complete bias window. The field and the constant 1 are adjacent, because
# `_mean_up_and_vector` multiplies both by the products of the quaternions.
_RATE, _FORCE, _FIELD, _ONE, _QUAT = slice(0, 3), slice(3, 6), slice(6, 9), 9, slice(10, 14)
_FIELD_AND_ONE = slice(6, 10)
_HEADING, _RATE_KNOWN, _FIELD_KNOWN = 14, 15, 16
_NO_SAMPLES = np.empty((0, 17))


class BiasSpan(NamedTuple):
    """Consecutive samples whose angular rate was corrected with one estimate of the gyroscope bias."""

    n_samples: int
    bias_radps: FloatArray  # (3,) estimate of the bias, rad/s
    window: BiasWindow | None  # bias window that ended at the first sample. None if no window ended there.


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeBlock:
    """Attitude of the device at each uniform sample, with the quantities derived from it.

    The attitude frame is east, north, up, where north is the first heading of the device.

    Attributes
    ----------
    vertical_mps2 : FloatArray
        Specific force along up minus standard gravity, shape (N,), m/s2.
    horizontal_mps2 : FloatArray
        Specific force along east and north of the attitude frame, shape (N, 2), m/s2.
    up_sensor : FloatArray
        Unit vector up in the sensor frame, shape (N, 3).
    device_heading_rad : FloatArray
        Heading of the device, clockwise from the first heading, not wrapped, shape (N,), rad.
    yaw_bias_std_radps : FloatArray
        Standard deviation of the gyroscope bias about the vertical, shape (N,), rad/s. It is the standard deviation of
        the rate of the heading error.
    heading_error_rad : FloatArray
        Estimated error of `device_heading_rad`, shape (N,), rad: the turn accumulated by wrong bias estimates of
        earlier times. Subtract it to correct the heading.
    heading_error_var_rad2 : FloatArray
        Variance of `heading_error_rad`, shape (N,), rad2.
    heading_lost_var_rad2 : FloatArray
        Heading variance added by the uncertain bias since the start, without reductions by measurements, shape (N,),
        rad2.
    quat : FloatArray
        Unit quaternions wxyz that rotate the sensor frame to the attitude frame, shape (N, 4).
    spans : tuple of BiasSpan
        Parts of the block with one estimate of the gyroscope bias each.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.sensing.attitude import AttitudeBlock
    >>> up = np.tile([0.0, 0.0, 1.0], (4, 1))
    >>> block = AttitudeBlock(np.zeros(4), np.zeros((4, 2)), up, device_heading_rad=np.zeros(4))
    >>> block.up_sensor.shape
    (4, 3)
    """

    vertical_mps2: FloatArray
    horizontal_mps2: FloatArray
    up_sensor: FloatArray
    device_heading_rad: FloatArray
    yaw_bias_std_radps: FloatArray = field(default_factory=lambda: np.empty(0))
    heading_error_rad: FloatArray = field(default_factory=lambda: np.empty(0))
    heading_error_var_rad2: FloatArray = field(default_factory=lambda: np.empty(0))
    heading_lost_var_rad2: FloatArray = field(default_factory=lambda: np.empty(0))
    quat: FloatArray = field(default_factory=lambda: np.empty((0, 4)))
    spans: tuple[BiasSpan, ...] = ()


@dataclass(frozen=True, eq=False)
class AttitudeState:
    """State of VQF, the heading so far, and the state of the bias estimation."""

    vqf: Mapping[str, Any] | None  # state of VQF as plain values. None before the first sample.
    device_heading_rad: float  # heading of the last sample, clockwise, not wrapped, rad
    # (4,) attitude from which the twist is measured. None means the attitude of the next sample.
    reference_quat: FloatArray | None
    twist_rad: float  # twist of the last sample against the reference, clockwise, rad
    bias: GyroBiasState  # state of the bias estimation
    # (R, 17) samples of the present bias window. A complete window updates the bias when the next sample arrives
    # (`AttitudeEstimator.bias_state`), so that not all work on windows falls into one hop.
    window: FloatArray


@dataclass(frozen=True)
class AttitudeEstimator:
    """Causal stage that estimates the direction of up and the heading of the device from uniform samples.

    The specific force corrects the inclination. The angular rate, less its estimated bias, gives the heading change.
    The magnetic field enters only through the bias.

    Parameters
    ----------
    rate_hz : float, default 100
        Sampling rate of the blocks, Hz.
    tau_acc_s : float, default 3
        Time constant of the inclination correction, s (the default of VQF).
    bias : GyroBias, optional
        Estimation of the gyroscope bias. The estimate after a window is subtracted from the samples of the next window.

    Raises
    ------
    ValueError
        If a parameter is not a positive number.

    Notes
    -----
    The heading is the twist about up of the attitude against an earlier reference attitude (swing-twist decomposition).
    With the quaternion q of the sensor's attitude now and q_0 of the reference, d = q q_0*, and the heading is
    psi = -2 atan2(d_z, d_w). It is singular only upside down, and at 60 degrees of tilt a new reference is taken.

    Unlike the integral of the angular rate about the vertical, this heading returns when the device returns. While up
    moves around a cone of half angle theta, that integral gains the solid angle 2 pi (1 - cos theta) in each
    revolution. This is the noncommutativity treated by J. E. Bortz, "A new mathematical formulation for strapdown
    inertial navigation", IEEE Trans. Aerospace and Electronic Systems 7(1), 1971, doi:10.1109/TAES.1971.310252.

    Examples
    --------
    A phone that lies face up and turns clockwise by 90 degrees in one second:

    >>> import numpy as np
    >>> from pdr_filter.sensing.attitude import AttitudeEstimator
    >>> from pdr_filter.sensing.conditioning import Conditioner
    >>> from pdr_filter.values import ImuBlock
    >>> time_s = np.arange(0.0, 3.0, 0.01)
    >>> force, rate = np.zeros((300, 3)), np.zeros((300, 3))
    >>> force[:, 2] = 9.81
    >>> rate[100:200, 2] = -np.pi / 2
    >>> conditioner, estimator = Conditioner(), AttitudeEstimator()
    >>> samples = ImuBlock(time_s, force, rate, magnetic_field_ut=np.full((300, 3), np.nan))
    >>> _, (uniform,) = conditioner.update(conditioner.init(), samples)
    >>> state, attitude = estimator.update(estimator.init(), uniform)
    >>> np.rad2deg(attitude.device_heading_rad[[50, 250]]).round(1) + 0.0
    array([ 0., 90.])
    >>> attitude.up_sensor[250].round(3) + 0.0
    array([0., 0., 1.])
    """

    rate_hz: float = 100.0
    tau_acc_s: float = 3.0
    bias: GyroBias = field(default_factory=GyroBias)

    def __post_init__(self) -> None:
        check_numbers(self)

    @cached_property
    def _initial(self) -> Mapping[str, Any]:
        """State of VQF before the first sample."""
        return self._filter().state

    @cached_property
    def _window_samples(self) -> int:
        """Number of samples in a bias window."""
        return max(round(self.bias.window_s * self.rate_hz), 1)

    def init(self) -> AttitudeState:
        """Return the state before the first sample.

        Returns
        -------
        AttitudeState
            Initial state.
        """
        return AttitudeState(None, 0.0, None, 0.0, self.bias.init(), _NO_SAMPLES)

    def _filter(self) -> Any:  # vqf has no type hints
        return VQF(1.0 / self.rate_hz, tauAcc=self.tau_acc_s, motionBiasEstEnabled=False, restBiasEstEnabled=False)

    def after_gap(self, state: AttitudeState) -> AttitudeState:
        """Return the state after a gap, which keeps the gyroscope bias and forgets the smoothed gravity.

        The device may have been turned during the gap, so the inclination starts again from the next sample. The
        heading continues with its last value.

        Parameters
        ----------
        state : AttitudeState
            State before the gap.

        Returns
        -------
        AttitudeState
            State before the first sample after the gap.
        """
        if state.vqf is None:
            return state
        return replace_unchecked(
            state,
            # NaN makes vqf initialise its low-pass with the next sample, exactly as at the first sample
            vqf={**state.vqf, "accLpState": self._initial["accLpState"]},
            reference_quat=None,
            twist_rad=0.0,
            bias=self.bias.after_gap(self.bias_state(state)),
            window=_NO_SAMPLES,
        )

    def bias_state(self, state: AttitudeState) -> GyroBiasState:
        """Return the state of the bias estimation after all samples so far.

        Parameters
        ----------
        state : AttitudeState
            State after any number of samples.

        Returns
        -------
        GyroBiasState
            State that includes the bias window of `state` if that window is complete.
        """
        return self._after_window(state.bias, state.window)

    def _after_window(self, bias: GyroBiasState, rows: FloatArray) -> GyroBiasState:
        """Return the state of the bias estimation after a window, unchanged if the window is not complete."""
        return self.bias.update(bias, _bias_window(rows)) if len(rows) == self._window_samples else bias

    def update(self, state: AttitudeState, block: UniformBlock) -> tuple[AttitudeState, AttitudeBlock]:
        """Return the new state and the attitude of each sample of a block.

        A missing angular rate enters as zero. The inclination then follows the specific force alone, and the heading
        stays constant, so the caller must inflate the heading covariance.

        Parameters
        ----------
        state : AttitudeState
            State after the previous block.
        block : UniformBlock
            Uniform samples that follow, N samples.

        Returns
        -------
        state : AttitudeState
            New state.
        attitude : AttitudeBlock
            Attitude of each sample.
        """
        estimator = self._filter()
        if state.vqf is not None:
            estimator.state = state.vqf
        rows, first = _buffer_with_block(state.window, block), len(state.window)
        begin, biases, spans = 0, list[GyroBiasState](), list[BiasSpan]()
        while first < len(rows):
            window = None
            if first - begin == self._window_samples:
                window = _bias_window(rows[begin:first])
                state, begin = replace_unchecked(state, bias=self.bias.update(state.bias, window)), first
            end = min(begin + self._window_samples, len(rows))
            biases.append(state.bias)
            spans.append(BiasSpan(end - first, state.bias.bias_radps, window))
            state = self._estimate_attitudes(state, estimator, rows[first:end])
            first = end
        new = rows[len(state.window) :]
        quat = np.ascontiguousarray(new[:, _QUAT])
        up = _up_in_sensor_frame(quat)
        attitude = AttitudeBlock(
            vertical_mps2=_row_dots(up, block.specific_force_mps2) - STANDARD_GRAVITY_MPS2,
            horizontal_mps2=_horizontal(quat, block.specific_force_mps2),
            up_sensor=up,
            device_heading_rad=new[:, _HEADING].copy(),
            quat=quat,
            spans=tuple(spans),
            **_heading_errors(up, biases, [span.n_samples for span in spans]),
        )
        return replace_unchecked(state, vqf=estimator.state, window=rows[begin:].copy()), attitude

    def with_other_bias(
        self, bias: GyroBiasState, turn_rad: float, block: UniformBlock, first: tuple[AttitudeState, AttitudeBlock]
    ) -> tuple[AttitudeState, AttitudeBlock]:
        """Return a result of `update` for another estimate of the gyroscope bias.

        The bias is estimated again from the statistics of the windows. Its change only turns the attitude about the
        vertical. The inclination, which follows the specific force, stays the same.

        Parameters
        ----------
        bias : GyroBiasState
            State of the other bias estimation before the block.
        turn_rad : float
            Change of the device heading before the block, clockwise, rad.
        block : UniformBlock
            Uniform samples.
        first : tuple of AttitudeState and AttitudeBlock
            Result of `update` for this block.

        Returns
        -------
        state : AttitudeState
            State after the block.
        attitude : AttitudeBlock
            Attitude of each sample.
        """
        state, attitude = first
        biases, changes = list[GyroBiasState](), list[FloatArray]()
        lengths = [span.n_samples for span in attitude.spans]
        up_s = attitude.up_sensor * (block.angular_rate_known / self.rate_hz)[:, None]
        sums_s, before_rad = np.add.reduceat(up_s, np.cumsum([0, *lengths[:-1]])), turn_rad
        for span, sum_s in zip(attitude.spans, sums_s, strict=True):
            if span.window is not None:
                bias = self.bias.update(bias, _turned_window(span.window, turn_rad))
            biases.append(bias)
            changes.append(bias.bias_radps - span.bias_radps)
            turn_rad += float(sum_s.dot(changes[-1]))
        turn = before_rad + np.cumsum(_row_dots(up_s, np.repeat(changes, lengths, axis=0)))
        attitude = replace(
            attitude,
            horizontal_mps2=_turned(attitude.horizontal_mps2, turn),
            device_heading_rad=attitude.device_heading_rad + turn,
            quat=_turned_quat(attitude.quat, turn),
            **_heading_errors(attitude.up_sensor, biases, lengths),
        )
        window = state.window.copy()
        window[:, _HEADING] += turn[-1]
        window[:, _QUAT] = _turned_quat(window[:, _QUAT], turn[-1:])
        vqf, reference = dict(state.vqf or {}), state.reference_quat
        (vqf["accQuat"],) = _turned_quat(np.array([vqf["accQuat"]]), turn[-1:])
        state = replace_unchecked(
            state,
            vqf=vqf,
            device_heading_rad=float(attitude.device_heading_rad[-1]),
            reference_quat=None if reference is None else _turned_quat(reference[None], turn[-1:])[0],
            bias=bias,
            window=window,
        )
        return state, attitude

    def _estimate_attitudes(self, state: AttitudeState, estimator: Any, rows: FloatArray) -> AttitudeState:
        """Return the state after consecutive samples of one bias window.

        Attitudes and headings are written into `rows`.
        """
        rate = rows[:, _RATE_KNOWN, None] * (rows[:, _RATE] - state.bias.bias_radps)
        rows[:, _QUAT] = estimator.updateBatch(rate, np.ascontiguousarray(rows[:, _FORCE]))["quat6D"]
        return self._follow_heading(state, rows, rate[0])

    def _follow_heading(self, state: AttitudeState, rows: FloatArray, first_rate_radps: FloatArray) -> AttitudeState:
        """Return the state after consecutive attitudes, and write the device headings into `rows`.

        The change of the heading is the twist of the attitude relative to a reference attitude. In a state without a
        reference, the first attitude becomes the reference. Its heading change then follows from its angular rate
        `first_rate_radps` (3,).
        """
        quat, turned, start = rows[:, _QUAT], np.empty(len(rows)), 0
        reference, twist_rad = state.reference_quat, state.twist_rad
        if reference is None:
            reference, start = quat[0].copy(), 1
            turned[0] = -_row_dots(first_rate_radps[None], _up_in_sensor_frame(quat[:1]))[0] / self.rate_hz
        while start < len(quat):
            real, along = _real_and_along_up(quat[start:], reference)
            (too_far,) = (real * real + along * along < 0.5 * (1.0 + _MAX_TILT_COS)).nonzero()
            n = int(too_far[0]) + 1 if len(too_far) else len(real)
            twist = -2.0 * np.arctan2(along[:n], real[:n])
            turned[start] = twist[0] - twist_rad
            turned[start + 1 : start + n] = twist[1:] - twist[:-1]
            twist_rad, start = float(twist[-1]), start + n
            if len(too_far):
                reference, twist_rad = quat[start - 1].copy(), 0.0
        turned = rows[:, _RATE_KNOWN] * (turned - 2 * np.pi * np.rint(turned / (2 * np.pi)))
        turned[0] += state.device_heading_rad
        rows[:, _HEADING] = heading_rad = turned.cumsum()
        return replace_unchecked(
            state, device_heading_rad=float(heading_rad[-1]), reference_quat=reference, twist_rad=twist_rad
        )


def _buffer_with_block(waiting: FloatArray, block: UniformBlock) -> FloatArray:
    """Return the buffered samples followed by the samples of a block, with attitudes and headings not yet filled in."""
    rows = np.empty((len(waiting) + len(block.time_s), waiting.shape[1]))
    rows[: len(waiting)], new = waiting, rows[len(waiting) :]
    new[:, _RATE], new[:, _FORCE] = block.angular_rate_radps, block.specific_force_mps2
    new[:, _FIELD], new[:, _ONE] = block.magnetic_field_ut, 1.0
    new[:, _RATE_KNOWN], new[:, _FIELD_KNOWN] = block.angular_rate_known, block.magnetic_field_known
    return rows


def _bias_window(rows: FloatArray) -> BiasWindow:
    """Return the statistics that the bias estimation uses, of the samples (N, 17) of a complete window."""
    mean = np.add.reduce(rows) / len(rows)
    away = rows[:, :6] - mean[:6]
    rate_x, rate_y, rate_z, force_x, force_y, force_z = (np.add.reduce(away * away) / len(rows)).tolist()
    up, field_ut = _mean_up_and_vector(rows[:, _QUAT], rows[:, _FIELD_AND_ONE], mean[_FIELD])
    return BiasWindow(
        angular_rate_radps=mean[_RATE],
        angular_rate_std_radps=math.sqrt(rate_x + rate_y + rate_z),
        specific_force_std_mps2=math.sqrt(force_x + force_y + force_z),
        up_sensor=up / math.sqrt(float(up @ up)),
        heading_rad=float(mean[_HEADING]),
        angular_rate_known=bool(mean[_RATE_KNOWN] == 1.0),
        magnetic_field_ut=field_ut,
        magnetic_field_known=bool(mean[_FIELD_KNOWN] == 1.0),
    )


def _heading_errors(up: FloatArray, biases: list[GyroBiasState], lengths: list[int]) -> dict[str, FloatArray]:
    """Return the fields of an `AttitudeBlock` that describe the errors of the heading.

    `up` (N, 3) are the directions up in the sensor frame. `biases` are the states of the bias estimation, each for as
    many consecutive samples as its element of `lengths`.
    """
    bias_cov = np.repeat([bias.bias_cov_radps2 for bias in biases], lengths, axis=0)
    errors = [(b.heading_error_rad, b.heading_error_var_rad2, b.heading_lost_var_rad2) for b in biases]
    error_rad, error_var_rad2, lost_var_rad2 = np.repeat(errors, lengths, axis=0).T
    return {
        "yaw_bias_std_radps": np.sqrt(_variance_along(up, bias_cov)),
        "heading_error_rad": error_rad,
        "heading_error_var_rad2": error_var_rad2,
        "heading_lost_var_rad2": lost_var_rad2,
    }


def _turned_window(window: BiasWindow, turn_rad: float) -> BiasWindow:
    """Return a bias window of a device that is turned clockwise about the vertical."""
    (east, north, up), cosine, sine = window.magnetic_field_ut.tolist(), math.cos(turn_rad), math.sin(turn_rad)
    field_ut = np.array([cosine * east + sine * north, cosine * north - sine * east, up])
    return replace(window, heading_rad=window.heading_rad + turn_rad, magnetic_field_ut=field_ut)


def _turned(vectors: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return vectors (N, 2), east and north, turned clockwise by angles (N,)."""
    (east, north), cosine, sine = vectors.T, np.cos(turn_rad), np.sin(turn_rad)
    return np.stack([cosine * east + sine * north, cosine * north - sine * east], axis=1)


def _turned_quat(quat: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return attitudes (N, 4) turned clockwise about the vertical by angles (N,)."""
    (w, x, y, z), cosine, sine = quat.T, np.cos(0.5 * turn_rad), np.sin(0.5 * turn_rad)
    parts = cosine * w + sine * z, cosine * x + sine * y, cosine * y - sine * x, cosine * z - sine * w
    return np.stack(parts, axis=1)


def _real_and_along_up(quat: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the real part d_w and the part along up, d_z, of the rotation d = q q_0*.

    d leads from a reference attitude q_0 (4,) to attitudes q (N, 4).

    The twist, which is the clockwise turn about up without the tilt, is -2 atan2(d_z, d_w). The tilt theta satisfies
    d_w^2 + d_z^2 = (1 + cos theta) / 2.
    """
    w, x, y, z = quat.T
    a, b, c, d = reference.tolist()
    return w * a + x * b + y * c + z * d, -w * d - x * c + y * b + z * a


def _row_dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the dot products of rows (N, 3), written out so that the order of additions is fixed."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _variance_along(up: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the variance u' C u along directions u (N, 3), for covariance matrices C (N, 3, 3)."""
    x, y, z = up.T
    diagonal = cov[:, 0, 0] * x * x + cov[:, 1, 1] * y * y + cov[:, 2, 2] * z * z
    return diagonal + 2.0 * (cov[:, 0, 1] * x * y + cov[:, 0, 2] * x * z + cov[:, 1, 2] * y * z)


def _up_in_sensor_frame(quat: FloatArray) -> FloatArray:
    """Return the unit vector up in the sensor frame (N, 3) for unit quaternions wxyz (N, 4).

    It is the third row of the rotation matrix from the sensor to the attitude frame.
    """
    w, x, y, z = quat.T
    up = np.empty((len(quat), 3))
    up[:, 0], up[:, 1], up[:, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return up


def _horizontal(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """Return east and north (N, 2) of sensor-frame vectors (N, 3), with a fixed order of additions."""
    w, x, y, z = quat.T
    a, b, c = vector.T
    zz, xy, wz = z * z, x * y, w * z
    horizontal = np.empty((len(quat), 2))
    horizontal[:, 0] = (1 - 2 * (y * y + zz)) * a + 2 * (xy - wz) * b + 2 * (x * z + w * y) * c
    horizontal[:, 1] = 2 * (xy + wz) * a + (1 - 2 * (x * x + zz)) * b + 2 * (y * z - w * x) * c
    return horizontal


def _mean_up_and_vector(
    quat: FloatArray, vector_and_one: FloatArray, mean_vector: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the mean up vector (3,) in the sensor frame, and the mean (3,) of vectors rotated to east, north and up.

    Both are computed from the mean products of q_i, q_j and v_k. `vector_and_one` (N, 4) holds the vectors and v_3 = 1,
    and `mean_vector` (3,) is the mean of the vectors.
    """
    pairs = (quat[:, :, None] * quat[:, None, :]).reshape(len(quat), 16)
    twice = (2 * (pairs.T @ vector_and_one / len(quat))).reshape(4, 4, 4).tolist()
    (_, wx, wy, wz), (_, xx, xy, xz), (_, _, yy, yz), (_, _, _, zz) = twice
    a, b, c = mean_vector.tolist()
    east = a - yy[0] - zz[0] + xy[1] - wz[1] + xz[2] + wy[2]
    north = xy[0] + wz[0] + b - xx[1] - zz[1] + yz[2] - wx[2]
    up = xz[0] - wy[0] + yz[1] + wx[1] + c - xx[2] - yy[2]
    up_sensor = [xz[3] - wy[3], yz[3] + wx[3], 1 - xx[3] - yy[3]]
    return np.array(up_sensor), np.array([east, north, up])
