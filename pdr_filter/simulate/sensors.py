"""What the sensors make of the exact signals: noise, bias, scale, clipping, quantisation, time jitter."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray

_DEG = np.pi / 180


@dataclass(frozen=True, slots=True)
class SensorError:
    """Errors of one sensor, in its unit (m/s2, rad/s, uT or hPa); the default is a perfect one."""

    noise_density: float = 0.0  # white, unit/sqrt(Hz): a sample has the standard deviation density * sqrt(rate / 2)
    bias_std: float = 0.0  # of the constant bias of each axis
    bias_walk: float = 0.0  # random walk of the bias, unit/sqrt(s)
    scale_std: float = 0.0  # of the relative scale error of each axis
    quantum: float = 0.0  # smallest step of the output; 0 for none
    full_scale: float = np.inf  # larger values are clipped

    def apply(self, values: FloatArray, rate_hz: float, rng: np.random.Generator) -> FloatArray:
        """What the sensor gives for the true values, (N, axes)."""
        axes = values.shape[1]
        bias = self.bias_std * rng.standard_normal(axes)
        scale = 1.0 + self.scale_std * rng.standard_normal(axes)
        walk = np.cumsum(rng.standard_normal(values.shape), axis=0) * (self.bias_walk / np.sqrt(rate_hz))
        noise = rng.standard_normal(values.shape) * (self.noise_density * np.sqrt(rate_hz / 2))
        measured = np.clip(scale * values + bias + walk + noise, -self.full_scale, self.full_scale)
        return np.round(measured / self.quantum) * self.quantum if self.quantum > 0 else measured


# AKM AK09911: 14 bit, 0.6 uT/LSB. Noise and what is left of hard iron after a phone's own calibration: assumed.
_AK09911 = SensorError(noise_density=0.06, bias_std=1.5, bias_walk=0.01, scale_std=0.01, quantum=0.6, full_scale=4912.0)


# A phone's barometer and its air: draughts of 0.06 m over a second and 0.025 m over a root second as on one storey of
# ipin21, and the weather of the day.
BAROMETER = SensorError(noise_density=0.01, bias_std=10.0, bias_walk=0.003, quantum=0.001)


def _accelerometer(noise_ug: float) -> SensorError:
    return SensorError(
        noise_density=noise_ug * 1e-6 * STANDARD_GRAVITY_MPS2,
        bias_std=0.010 * STANDARD_GRAVITY_MPS2,
        bias_walk=2e-4,
        scale_std=0.005,
        quantum=STANDARD_GRAVITY_MPS2 / 4096,
        full_scale=8 * STANDARD_GRAVITY_MPS2,
    )


def _gyroscope(noise_mdps: float) -> SensorError:
    return SensorError(
        noise_density=noise_mdps * 1e-3 * _DEG,
        bias_std=0.2 * _DEG,
        bias_walk=2e-5,
        scale_std=0.01,
        quantum=_DEG / 16.4,
        full_scale=2000 * _DEG,
    )


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """Errors of all sensors of a phone; `SensorErrors()` is a typical phone, `SensorErrors.none()` a perfect one.

    The default is a TDK InvenSense ICM-20600 (100 ug/sqrt(Hz), 4 mdps/sqrt(Hz), scale 1 %; +-8 g at 4096 LSB/g,
    +-2000 deg/s at 16.4 LSB/(deg/s)) with an AKM AK09911. Offsets in data sheets are those before a phone's own
    calibration (BMI160: 40 mg, 3 deg/s), so 10 mg and 0.2 deg/s are assumed to be left; bias walks are assumed too.
    """

    accelerometer: SensorError = field(default_factory=lambda: _accelerometer(100.0))
    gyroscope: SensorError = field(default_factory=lambda: _gyroscope(4.0))
    magnetometer: SensorError = _AK09911
    barometer: SensorError | None = None  # None: the phone has none; `BAROMETER` is that of many
    jitter_s: float = 2e-4  # standard deviation of the reported time of a sample about the true one

    @classmethod
    def none(cls) -> SensorErrors:
        """Perfect sensors and clocks."""
        return cls(SensorError(), SensorError(), SensorError(), jitter_s=0.0)

    @classmethod
    def bmi160(cls) -> SensorErrors:
        """Bosch BMI160 (180 ug/sqrt(Hz), 7 mdps/sqrt(Hz)), else as the default."""
        return cls(accelerometer=_accelerometer(180.0), gyroscope=_gyroscope(7.0))
