"""Motion of a carried phone in a stride: harmonics measured on public recordings, and random people around them.

`measured_strides.npz` contains, for each place of the phone and each context, the mean strides of people and the
variation of their strides. `tests/benchmarks/stride_harmonics.py` measured them. Harmonics are those of the stride,
whose frequency is half of the step frequency. The channels are the specific force to the right, forward and up,
relative to the vertical force at step frequency, and pitch, roll and yaw in rad of the phone about its mean attitude in
the body frame. Phase 0 is the maximum of the vertical force at step frequency.

A person is represented by the stretch of walking with the most similar strides. Strides vary by the scatter of that
person, along the components in which strides of all people vary. Swinging, calling and the back pocket are known from
one person in a small room. Other people are drawn around that person, with an assumed standard deviation of a quarter
of each harmonic. In the back pocket, people are halfway between that person and people with the phone in a front
pocket. This was chosen with twelve people of ubicomp13 in view.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pdr_filter.values import BoolArray, ComplexArray, FloatArray

N_HARMONICS = 20  # harmonics of the stride, up to 20 Hz at two steps a second
N_CHANNELS = 6
FORCE, TURN = slice(0, 3), slice(3, 6)
MEASURED = Path(__file__).with_name("measured_strides.npz")
# A random person is one of the measured people plus this part of the differences between them, because few people were
# measured. Random people then differ by 8 % more than measured ones.
PEOPLE_SPREAD = 0.4
_MAX_Z = 2.5
_ODD = np.arange(1, N_HARMONICS + 1) % 2 == 1
# Signs for the phone on the other side of the body: the mirror image, with the other foot first.
_MIRROR = np.array([-1.0, 1.0, 1.0, 1.0, -1.0, -1.0]) * np.where(_ODD, -1.0, 1.0)[:, None]
# Channels of sideways walking, in which the push is to the side.
_ACROSS = [1, 0, 2, 4, 3, 5]


@dataclass(frozen=True, slots=True, eq=False)
class Strides:
    """Stride harmonics of P people in one context.

    Strides of one person vary along W common components, and independently in each harmonic. H and C are `N_HARMONICS`
    and `N_CHANNELS`.
    """

    people: ComplexArray  # (P, H, C) mean stride of each person, the most typical person first
    people_rest: FloatArray  # (H, C) standard deviation between people in contexts with one measured person
    amplitude_mps2: FloatArray  # (P,) of the vertical specific force at step frequency
    level: FloatArray  # (P, 2) size of the variation of the strides of each person, for forces and for rotations
    ways: ComplexArray  # (W, H, C) components of this variation, relative to `level`
    ways_rest: FloatArray  # (H, C) standard deviation of each harmonic besides, relative to `level`

    def scaled(self, factor: FloatArray) -> Strides:
        """Return the strides with all harmonics multiplied by a table (N_HARMONICS, N_CHANNELS)."""
        size = np.abs(factor)
        return self._changed(lambda harmonics: factor * harmonics, lambda std: size * std)

    def with_push_to_the_side(self) -> Strides:
        """Return the strides of sideways walking, with the channels of forward and of sideways motion exchanged."""
        return self._changed(lambda harmonics: harmonics[..., _ACROSS], lambda std: std[..., _ACROSS])

    def _changed(
        self, harmonics: Callable[[ComplexArray], ComplexArray], std: Callable[[FloatArray], FloatArray]
    ) -> Strides:
        """Return the strides after changes of all harmonics and of all standard deviations of harmonics."""
        return replace(
            self,
            people=harmonics(self.people),
            people_rest=std(self.people_rest),
            ways=harmonics(self.ways),
            ways_rest=std(self.ways_rest),
        )

    def person(self, rng: np.random.Generator | None, spread: float = PEOPLE_SPREAD) -> Strides:
        """Return the strides of one person: the most typical one if `rng` is None, else a random one."""
        like = 0 if rng is None else int(rng.random() * len(self.people))
        mean = self.people[like]
        if rng is not None:
            others = (self.people - self.people.mean(axis=0)) / np.sqrt(len(self.people))
            mean = mean + spread * random_deviations(others, self.people_rest, rng, 1)[0]
        return replace(
            self, people=mean[None], amplitude_mps2=self.amplitude_mps2[like, None], level=self.level[like, None]
        )

    def differences(self, rng: np.random.Generator, n: int) -> ComplexArray:
        """Return the deviations of n strides of the first person from the mean, (n, N_HARMONICS, N_CHANNELS)."""
        return np.repeat(self.level[0], 3) * random_deviations(self.ways, self.ways_rest, rng, n)


def random_deviations(ways: ComplexArray, rest: FloatArray, rng: np.random.Generator, n: int) -> ComplexArray:
    """Return n random deviations of strides: normal factors along `ways`, and normal values in each harmonic."""

    def z(*shape: int) -> FloatArray:
        return np.clip(rng.standard_normal(shape), -_MAX_Z, _MAX_Z)

    along = np.tensordot(z(n, len(ways)), ways, axes=1)
    return along + rest * (z(n, *rest.shape) + 1j * z(n, *rest.shape)) / np.sqrt(2)


@cache
def _measured() -> dict[tuple[str, str], Strides]:
    """Return the tables of `measured_strides.npz`, by place and context."""
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
    """Return the strides in a place of the phone and a context, measured or derived from measured ones.

    Stairs and running are derived from those in the pocket. Even and odd harmonics of each channel are scaled by the
    ratio of the two places in walking. Running with a raised hand is taken from the swinging hand.
    """
    measured = _measured()
    if (place, context) in measured:
        return measured[place, context]
    walking = measured[place, "walking"]
    if context == "sideways":
        return walking.with_push_to_the_side()
    if context == "running" and place in ("texting", "calling"):
        return measured["swinging", context]
    return _as_in_pocket(walking, measured["pocket", "walking"], measured["pocket", context])


def _as_in_pocket(walking: Strides, pocket_walking: Strides, pocket: Strides) -> Strides:
    """Return the strides of a context in another place, from those in the pocket and the walking in both places."""
    ratio = np.empty((N_HARMONICS, N_CHANNELS))
    for subset in (_ODD, ~_ODD):
        ratio[subset] = np.sqrt(_power(walking, subset) / _power(pocket_walking, subset))
    ratio[:, FORCE] /= ratio[1, 2]  # relative to the vertical force at step frequency
    return pocket.scaled(ratio)


def _power(strides: Strides, subset: BoolArray) -> FloatArray:
    """Return the power of each channel (N_CHANNELS,) in a subset of the harmonics, as mean over the people."""
    return (np.abs(strides.people[:, subset]) ** 2).sum(axis=1).mean(axis=0)


def usual_force_mps2(place: str, context: str) -> float:
    """Return the amplitude of the vertical specific force at step frequency, as geometric mean over people."""
    return float(np.exp(np.log(strides_in(place, context).amplitude_mps2).mean()))


def of_person(place: str, context: str, habit: int | None, side: float) -> Strides:
    """Return the strides of the most typical person if `habit` is None, else of a random one with this seed.

    A side of -1 is the left side.
    """
    rng = None if habit is None else np.random.default_rng([habit, *place.encode()])
    own = strides_in(place, context).person(rng)
    return own.scaled(_MIRROR) if side < 0 else own


def waveform(stride: FloatArray, mean: ComplexArray, differences: ComplexArray, first: int) -> FloatArray:
    """Return the channels (N, N_CHANNELS) as functions of the stride number `stride` (N,), which increases.

    `differences` (n, N_HARMONICS, N_CHANNELS) are the deviations of the strides from number `first` on. Raised cosines
    blend from the beginning of one to that of the next.
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
        # neighbouring strides are independent, so divide by this to keep the variance
        result[a:b] = steady + ((1 - share) * before + share * after) / np.sqrt((1 - share) ** 2 + share**2)
    return result
