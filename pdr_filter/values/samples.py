"""Samples of one sensor, and of all on one time base."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pdr_filter.values.arrays import FloatArray, read_only

#: Standard gravity, m/s2.
STANDARD_GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Samples:
    """One sensor stream at its own timestamps."""

    time_s: FloatArray  # (N,) seconds from the first accelerometer sample; as recorded, so not always increasing
    values: FloatArray  # (N, d) in the units of the stream (`Recording` names them); NaN where a field was empty

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_s", read_only(self.time_s, "time_s"))
        object.__setattr__(self, "values", read_only(self.values))
        if self.time_s.ndim != 1 or self.values.ndim != 2 or len(self.time_s) != len(self.values):
            raise ValueError(
                f"time_s must be (N,) and values (N, d), got {self.time_s.shape} and {self.values.shape}: "
                "give one time for each row"
            )

    def __len__(self) -> int:
        return len(self.time_s)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled and copied through the constructor, so that the arrays stay read-only."""
        return type(self), (self.time_s, self.values)

    def __repr__(self) -> str:
        return f"Samples({len(self)} x {self.values.shape[1]})"


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

    def parts(self, n: int) -> Iterator[ImuBlock]:
        """The block in pieces of at most n samples."""
        if len(self.time_s) <= n:
            yield self
            return
        for start in range(0, len(self.time_s), n):
            part = slice(start, start + n)
            yield ImuBlock(
                self.time_s[part],
                self.specific_force_mps2[part],
                self.angular_rate_radps[part],
                self.magnetic_field_ut[part],
            )
