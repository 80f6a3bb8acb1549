"""Which way is up, and how far the device has turned about it: the vqf filter as a causal stage.

VQF: D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
rejection", Information Fusion 91 (2023), doi:10.1016/j.inffus.2022.10.014. Its state is carried as plain values, so
that a filter can be saved in the middle of a walk. Its bias estimation is off: `pdr_filter.sensing.bias` does it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from vqf import VQF

from pdr_filter.sensing.bias import BiasWindow, GyroBias, GyroBiasState
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.values import STANDARD_GRAVITY_MPS2, BoolArray, FloatArray, check_numbers, replace

# The device turns about up by what a rotation that leaves gravity's tilt alone would: against an attitude tilted by
# theta an error of the tilt enters the heading times tan(theta / 2), 0.6 at 60 degrees. Then a new one is needed.
_MAX_TILT_COS = 0.5

# Columns of the samples that wait for a whole window of the bias.
_RATE, _FORCE, _UP, _FIELD, _QUAT = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 16)
_HEADING, _RATE_KNOWN, _FIELD_KNOWN = 16, 17, 18
_NO_SAMPLES = np.empty((0, 19))


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
    quat: FloatArray = field(default_factory=lambda: np.empty((0, 4)))  # (N, 4) wxyz, sensor to the attitude's frame


@dataclass(frozen=True, eq=False)
class AttitudeState:
    """The state of vqf as plain values, the heading turned so far, and the bias of the gyroscope."""

    vqf: Mapping[str, Any] | None  # None before the first sample
    device_heading_rad: float
    reference_quat: FloatArray | None  # (4,) attitude against which the device turns; None: the next one
    reference_up: FloatArray | None  # (3,) up in the sensor frame there
    twist_rad: float  # of the last sample against the reference
    bias: GyroBiasState
    window: FloatArray  # (R, 19) samples since the last whole window of the bias


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
        return AttitudeState(None, 0.0, None, None, 0.0, self.bias.init(), _NO_SAMPLES)

    def _filter(self) -> Any:  # vqf has no types
        return VQF(1.0 / self.rate_hz, tauAcc=self.tau_acc_s, motionBiasEstEnabled=False, restBiasEstEnabled=False)

    def after_gap(self, state: AttitudeState) -> AttitudeState:
        """State that forgets the smoothed gravity, because the device may have been turned, and keeps the bias."""
        if state.vqf is None:
            return state
        return replace(
            state,
            # vqf starts its low-pass afresh from NaN, exactly as at the first sample
            vqf={**state.vqf, "accLpState": self._initial["accLpState"]},
            reference_quat=None,
            reference_up=None,
            twist_rad=0.0,
            bias=self.bias.after_gap(state.bias),
            window=_NO_SAMPLES,
        )

    def step(self, state: AttitudeState, block: UniformBlock) -> tuple[AttitudeState, AttitudeBlock]:
        """New state and the attitude of each sample.

        A missing angular rate enters as zero: the inclination then follows the specific force alone, and the heading
        stands still; the filter behind it has to widen its heading covariance.
        """
        estimator = self._filter()
        if state.vqf is not None:
            estimator.state = state.vqf
        start, n, pieces = 0, len(block.time_s), list[tuple[FloatArray, FloatArray, FloatArray]]()
        biases, lengths = list[GyroBiasState](), list[int]()
        while start < n:
            end = min(start + self._window_samples - len(state.window), n)
            biases.append(state.bias)
            lengths.append(end - start)
            state, found = self._turn(state, estimator, block, slice(start, end))
            pieces.append(found)
            start = end
        quat, up, heading_rad = (
            pieces[0] if len(pieces) == 1 else [np.concatenate(c) for c in zip(*pieces, strict=True)]
        )
        east, north = _horizontal(quat, block.specific_force_mps2)
        bias_cov = np.repeat([bias.bias_cov_radps2 for bias in biases], lengths, axis=0)
        errors = np.repeat([(b.heading_error_rad, b.heading_error_var_rad2) for b in biases], lengths, axis=0)
        attitude = AttitudeBlock(
            vertical_mps2=_dot(up, block.specific_force_mps2) - STANDARD_GRAVITY_MPS2,
            horizontal_mps2=np.stack([east, north], axis=1),
            up_sensor=up,
            device_heading_rad=heading_rad,
            yaw_bias_std_radps=np.sqrt(_variance_along(up, bias_cov)),
            heading_error_rad=errors[:, 0],
            heading_error_var_rad2=errors[:, 1],
            quat=quat,
        )
        return replace(state, vqf=estimator.state), attitude

    def _turn(
        self, state: AttitudeState, estimator: Any, block: UniformBlock, piece: slice
    ) -> tuple[AttitudeState, tuple[FloatArray, FloatArray, FloatArray]]:
        """State with its bias; attitudes, up and headings of samples of one window."""
        known, measured = block.angular_rate_known[piece], block.angular_rate_radps[piece]
        rate = np.where(known[:, None], measured - state.bias.bias_radps, 0.0)
        force = np.ascontiguousarray(block.specific_force_mps2[piece])
        quat: FloatArray = estimator.updateBatch(rate, force)["quat6D"]
        up = _up_in_sensor_frame(quat)
        state, heading_rad = _follow_heading(state, quat, up, known, -_dot(rate[:1], up[:1])[0] / self.rate_hz)
        rows = np.empty((len(up), _NO_SAMPLES.shape[1]))
        rows[:, _RATE], rows[:, _FORCE], rows[:, _UP] = measured, force, up
        rows[:, _FIELD], rows[:, _QUAT] = block.magnetic_field_ut[piece], quat
        rows[:, _HEADING], rows[:, _RATE_KNOWN] = heading_rad, known
        rows[:, _FIELD_KNOWN] = block.magnetic_field_known[piece]
        window = np.concatenate([state.window, rows]) if len(state.window) else rows
        found = quat, up, heading_rad
        if len(window) < self._window_samples:
            return replace(state, window=window), found
        bias = self.bias.step(state.bias, _bias_window(window))
        return replace(state, bias=bias, window=_NO_SAMPLES), found


def _bias_window(rows: FloatArray) -> BiasWindow:
    """What the bias needs of a whole window."""
    mean = np.add.reduce(rows) / len(rows)
    away = rows[:, :6] - mean[:6]
    rate_x, rate_y, rate_z, force_x, force_y, force_z = (np.add.reduce(away * away) / len(rows)).tolist()
    up = mean[_UP]
    field_ut, field_known = np.zeros(3), bool(mean[_FIELD_KNOWN] == 1.0)
    if field_known:
        field_ut = _mean_rotated(rows[:, _QUAT], rows[:, _FIELD])
    return BiasWindow(
        angular_rate_radps=mean[_RATE],
        angular_rate_std_radps=math.sqrt(rate_x + rate_y + rate_z),
        specific_force_std_mps2=math.sqrt(force_x + force_y + force_z),
        up_sensor=up / math.sqrt(float(up @ up)),
        heading_rad=float(mean[_HEADING]),
        angular_rate_known=bool(mean[_RATE_KNOWN] == 1.0),
        magnetic_field_ut=field_ut,
        magnetic_field_known=field_known,
    )


def _follow_heading(
    state: AttitudeState, quat: FloatArray, up: FloatArray, rate_known: BoolArray, first_turn_rad: float
) -> tuple[AttitudeState, FloatArray]:
    """Headings (N,) of consecutive attitudes; one without reference has turned by `first_turn_rad` and is the first."""
    turned = np.empty(len(quat))
    reference, reference_up, twist_rad, start = state.reference_quat, state.reference_up, state.twist_rad, 0
    if reference is None or reference_up is None:
        reference, reference_up, turned[0], start = quat[0].copy(), up[0].copy(), first_turn_rad, 1
    while start < len(quat):
        (too_far,) = (_dot(up[start:], reference_up[None, :]) < _MAX_TILT_COS).nonzero()
        end = start + int(too_far[0]) + 1 if len(too_far) else len(quat)
        twist = _twist(quat[start:end], reference)
        turned[start] = twist[0] - twist_rad
        turned[start + 1 : end] = twist[1:] - twist[:-1]
        twist_rad = float(twist[-1])
        if len(too_far):
            reference, reference_up, twist_rad = quat[end - 1].copy(), up[end - 1].copy(), 0.0
        start = end
    turned = np.where(rate_known, turned - 2 * np.pi * np.round(turned / (2 * np.pi)), 0.0)
    turned[0] += state.device_heading_rad
    heading_rad = np.cumsum(turned)
    new = replace(
        state,
        device_heading_rad=float(heading_rad[-1]),
        reference_quat=reference,
        reference_up=reference_up,
        twist_rad=twist_rad,
    )
    return new, heading_rad


def _twist(quat: FloatArray, reference: FloatArray) -> FloatArray:
    """Clockwise turn about up from a reference attitude (4,) to attitudes (N, 4), without the tilt between them."""
    w, x, y, z = quat.T
    a, b, c, d = reference.tolist()
    along = -w * d - x * c + y * b + z * a
    real = w * a + x * b + y * c + z * d
    return -2.0 * np.arctan2(along, real)


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
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def _horizontal(quat: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """East and north of vectors in the sensor frame, written out so that no sum order can change."""
    w, x, y, z = quat.T
    a, b, c = vector.T
    zz, xy, wz = z * z, x * y, w * z
    east = (1 - 2 * (y * y + zz)) * a + 2 * (xy - wz) * b + 2 * (x * z + w * y) * c
    north = 2 * (xy + wz) * a + (1 - 2 * (x * x + zz)) * b + 2 * (y * z - w * x) * c
    return east, north


def _mean_rotated(quat: FloatArray, vector: FloatArray) -> FloatArray:
    """Mean (3,) of vectors (N, 3) turned by (N, 4) to east, north and up, from mean products of q_i, q_j and v_k."""
    pairs = (quat[:, :, None] * quat[:, None, :]).reshape(len(quat), 16)
    of_pairs = (pairs.T @ vector / len(quat)).reshape(4, 4, 3).tolist()
    w, x, y, z = range(4)
    total = (np.add.reduce(vector) / len(quat)).tolist()

    def along(i: int, j: int, k: int) -> float:
        return of_pairs[i][j][k]

    east = total[0] - 2 * (along(y, y, 0) + along(z, z, 0))
    east += 2 * (along(x, y, 1) - along(w, z, 1)) + 2 * (along(x, z, 2) + along(w, y, 2))
    north = 2 * (along(x, y, 0) + along(w, z, 0)) + total[1] - 2 * (along(x, x, 1) + along(z, z, 1))
    north += 2 * (along(y, z, 2) - along(w, x, 2))
    up = 2 * (along(x, z, 0) - along(w, y, 0)) + 2 * (along(y, z, 1) + along(w, x, 1))
    return np.array([east, north, up + total[2] - 2 * (along(x, x, 2) + along(y, y, 2))])
