"""What one phone is known for: the bias of its gyroscope, carried from recording to recording."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pdr_filter.values import FloatArray, check_array, limits, pickled, read_only

# How far the bias of a phone wanders from a day to the next, and with each kelvin. Data sheets of phone gyroscopes
# give 0.01 to 0.05 degrees/s for a kelvin, 0.0002 to 0.0009 rad/s; phones subtract most of the slow part themselves.
_WALK_RADPS_PER_SQRT_DAY = 0.0005
_RADPS_PER_KELVIN = 0.0003


@dataclass(frozen=True, slots=True, eq=False)
class Device:
    """Bias of a phone's gyroscope as a recording knew it in the end, and how well; `Track.device` has it.

    Given to the next recording of the same phone (`pdr_filter.track(..., device=...)`), whose heading is then good from
    its first second on. The axes are those of the sensor.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> recording = pdr.simulate.demo_walk()
    >>> _ = pdr.track(recording).device.save("phone.json")
    >>> track = pdr.track(recording, device="phone.json")  # or of the next walk with the same phone
    """

    bias_radps: FloatArray = field(default_factory=lambda: read_only(np.zeros(3)))  # (3,)
    bias_cov_radps2: FloatArray = field(default_factory=lambda: read_only(0.005**2 * np.eye(3)))  # (3, 3)

    __reduce__ = pickled

    def __post_init__(self) -> None:
        bias, cov = np.asarray(self.bias_radps, dtype=float), np.asarray(self.bias_cov_radps2, dtype=float)
        check_array("bias_radps", bias, shape=(3,))
        check_array("bias_cov_radps2", cov, shape=(3, 3))
        if np.abs(cov - cov.T).max() > 1e-12 or np.linalg.eigvalsh(cov).min() <= 0:
            raise ValueError(f"bias_cov_radps2 must be symmetric and positive definite, got {cov.tolist()}")
        object.__setattr__(self, "bias_radps", read_only(bias))
        object.__setattr__(self, "bias_cov_radps2", read_only(cov))

    def after(self, days: float = 0.0, warmer_k: float = 0.0) -> Device:
        """The same phone some days later, or at another temperature: less is known of its bias."""
        check_array("days", days, "0 or more")
        check_array("warmer_k", warmer_k)
        grown = _WALK_RADPS_PER_SQRT_DAY**2 * days + (_RADPS_PER_KELVIN * warmer_k) ** 2
        return Device(self.bias_radps, self.bias_cov_radps2 + grown * np.eye(3))

    def save(self, path: str | Path) -> Path:
        """Write it as JSON and return the path."""
        # Only when called: sensing opens no files.
        from pdr_filter.io.files.safe_files import write_text

        content = {"bias_radps": self.bias_radps.tolist(), "bias_cov_radps2": self.bias_cov_radps2.tolist()}
        return write_text(path, json.dumps({"pdr_filter_device": 1, **content}, indent=1) + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Device:
        """Read what `save` wrote; ValueError that names the file if it is none."""
        from pdr_filter.io.files.safe_files import read_json

        try:
            content = read_json(Path(path), limits.MAX_SMALL_BYTES)
            if content["pdr_filter_device"] != 1:
                raise ValueError(f"version {content['pdr_filter_device']}")
            return cls(np.array(content["bias_radps"], float), np.array(content["bias_cov_radps2"], float))
        except Exception as error:  # whatever a damaged file provokes
            raise ValueError(f"{path}: no device file of pdr_filter ({error}); write one with Device.save") from None
