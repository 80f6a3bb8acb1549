"""Which way is up, and how far the device has turned about it: the vqf filter as a causal stage.

VQF: D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
rejection", Information Fusion 91 (2023), doi:10.1016/j.inffus.2022.10.014. Its state is carried as plain values, so
that a filter can be saved in the middle of a walk. Its bias estimation is off: `pdr_filter.sensing.gyroscope_bias` does
it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from vqf import VQF

from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.gyroscope_bias import BiasWindow, GyroBias, GyroBiasState
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, check_numbers, replace_unchecked

# The device turns about up by what a rotation that leaves gravity's tilt alone would: against an attitude tilted by
# theta an error of the tilt enters the heading times tan(theta / 2), 0.6 at 60 degrees. Then a new one is needed.
_MAX_TILT_COS = 0.5

# Columns of the samples that wait for a whole window of the bias; the field and 1 side by side, to be turned alike.
_RATE, _FORCE, _FIELD, _ONE, _QUAT = slice(0, 3), slice(3, 6), slice(6, 9), 9, slice(10, 14)
_FIELD_AND_ONE = slice(6, 10)
_HEADING, _RATE_KNOWN, _FIELD_KNOWN = 14, 15, 16
_NO_SAMPLES = np.empty((0, 17))


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeBlock:
    """Attitude of the device for each uniform sample, and what follows from it."""

    vertical_mps2: FloatArray  # (N,) specific force along up, minus standard gravity
    horizontal_mps2: FloatArray  # (N, 2) east, north of the attitude's own frame (its north is the first heading)
    up_sensor: FloatArray  # (N, 3) unit vector up, sensor frame: what gravity direction means here
    device_heading_rad: FloatArray  # (N,) clockwise from the first heading, not wrapped
    yaw_bias_std_radps: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) error of the heading's rate
    heading_error_rad: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) that biases found late have left
    heading_error_var_rad2: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,)
    heading_lost_var_rad2: FloatArray = field(default_factory=lambda: np.empty(0))  # (N,) gained by the bias so far
    quat: FloatArray = field(default_factory=lambda: np.empty((0, 4)))  # (N, 4) wxyz, sensor to the attitude's frame


@dataclass(frozen=True, eq=False)
class AttitudeState:
    """The state of vqf as plain values, the heading turned so far, and the bias of the gyroscope."""

    vqf: Mapping[str, Any] | None  # None before the first sample
    device_heading_rad: float
    reference_quat: FloatArray | None  # (4,) attitude against which the device turns; None: the next one
    twist_rad: float  # of the last sample against the reference
    bias: GyroBiasState
    window: FloatArray  # (R, 17) samples since the last whole window of the bias


@dataclass(frozen=True)
class AttitudeEstimator:
    """Gravity direction and heading change from specific force, angular rate and the drift of the magnetic field.

    The heading is the turn about up of the attitude against an earlier one (its twist in the swing-twist
    decomposition): with q the quaternion of the sensor's attitude now and q_0 then, d = q q_0*, the heading is
    psi = -2 atan2(d_z, d_w). This has no singular attitude short of upside down, and long before that a new reference
    takes over. Unlike the integral of the angular rate about the vertical it comes back when the device does: while up
    goes round a cone of half angle theta, that integral gains the solid angle 2 pi (1 - cos theta) each round. (It is
    the noncommutativity that J. E. Bortz, "A new mathematical formulation for strapdown inertial navigation", IEEE
    Trans. Aerospace and Electronic Systems 7(1), 1971, doi:10.1109/TAES.1971.310252, treats.)

    Parameters
    ----------
    tau_acc_s : float
        Time constant of the inclination correction (VQF default).
    bias : GyroBias
        How the bias of the gyroscope is learnt. Its estimate after a window is taken off the samples of the next.
    """

    rate_hz: float = 100.0
    tau_acc_s: float = 3.0
    bias: GyroBias = field(default_factory=GyroBias)

    def __post_init__(self) -> None:
        check_numbers(self)

    @cached_property
    def _initial(self) -> Mapping[str, Any]:
        return self._filter().state

    @cached_property
    def _window_samples(self) -> int:
        return max(round(self.bias.window_s * self.rate_hz), 1)

    def init(self) -> AttitudeState:
        """State before the first sample."""
        return AttitudeState(None, 0.0, None, 0.0, self.bias.init(), _NO_SAMPLES)

    def _filter(self) -> Any:  # vqf has no types
        return VQF(1.0 / self.rate_hz, tauAcc=self.tau_acc_s, motionBiasEstEnabled=False, restBiasEstEnabled=False)

    def after_gap(self, state: AttitudeState) -> AttitudeState:
        """State that forgets the smoothed gravity, because the device may have been turned, and keeps the bias."""
        if state.vqf is None:
            return state
        return replace_unchecked(
            state,
            # vqf starts its low-pass afresh from NaN, exactly as at the first sample
            vqf={**state.vqf, "accLpState": self._initial["accLpState"]},
            reference_quat=None,
            twist_rad=0.0,
            bias=self.bias.after_gap(state.bias),
            window=_NO_SAMPLES,
        )

    def update(self, state: AttitudeState, block: UniformBlock) -> tuple[AttitudeState, AttitudeBlock]:
        """New state and the attitude of each sample.

        A missing angular rate enters as zero: the inclination then follows the specific force alone, and the heading
        stands still; the filter behind it has to widen its heading covariance.
        """
        estimator = self._filter()
        if state.vqf is not None:
            estimator.state = state.vqf
        rows, first = _rows(state.window, block), len(state.window)
        begin, biases, lengths = 0, list[GyroBiasState](), list[int]()
        while first < len(rows):
            end = min(begin + self._window_samples, len(rows))
            biases.append(state.bias)
            lengths.append(end - first)
            state = self._turn(state, estimator, rows[first:end])
            if end - begin == self._window_samples:
                state = replace_unchecked(state, bias=self.bias.update(state.bias, _bias_window(rows[begin:end])))
                begin = end
            first = end
        new = rows[len(state.window) :]
        quat = np.ascontiguousarray(new[:, _QUAT])
        up = _up_in_sensor_frame(quat)
        bias_cov = np.repeat([bias.bias_cov_radps2 for bias in biases], lengths, axis=0)
        errors = [(b.heading_error_rad, b.heading_error_var_rad2, b.heading_lost_var_rad2) for b in biases]
        error_rad, error_var_rad2, lost_var_rad2 = np.repeat(errors, lengths, axis=0).T
        attitude = AttitudeBlock(
            vertical_mps2=_dot(up, block.specific_force_mps2) - STANDARD_GRAVITY_MPS2,
            horizontal_mps2=_horizontal(quat, block.specific_force_mps2),
            up_sensor=up,
            device_heading_rad=new[:, _HEADING].copy(),
            yaw_bias_std_radps=np.sqrt(_variance_along(up, bias_cov)),
            heading_error_rad=error_rad,
            heading_error_var_rad2=error_var_rad2,
            heading_lost_var_rad2=lost_var_rad2,
            quat=quat,
        )
        return replace_unchecked(state, vqf=estimator.state, window=rows[begin:].copy()), attitude

    def _turn(self, state: AttitudeState, estimator: Any, rows: FloatArray) -> AttitudeState:
        """State after samples of one window, whose attitudes and headings are filled in."""
        rate = rows[:, _RATE_KNOWN, None] * (rows[:, _RATE] - state.bias.bias_radps)
        rows[:, _QUAT] = estimator.updateBatch(rate, np.ascontiguousarray(rows[:, _FORCE]))["quat6D"]
        return self._follow_heading(state, rows, rate[0])

    def _follow_heading(self, state: AttitudeState, rows: FloatArray, first_rate_radps: FloatArray) -> AttitudeState:
        """State after consecutive attitudes, whose headings are filled in.

        One without reference is the first, and has turned by its angular rate (3,).
        """
        quat, turned, start = rows[:, _QUAT], np.empty(len(rows)), 0
        reference, twist_rad = state.reference_quat, state.twist_rad
        if reference is None:
            reference, start = quat[0].copy(), 1
            turned[0] = -_dot(first_rate_radps[None], _up_in_sensor_frame(quat[:1]))[0] / self.rate_hz
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


def _rows(waiting: FloatArray, block: UniformBlock) -> FloatArray:
    """The samples that wait and those of a block, whose attitudes and headings are still to be filled in."""
    rows = np.empty((len(waiting) + len(block.time_s), waiting.shape[1]))
    rows[: len(waiting)], new = waiting, rows[len(waiting) :]
    new[:, _RATE], new[:, _FORCE] = block.angular_rate_radps, block.specific_force_mps2
    new[:, _FIELD], new[:, _ONE] = block.magnetic_field_ut, 1.0
    new[:, _RATE_KNOWN], new[:, _FIELD_KNOWN] = block.angular_rate_known, block.magnetic_field_known
    return rows


def _bias_window(rows: FloatArray) -> BiasWindow:
    """What the bias needs of a whole window."""
    mean = np.add.reduce(rows) / len(rows)
    away = rows[:, :6] - mean[:6]
    rate_x, rate_y, rate_z, force_x, force_y, force_z = (np.add.reduce(away * away) / len(rows)).tolist()
    up, field_ut = _mean_turned(rows[:, _QUAT], rows[:, _FIELD_AND_ONE], mean[_FIELD])
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


def _real_and_along_up(quat: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Real and up part of d = q q_0*, by which attitudes (N, 4) are turned from a reference (4,).

    The twist, the clockwise turn about up without the tilt, is -2 atan2(d_z, d_w); the tilt theta has
    d_w^2 + d_z^2 = (1 + cos theta) / 2.
    """
    w, x, y, z = quat.T
    a, b, c, d = reference.tolist()
    return w * a + x * b + y * c + z * d, -w * d - x * c + y * b + z * a


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Row by row, written out so that no sum order can change."""
    return a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]


def _variance_along(up: FloatArray, cov: FloatArray) -> FloatArray:
    """Quadratic form up' C up for directions (N, 3) and symmetric matrices (N, 3, 3)."""
    x, y, z = up.T
    diagonal = cov[:, 0, 0] * x * x + cov[:, 1, 1] * y * y + cov[:, 2, 2] * z * z
    return diagonal + 2.0 * (cov[:, 0, 1] * x * y + cov[:, 0, 2] * x * z + cov[:, 1, 2] * y * z)


