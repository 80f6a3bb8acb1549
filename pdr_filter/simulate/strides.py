"""How a carried phone moves in a stride: harmonics measured on public recordings, and people drawn around them.

`measured_strides.npz` has for each place of the phone and context the mean strides of people and how strides differ
from those; `tests/benchmarks/stride_harmonics.py` measured it. Harmonics are those of the stride, at half of the step
frequency. Channels: specific force to the right, forward and up, in parts of the vertical force at step frequency;
pitch, roll and yaw of the phone about its mean attitude in the person's frame, radians. Phase 0 is where the vertical
force at step frequency is highest.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import BoolArray, ComplexArray, FloatArray

N_HARMONICS = 20  # of the stride: 19 Hz at two steps a second
N_CHANNELS = 6
FORCE, TURN = slice(0, 3), slice(3, 6)
MEASURED = Path(__file__).with_name("measured_strides.npz")
# Somebody drawn is like one of those measured, and this part of the differences between those away from them: people
# measured are few, and people drawn are 8 % further apart.
PEOPLE_SPREAD = 0.4
_MAX_Z = 2.5
_ODD = np.arange(1, N_HARMONICS + 1) % 2 == 1
# The mirror image, and the phone in the other pocket: the other foot leads.
_MIRROR = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0]) * np.where(_ODD, -1.0, 1.0)[:, None]
# Sideways, the push goes to the side.
_ACROSS = [1, 0, 2, 4, 3, 5]


@dataclass(frozen=True, slots=True, eq=False)
class Strides:
    """The strides of people in one context; a person's differ along a few ways, and in each harmonic alone."""

    people: ComplexArray  # (P, N_HARMONICS, N_CHANNELS) mean strides, the most typical person's first
    people_rest: FloatArray  # (N_HARMONICS, N_CHANNELS) standard deviation between people, where one was measured
    amplitude_mps2: FloatArray  # (P,) vertical specific force at step frequency
    level: FloatArray  # (P, 2) how much the strides of each differ: their forces, their turns
    ways: ComplexArray  # (W, N_HARMONICS, N_CHANNELS) in which they do, in parts of the level
    ways_rest: FloatArray  # (N_HARMONICS, N_CHANNELS)

    def scaled(self, factor: FloatArray) -> Strides:
        """All harmonics times a table (N_HARMONICS, N_CHANNELS)."""
        size = np.abs(factor)
        return replace(
            self,
            people=factor * self.people,
            people_rest=size * self.people_rest,
            ways=factor * self.ways,
            ways_rest=size * self.ways_rest,
        )

    def person(self, rng: np.random.Generator | None, spread: float = PEOPLE_SPREAD) -> Strides:
        """Of one person alone: the most typical one (None), or somebody drawn."""
        like = 0 if rng is None else int(rng.random() * len(self.people))
        mean = self.people[like]
        if rng is not None:
            others = (self.people - self.people.mean(axis=0)) / np.sqrt(len(self.people))
            mean = mean + spread * drawn(others, self.people_rest, rng, 1)[0]
        return replace(
            self, people=mean[None], amplitude_mps2=self.amplitude_mps2[like, None], level=self.level[like, None]
        )

    def differences(self, rng: np.random.Generator, n: int) -> ComplexArray:
        """What single strides of the first person add to the mean, (n, N_HARMONICS, N_CHANNELS)."""
        return np.repeat(self.level[0], 3) * drawn(self.ways, self.ways_rest, rng, n)


def drawn(ways: ComplexArray, rest: FloatArray, rng: np.random.Generator, n: int) -> ComplexArray:
    """Draws (n, N_HARMONICS, N_CHANNELS): normal factors of the ways, and of each harmonic alone."""

    def z(*shape: int) -> FloatArray:
        return np.clip(rng.standard_normal(shape), -_MAX_Z, _MAX_Z)

    along = np.tensordot(z(n, len(ways)), ways, axes=1)
    return along + rest * (z(n, *rest.shape) + 1j * z(n, *rest.shape)) / np.sqrt(2)


