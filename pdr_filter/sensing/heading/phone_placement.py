"""What the strides of one place of the phone have in common: which of their vectors point ahead, and how well.

A place is where the phone is from when it was put there until it is moved. Sums over its strides, with a memory, tell a
swinging hand from a pocket, show the phase of this person, and how far strides agree on a direction: in a bag hardly,
however it is called.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdr_filter.sensing.heading.stride_harmonics import Stride
from pdr_filter.sensing.heading.vectors import Vector
from pdr_filter.values import CARRYING_MODES, check_numbers, replace_unchecked

_SWINGING = CARRYING_MODES.index("swinging")
_MAY_SWING = (-1, _SWINGING, CARRYING_MODES.index("pocket"))
# Strides after which it is known whether they agree.
_SETTLED_STRIDES = 4
# Strides over which the powers that distinguish a swinging hand are averaged.
_POWER_STRIDES = 6.0
# Before strides have shown what they have in common it is taken to be this, worth as many strides without overlap.
_PRIOR_SHARE, _PRIOR_STRIDES = 0.3, 2.0
# A mean vector is off by so much, m/s2, and by this part of the motion at stride frequency, however many strides agree.
_NOISE_MPS2, _LEAK = 0.05, 0.06
# Sway looks like a slow change to a single stride, by 6 / (2 pi^2) of its amplitude; the next stride takes it back.
_SWAY_LEAK = 0.3
# A hand that is said to swing may have more at step frequency than one that nobody speaks of, and need not lift.
_LABELLED_STEP_SHARE = 1.3
_Plane = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Placement:
    """What was learnt since the phone came to where it is. Angles are clockwise from the reference axis."""

    start_s: float
    carrying_mode: int  # -1 unknown
    old_mode: int  # of the place before, which is still said of this one for some seconds; -1 none
    up: Vector  # mean up direction of its strides, sensor frame
    n_strides: int = 0
    n_read: int = 0  # strides during which the phone may have been read
    # Sums over strides of vectors forward and right of the axis: motion at stride frequency in phase, at step frequency
    # in phase and 90 degrees ahead.
    vectors: tuple[_Plane, _Plane, _Plane] = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    squares: Vector = (0.0, 0.0, 0.0)  # of their squared lengths
    product: float = 0.0  # of the inner products of the two at step frequency
    weight: float = 0.0  # strides
    # Means of squared amplitudes: horizontal once and twice a stride, vertical once.
    powers: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class StrideAgreement:
    """Sums over the strides of a place, and what they say.

    Parameters
    ----------
    memory_s : float
        How long a stride counts, in time of walking.
    max_phase_rad : float
        How far the phase of a person may be from these.
    phase_strides : float
        So many strides must show it to be believed by half.
    swinging_mps2, swinging_lift, swinging_step_share, swinging_agreement : float
        A hand swings if its horizontal amplitude at stride frequency is at least the first, the vertical one at least
        the second part of it (a back pocket has less), the horizontal one at step frequency at most the third (a pocket
        has more), and its vectors from step frequency agree no better than the fourth, the squared length of their
        mean over their mean squared length: 0.1 in two swinging hands, 0.5 to 0.97 in trouser pockets. Of a hand
        that is said to swing less is asked.
    """

    memory_s: float = 30.0
    max_phase_rad: float = math.radians(45.0)
    phase_strides: float = 10.0
    swinging_mps2: float = 1.2
    swinging_lift: float = 0.3
    swinging_step_share: float = 0.85
    swinging_agreement: float = 0.5

    def __post_init__(self) -> None:
        check_numbers(self)

    def learn(self, place: Placement, stride: Stride, elapsed_s: float) -> Placement:
        """The place after one stride more."""
        n_strides = place.n_strides + 1
        stay = math.exp(-elapsed_s / self.memory_s)
        (af, ar), (bf, br), (cf, cr) = place.vectors
        (aa, bb, cc), (p, q, r), (a, b, c) = place.squares, place.powers, stride.vectors
        new_p, new_q, new_r = stride.powers
        share = 1.0 / min(float(n_strides), _POWER_STRIDES)
        return replace_unchecked(
            place,
            n_strides=n_strides,
            vectors=(
                (stay * af + a.real, stay * ar + a.imag),
                (stay * bf + b.real, stay * br + b.imag),
                (stay * cf + c.real, stay * cr + c.imag),
            ),
            squares=(stay * aa + _inner(a, a), stay * bb + _inner(b, b), stay * cc + _inner(c, c)),
            product=stay * place.product + _inner(b, c),
            weight=stay * place.weight + 1.0,
            powers=(p + share * (new_p - p), q + share * (new_q - q), r + share * (new_r - r)),
        )

    def mix(self, place: Placement) -> Vector:
        """How much of each of the stride's vectors points ahead: of that at stride frequency all or nothing."""
        if self._swings(place):
            return (1.0, 0.0, 0.0)
        ahead_rad = self._phase_ahead(place)
        return (0.0, math.cos(ahead_rad), math.sin(ahead_rad))

    def agreement(self, place: Placement, mix: Vector) -> tuple[float, float]:
        """Mean squared length of the vectors, and the share of it that they have in common, 0 to 1."""
        (a, b, c), (aa, bb, cc) = mix, place.squares
        (af, ar), (bf, br), (cf, cr) = place.vectors
        forward, right = (a * af + b * bf + c * cf) / place.weight, (a * ar + b * br + c * cr) / place.weight
        length2 = (a * a * aa + b * b * bb + c * c * cc + 2.0 * b * c * place.product) / place.weight
        leak2 = _NOISE_MPS2**2 + (_LEAK**2 + (_SWAY_LEAK / place.weight) ** 2) * place.powers[0]
        n = 0.5 * place.weight  # overlapping by half, n strides are worth half of n
        # n vectors that have nothing in common have a mean of length2 / n, squared
        shared2 = max(n * (forward * forward + right * right - leak2) - length2, 0.0) / max(n - 1.0, 1.0)
        share = min(shared2 / length2, 1.0) if length2 > 0 else 0.0
        return length2, (n * share + _PRIOR_STRIDES * _PRIOR_SHARE) / (n + _PRIOR_STRIDES)

    def _swings(self, place: Placement) -> bool:
        """Whether the phone is in a hand that swings."""
        stride_power, step_power, lift_power = place.powers
        if place.carrying_mode not in _MAY_SWING or stride_power < self.swinging_mps2**2:
            return False
        # Steps that agree on a direction: the hand knows nothing of them, a pocket does.
        (_, (forward, right), _), (_, length2, _) = place.vectors, place.squares
        agree = forward * forward + right * right > self.swinging_agreement * place.weight * length2
        if place.carrying_mode == _SWINGING:
            is_pocket = agree and place.n_strides >= _SETTLED_STRIDES
            return not is_pocket and step_power <= _LABELLED_STEP_SHARE**2 * stride_power
        lifts = lift_power >= self.swinging_lift**2 * stride_power
        return not agree and lifts and step_power <= self.swinging_step_share**2 * stride_power

    def _phase_ahead(self, place: Placement) -> float:
        """By how much this person's phase is ahead of the usual one: where |a cos x + b sin x| is largest."""
        _, (af, ar), (bf, br) = place.vectors
        ahead_rad = 0.5 * math.atan2(2.0 * (af * bf + ar * br), af * af + ar * ar - (bf * bf + br * br))
        limit_rad = self.max_phase_rad * place.weight / (place.weight + self.phase_strides)
        return min(max(ahead_rad, -limit_rad), limit_rad)


def _inner(a: complex, b: complex) -> float:
    return a.real * b.real + a.imag * b.imag