def _up_in_sensor_frame(quat: FloatArray) -> FloatArray:
    """Third row of the sensor-to-world rotation matrix of unit quaternions wxyz (N, 4)."""
    w, x, y, z = quat.T
    up = np.empty((len(quat), 3))
    up[:, 0], up[:, 1], up[:, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return up


def _horizontal(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """East and north (N, 2) of vectors in the sensor frame, written out so that no sum order can change."""
    w, x, y, z = quat.T
    a, b, c = vector.T
    zz, xy, wz = z * z, x * y, w * z
    horizontal = np.empty((len(quat), 2))
    horizontal[:, 0] = (1 - 2 * (y * y + zz)) * a + 2 * (xy - wz) * b + 2 * (x * z + w * y) * c
    horizontal[:, 1] = 2 * (xy + wz) * a + (1 - 2 * (x * x + zz)) * b + 2 * (y * z - w * x) * c
    return horizontal


def _mean_turned(
    quat: FloatArray, vector_and_one: FloatArray, mean_vector: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mean up (3,) in the sensor frame, and mean (3,) of vectors turned by (N, 4) to east, north and up.

    From mean products of q_i, q_j and v_k; the vectors (N, 4), whose mean is given, have a fourth part v_3 = 1.
    """
    pairs = (quat[:, :, None] * quat[:, None, :]).reshape(len(quat), 16)
    of_pairs = (pairs.T @ vector_and_one / len(quat)).reshape(4, 4, 4).tolist()
    w, x, y, z = range(4)
    a, b, c = mean_vector.tolist()

    def twice(i: int, j: int, k: int) -> float:
        return 2 * of_pairs[i][j][k]

    east = a - twice(y, y, 0) - twice(z, z, 0) + twice(x, y, 1) - twice(w, z, 1) + twice(x, z, 2) + twice(w, y, 2)
    north = twice(x, y, 0) + twice(w, z, 0) + b - twice(x, x, 1) - twice(z, z, 1) + twice(y, z, 2) - twice(w, x, 2)
    up = twice(x, z, 0) - twice(w, y, 0) + twice(y, z, 1) + twice(w, x, 1) + c - twice(x, x, 2) - twice(y, y, 2)
    up_sensor = [twice(x, z, 3) - twice(w, y, 3), twice(y, z, 3) + twice(w, x, 3), 1 - twice(x, x, 3) - twice(y, y, 3)]
    return np.array(up_sensor), np.array([east, north, up])
