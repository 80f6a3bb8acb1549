"""Which way is up, and how far the device has turned about it: the vqf filter as a causal stage.

VQF: D. Laidig, T. Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic disturbance
rejection", Information Fusion 91 (2023), doi:10.1016/j.inffus.2022.10.014. Its state is carried as plain values, so
that a filter can be saved in the middle of a walk.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from vqf import VQF

from pdr_filter.conditioning import UniformBlock
from pdr_filter.types import STANDARD_GRAVITY_MPS2, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeBlock:
    """Attitude of the device for each uniform sample, and what follows from it."""

    vertical_mps2: FloatArray  # (N,) specific force along up, minus standard gravity
    horizontal_mps2: FloatArray  # (N, 2) east, north of the attitude's own frame (its north is the first heading)
    up_sensor: FloatArray  # (N, 3) unit vector up, sensor frame: what gravity direction means here
    device_heading_rad: FloatArray  # (N,) clockwise from the first heading, not wrapped


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeState:
    """The state of vqf as plain values, and the heading turned so far."""

    vqf: Mapping[str, Any] | None  # None before the first sample
    device_heading_rad: float


@dataclass(frozen=True)
class AttitudeEstimator:
    """Gravity direction and heading change from specific force and angular rate.

    The heading is the angular rate about the vertical, integrated: unlike the direction of one device axis it has no
    singular attitude, so that it works for a phone upright in a pocket as well as flat in the hand.

    Parameters
    ----------
    rate_hz : float
        Sampling rate of the blocks.
    tau_acc_s : float
        Time constant of the inclination correction (VQF default).
    rest_gyr_dps, rest_acc_mps2 : float
        Thresholds of vqf's rest detector. A hand that holds a phone still trembles more than vqf's defaults allow
        (2 deg/s, 0.5 m/s2).
    motion_bias : bool
        vqf's bias estimation during motion. Off: on phones it mistakes walking for bias and turns a good track.
    """

    rate_hz: float = 100.0
    tau_acc_s: float = 3.0
    rest_gyr_dps: float = 2.0
    rest_acc_mps2: float = 0.5
    motion_bias: bool = False

    @cached_property
    def _initial(self) -> Mapping[str, Any]:
        return self._filter().state

    def init(self) -> AttitudeState:
        """State before the first sample."""
        return AttitudeState(None, 0.0)

    def _filter(self) -> Any:  # vqf has no types
        return VQF(
            1.0 / self.rate_hz,
            tauAcc=self.tau_acc_s,
            motionBiasEstEnabled=self.motion_bias,
            restThGyr=self.rest_gyr_dps,
            restThAcc=self.rest_acc_mps2,
        )

    def after_gap(self, state: AttitudeState) -> AttitudeState:
        """State that forgets the smoothed gravity, because the device may have been turned, and keeps the bias."""
        if state.vqf is None:
            return state
        # vqf starts its low-pass afresh from NaN, exactly as at the first sample
        return replace(state, vqf={**state.vqf, "accLpState": self._initial["accLpState"]})

    def step(self, state: AttitudeState, block: UniformBlock) -> tuple[AttitudeState, AttitudeBlock]:
        """New state and the attitude of each sample.

        A missing angular rate enters as zero: the inclination then follows the specific force alone, and the heading
        stands still; the filter behind it has to widen its heading covariance.
        """
        estimator = self._filter()
        if state.vqf is not None:
            estimator.state = state.vqf
        out = estimator.updateBatch(block.angular_rate_radps, block.specific_force_mps2)
        quat: FloatArray = out["quat6D"]
        bias: FloatArray = np.where(block.angular_rate_known[:, None], out["bias"], 0.0)
        up = _up_in_sensor_frame(quat)
        rate = block.angular_rate_radps - bias
        turn_rate = -(rate[:, 0] * up[:, 0] + rate[:, 1] * up[:, 1] + rate[:, 2] * up[:, 2])
        turned = np.cumsum(np.concatenate([[state.device_heading_rad], turn_rate / self.rate_hz]))
        east, north, vertical = _rotate(quat, block.specific_force_mps2)
        attitude = AttitudeBlock(
            vertical_mps2=vertical - STANDARD_GRAVITY_MPS2,
            horizontal_mps2=np.column_stack([east, north]),
            up_sensor=up,
            device_heading_rad=turned[1:],
        )
        return replace(state, vqf=estimator.state, device_heading_rad=float(turned[-1])), attitude


def _up_in_sensor_frame(quat: FloatArray) -> FloatArray:
    """Third row of the sensor-to-world rotation matrix of unit quaternions wxyz (N, 4)."""
    w, x, y, z = quat.T
    return np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def _rotate(quat: FloatArray, vector: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """East, north and up components of vectors in the sensor frame, written out so that no sum order can change."""
    w, x, y, z = quat.T
    a, b, c = vector.T
    east = (1 - 2 * (y * y + z * z)) * a + 2 * (x * y - w * z) * b + 2 * (x * z + w * y) * c
    north = 2 * (x * y + w * z) * a + (1 - 2 * (x * x + z * z)) * b + 2 * (y * z - w * x) * c
    up = 2 * (x * z - w * y) * a + 2 * (y * z + w * x) * b + (1 - 2 * (x * x + y * y)) * c
    return east, north, up
