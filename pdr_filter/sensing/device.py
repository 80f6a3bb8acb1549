"""Gyroscope bias of one phone, carried from recording to recording."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pdr_filter.values import FloatArray, check_array, limits, read_only, reduction
from pdr_filter.values.safe_files import read_json, write_text

# Random walk of the bias per square root of a day, and change of the bias per kelvin. Data sheets of phone gyroscopes
# state 0.01 to 0.05 degrees/s per kelvin, 0.0002 to 0.0009 rad/s. Phones subtract most of the slow part themselves.
_WALK_RADPS_PER_SQRT_DAY = 0.0005
_RADPS_PER_KELVIN = 0.0003


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """Gyroscope bias of one phone with its covariance, as estimated at the end of a recording.

    `Track.device` holds it. Pass it to the next recording of the same phone with `pdr_filter.track(..., device=...)`,
    whose heading is then accurate from the first second. A smoothed walk with fixes determines the bias best. The axes
    are those of the sensor frame.

    Attributes
    ----------
    bias_radps : FloatArray
        Angular rate that the gyroscope reads at rest, shape (3,), rad/s. Default: zero.
    bias_cov_radps2 : FloatArray
        Covariance of the error of the bias, shape (3, 3), (rad/s)^2. Default: a standard deviation of 0.005 rad/s for
        each axis.

    Raises
    ------
    ValueError
        If a shape is wrong, or the covariance is not symmetric and positive definite.

    Examples
    --------
    >>> import numpy as np
    >>> import pdr_filter as pdr
    >>> device = pdr.Device(np.array([0.001, 0.0, -0.002]), 1e-8 * np.eye(3))
    >>> np.sqrt(device.after(days=7.0).bias_cov_radps2[0, 0]).round(5)
    np.float64(0.00133)

    A device is saved for the next recording of the same phone, ``pdr.track(recording, device="phone.json")``:

    >>> import pathlib, tempfile
    >>> path = device.save(pathlib.Path(tempfile.mkdtemp()) / "phone.json")
    >>> pdr.Device.load(path).bias_radps
    array([ 0.001,  0.   , -0.002])
    """

    bias_radps: FloatArray = field(default_factory=lambda: read_only(np.zeros(3)))
    bias_cov_radps2: FloatArray = field(default_factory=lambda: read_only(0.005**2 * np.eye(3)))

    __reduce__ = reduction

    def __post_init__(self) -> None:
        bias, cov = np.asarray(self.bias_radps, dtype=float), np.asarray(self.bias_cov_radps2, dtype=float)
        check_array("bias_radps", bias, shape=(3,))
        check_array("bias_cov_radps2", cov, shape=(3, 3))
        if np.abs(cov - cov.T).max() > 1e-12 or np.linalg.eigvalsh(cov).min() <= 0:
            raise ValueError(
                f"bias_cov_radps2 must be symmetric and positive definite, got {cov.tolist()}: pass a covariance "
                "matrix, such as 0.005**2 * np.eye(3)"
            )
        object.__setattr__(self, "bias_radps", read_only(bias))
        object.__setattr__(self, "bias_cov_radps2", read_only(cov))

    def after(self, days: float = 0.0, warmer_k: float = 0.0) -> Device:
        """Return the same phone some days later or at another temperature, with a larger covariance of its bias.

        Parameters
        ----------
        days : float, default 0
            Time since the recording in days, not negative. The standard deviation grows by 0.0005 rad/s per square root
            of a day.
        warmer_k : float, default 0
            Difference of temperature in kelvin, of either sign. The standard deviation grows by 0.0003 rad/s per
            kelvin.

        Returns
        -------
        Device
            The same bias with the larger covariance.

        Raises
        ------
        ValueError
            If `days` is negative, or an argument is not finite.
        """
        check_array("days", days, "0 or more")
        check_array("warmer_k", warmer_k)
        grown = _WALK_RADPS_PER_SQRT_DAY**2 * days + (_RADPS_PER_KELVIN * warmer_k) ** 2
        return Device(self.bias_radps, self.bias_cov_radps2 + grown * np.eye(3))

    def save(self, path: str | Path) -> Path:
        """Write the bias and its covariance to a JSON file and return its path.

        Parameters
        ----------
        path : str or Path
            File to write. An existing file is replaced.

        Returns
        -------
        Path
            Path of the file.
        """
        content = {"bias_radps": self.bias_radps.tolist(), "bias_cov_radps2": self.bias_cov_radps2.tolist()}
        return write_text(path, json.dumps({"pdr_filter_device": 1, **content}, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Device:
        """Return the device that `Device.save` has written to a file.

        Parameters
        ----------
        path : str or Path
            File written by `Device.save`.

        Returns
        -------
        Device
            Bias and covariance of the file.

        Raises
        ------
        ValueError
            If the file is missing or damaged, or is not a device file. The message names the file.
        """
        try:
            content = read_json(Path(path), limits.MAX_SMALL_BYTES)
            if content["pdr_filter_device"] != 1:
                raise ValueError(f"it has format version {content['pdr_filter_device']} instead of 1")
            return cls(np.array(content["bias_radps"], float), np.array(content["bias_cov_radps2"], float))
        except Exception as error:  # a damaged file can raise any exception
            raise ValueError(f"{path}: no device file of pdr_filter ({error}); write one with Device.save") from None
