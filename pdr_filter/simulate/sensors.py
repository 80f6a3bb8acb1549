"""Sensor errors: noise, bias, scale, clipping, quantisation and time jitter."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray

_DEG = np.pi / 180


@dataclass(frozen=True, slots=True)
class SensorError:
    """Errors of one sensor, in its unit (m/s2, rad/s, uT or hPa). The default is a perfect sensor.

    Attributes
    ----------
    noise_density : float, default 0.0
        Density of the white noise in unit/sqrt(Hz). A sample has the standard deviation density * sqrt(rate / 2).
    bias_std, bias_walk : float, default 0.0
        Standard deviation of the constant bias of each axis, and random walk of the bias in unit/sqrt(s).
    scale_std : float, default 0.0
        Standard deviation of the relative scale error of each axis.
    quantum, full_scale : float, default 0.0 and infinity
        Resolution of the output, 0 for no quantisation, and largest output, to which values are clipped.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.simulate import SensorError
    >>> error = SensorError(quantum=0.5, full_scale=1.0)
    >>> error.apply(np.array([[0.3], [2.0]]), rate_hz=100.0, rng=np.random.default_rng(0))
    array([[0.5],
           [1. ]])
    """

    noise_density: float = 0.0
    bias_std: float = 0.0
    bias_walk: float = 0.0
    scale_std: float = 0.0
    quantum: float = 0.0
    full_scale: float = np.inf

    def apply(self, values: FloatArray, rate_hz: float, rng: np.random.Generator) -> FloatArray:
        """Return sensor readings for true values.

        Parameters
        ----------
        values : (N, axes) array
            True values at a constant rate.
        rate_hz : float
            Sampling rate in Hz.
        rng : numpy.random.Generator
            Source of the random errors.

        Returns
        -------
        (N, axes) array
            Values with errors.
        """
        axes = values.shape[1]
        bias = self.bias_std * rng.standard_normal(axes)
        scale = 1.0 + self.scale_std * rng.standard_normal(axes)
        walk = np.cumsum(rng.standard_normal(values.shape), axis=0) * (self.bias_walk / np.sqrt(rate_hz))
        noise = rng.standard_normal(values.shape) * (self.noise_density * np.sqrt(rate_hz / 2))
        measured = np.clip(scale * values + bias + walk + noise, -self.full_scale, self.full_scale)
        return np.round(measured / self.quantum) * self.quantum if self.quantum > 0 else measured


# AKM AK09911: 14 bit, 0.6 uT/LSB. The noise and the hard iron left after the phone's own calibration are assumptions.
_AK09911 = SensorError(noise_density=0.06, bias_std=1.5, bias_walk=0.01, scale_std=0.01, quantum=0.6, full_scale=4912.0)


# Typical barometer of a phone, including changes of the air: draughts of 0.06 m in a second and a random walk of 0.025
# m per root second, as measured on one storey of ipin21, and the weather of the day as bias.
BAROMETER = SensorError(noise_density=0.01, bias_std=10.0, bias_walk=0.003, quantum=0.001)
# Root mean square over the axes of the mean rates of 17 phones at rest, in rad/s, in windows of 1 s: one phone each of
# ipin2023, motionsense, ms_indoor and oxiod, and the phones of 13 people of ubicomp13.
BIASES_AT_REST_RADPS = (
    0.0027, 0.0005, 0.0009, 0.0001,
    0.0090, 0.0016, 0.0154, 0.0316, 0.0068, 0.0024, 0.0185, 0.0228, 0.0569, 0.0027, 0.0024, 0.0010, 0.0431,
)  # fmt: skip


def _accelerometer(noise_ug: float) -> SensorError:
    """Return the errors of a phone accelerometer with a noise density in ug/sqrt(Hz)."""
    return SensorError(
        noise_density=noise_ug * 1e-6 * STANDARD_GRAVITY_MPS2,
        bias_std=0.010 * STANDARD_GRAVITY_MPS2,
        bias_walk=2e-4,
        scale_std=0.005,
        quantum=STANDARD_GRAVITY_MPS2 / 4096,
        full_scale=8 * STANDARD_GRAVITY_MPS2,
    )


def _gyroscope(noise_mdps: float) -> SensorError:
    """Return the errors of a phone gyroscope with a noise density in mdps/sqrt(Hz)."""
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
    """Errors of all sensors of a phone. `SensorErrors()` is a typical phone, `SensorErrors.none()` a perfect one.

    Attributes
    ----------
    accelerometer, gyroscope, magnetometer : SensorError
        Errors of the sensors. The defaults are the errors of a TDK InvenSense ICM-20600 and an AKM AK09911.
    barometer : SensorError, optional
        Errors of the barometer. By default the phone has no barometer. `simulate.BAROMETER` is a typical one.
    jitter_s : float, default 2e-4
        Standard deviation in s of the reported time of a sample about the true time.

    Notes
    -----
    ICM-20600: 100 ug/sqrt(Hz), 4 mdps/sqrt(Hz), scale 1 %, +-8 g at 4096 LSB/g, +-2000 deg/s at 16.4 LSB/(deg/s).
    Offsets in data sheets are those before the calibration by the phone (BMI160: 40 mg, 3 deg/s). Remaining offsets of
    10 mg and 0.2 deg/s are assumptions, and so are the bias walks.

    Examples
    --------
    >>> from pdr_filter.simulate import BAROMETER, Leg, SensorErrors, simulate
    >>> walk = simulate([Leg("stationary", duration_s=2.0)], errors=SensorErrors(barometer=BAROMETER))
    >>> walk.barometer is None
    False
    """

    accelerometer: SensorError = field(default_factory=lambda: _accelerometer(100.0))
    gyroscope: SensorError = field(default_factory=lambda: _gyroscope(4.0))
    magnetometer: SensorError = _AK09911
    barometer: SensorError | None = None
    jitter_s: float = 2e-4

    @classmethod
    def none(cls) -> SensorErrors:
        """Return perfect sensors and clocks.

        Returns
        -------
        SensorErrors
            Errors of zero, without a barometer.
        """
        return cls(SensorError(), SensorError(), SensorError(), jitter_s=0.0)

    @classmethod
    def random(cls, seed: int) -> SensorErrors:
        """Return the errors of a phone whose gyroscope bias is as large as that of a random real phone at rest.

        Parameters
        ----------
        seed : int
            Seed. Equal seeds give equal phones.

        Returns
        -------
        SensorErrors
            Errors with a gyroscope bias from `BIASES_AT_REST_RADPS`. All other errors have their default.
        """
        bias_radps = float(np.random.default_rng([seed, 2]).choice(BIASES_AT_REST_RADPS))
        errors = cls()
        return replace(errors, gyroscope=replace(errors.gyroscope, bias_std=bias_radps))

    @classmethod
    def bmi160(cls) -> SensorErrors:
        """Return the errors of a phone with a Bosch BMI160.

        Returns
        -------
        SensorErrors
            Errors with 180 ug/sqrt(Hz) and 7 mdps/sqrt(Hz). All other errors have their default.
        """
        return cls(accelerometer=_accelerometer(180.0), gyroscope=_gyroscope(7.0))