def write(tables: dict[tuple[str, str], Strides]) -> None:
    """Write the measured tables, by place and context; three digits are more than they are worth."""
    rows: dict[str, NDArray[np.float16]] = {}
    for (place, context), table in tables.items():
        for field in fields(Strides):
            value = getattr(table, field.name)
            parts = np.stack([value.real, value.imag], axis=-1) if np.iscomplexobj(value) else value
            rows[f"{place}/{context}/{field.name}"] = parts.astype(np.float16)
    np.savez_compressed(MEASURED, **rows)  # pyright: ignore[reportArgumentType]


@cache
def _measured() -> dict[tuple[str, str], Strides]:
    found: dict[tuple[str, str], dict[str, NDArray[np.generic]]] = {}
    with np.load(MEASURED) as rows:
        for key in rows.files:
            place, context, name = key.split("/")
            value = rows[key].astype(float)
            complex_ = name in ("people", "ways")
            found.setdefault((place, context), {})[name] = value[..., 0] + 1j * value[..., 1] if complex_ else value
    return {key: Strides(**row) for key, row in found.items()}  # type: ignore[arg-type]


@cache
def strides_in(place: str, context: str) -> Strides:
    """What was measured there, or made of what was measured elsewhere.

    Stairs and running come from the pocket, even and odd harmonics of each channel as much weaker or stronger as they
    are in walking; running with a raised hand from the other hand.
    """
    measured = _measured()
    if (place, context) in measured:
        return measured[place, context]
    here = measured[place, "walking"]
    if context == "sideways":
        return replace(
            here,
            people=here.people[..., _ACROSS],
            people_rest=here.people_rest[..., _ACROSS],
            ways=here.ways[..., _ACROSS],
            ways_rest=here.ways_rest[..., _ACROSS],
        )
    if context == "running" and place in ("texting", "calling"):
        return measured["swinging", context]
    there, found = measured["pocket", "walking"], measured["pocket", context]
    ratio = np.empty((N_HARMONICS, N_CHANNELS))
    for some in (_ODD, ~_ODD):
        ratio[some] = np.sqrt(_power(here, some) / _power(there, some))
    ratio[:, FORCE] /= ratio[1, 2]  # of the vertical force at step frequency
    return found.scaled(ratio)


def _power(strides: Strides, some: BoolArray) -> FloatArray:
    """Of each channel, (N_CHANNELS,), over some of the harmonics, mean over people."""
    return (np.abs(strides.people[:, some]) ** 2).sum(axis=1).mean(axis=0)


def usual_force_mps2(place: str, context: str) -> float:
    """Vertical specific force at step frequency, geometric mean over people."""
    return float(np.exp(np.log(strides_in(place, context).amplitude_mps2).mean()))


def of_person(place: str, context: str, habit: int | None, side: float) -> Strides:
    """Of the most typical person (None) or of somebody drawn, who is the same in all contexts; -1 is the left side."""
    rng = None if habit is None else np.random.default_rng([habit, *place.encode()])
    own = strides_in(place, context).person(rng)
    return own.scaled(_MIRROR) if side < 0 else own


def waveform(stride: FloatArray, mean: ComplexArray, differences: ComplexArray, first: int) -> FloatArray:
    """Courses (N, N_CHANNELS) over the strides counted by `stride` (N,), increasing.

    The differences of the strides from number `first` on, (n, N_HARMONICS, N_CHANNELS), are in full where a stride
    begins; raised cosines lead from one to the next.
    """
    result = np.empty((len(stride), mean.shape[1]))
    begin = np.searchsorted(stride, first + np.arange(len(differences)))
    for k, (a, b) in enumerate(pairwise(begin)):
        if a == b:
            continue
        turns = np.exp(2j * np.pi * stride[a:b, None])
        harmonics = np.cumprod(np.broadcast_to(turns, (b - a, len(mean))), axis=1)
        share = 0.5 - 0.5 * np.cos(np.pi * (stride[a:b] - (first + k)))[:, None]
        steady, before, after = (np.real(harmonics @ c) for c in (mean, differences[k], differences[k + 1]))
        # neighbours are independent: this keeps their variance
        result[a:b] = steady + ((1 - share) * before + share * after) / np.sqrt((1 - share) ** 2 + share**2)
    return result
