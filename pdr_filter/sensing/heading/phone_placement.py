"""Statistics over the strides in one placement of the phone: which stride vectors point forward, how well they agree.

A placement lasts from the time when the phone is put there until it is moved. Exponentially forgotten sums over its
strides distinguish a swinging hand from a pocket. They also give the phase of the push forward of this person, and the
agreement of the strides on a direction. In a bag the strides hardly agree, whatever its carrying mode is called.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from pdr_filter.sensing.heading.stride_harmonics import Stride
from pdr_filter.sensing.heading.vectors import Vector
from pdr_filter.values import CARRYING_MODES, check_numbers, replace_unchecked

_SWINGING = CARRYING_MODES.index("swinging")
_MAY_SWING = (-1, _SWINGING, CARRYING_MODES.index("pocket"))
# Strides after which their agreement can be judged.
_SETTLED_STRIDES = 4
# Strides over which the powers that distinguish a swinging hand are averaged.
_POWER_STRIDES = 6.0
# Prior of the agreement of strides, and its weight as a number of strides that do not overlap.
_PRIOR_SHARE, _PRIOR_STRIDES = 0.3, 2.0
# Errors of a mean vector that do not average out over strides: a constant, m/s2, and a share of the motion at stride
# frequency.
_NOISE_MPS2, _LEAK = 0.05, 0.06
# Share of the sway that leaks into the vector of a single stride. Within one stride, sway looks like a slow change of
# 6 / (2 pi^2) of its amplitude, which the next stride cancels.
_SWAY_LEAK = 0.3
# Largest amplitude at step frequency, relative to that at stride frequency, of a hand that the carrying mode calls
# swinging. Without that label less is allowed, and the hand must also move up and down.
_LABELLED_STEP_SHARE = 1.3
_Plane = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Placement:
    """Statistics of the strides since the phone was put into its present placement.

    Vectors are horizontal, with components forward and right of the reference axis in m/s2. Sums are exponentially
    forgotten.
    """

    start_s: float  # time when the phone was put there, s
    carrying_mode: int  # index into `CARRYING_MODES`; -1 if unknown
    # Carrying mode of the previous placement, which the classifier still reports for some seconds; -1 if none.
    old_mode: int
    up: Vector  # mean unit vector up of the strides, sensor frame
    n_strides: int = 0  # strides in this placement
    n_read: int = 0  # strides during which the phone may have been read
    # Sums of the three horizontal vectors of `Stride.vectors`: at stride frequency, and two at step frequency.
    vectors: tuple[_Plane, _Plane, _Plane] = ((0.0, 0.0), (0.0, 0.0), (0.0, 0.0))
    squares: Vector = (0.0, 0.0, 0.0)  # sums of the squared lengths of these vectors
    # Sum of the inner products of the two vectors at step frequency, the second and third of `Stride.vectors`.
    product: float = 0.0
    weight: float = 0.0  # effective number of strides in the sums
    powers: Vector = (0.0, 0.0, 0.0)  # mean squared amplitudes, as in `Stride.powers`


@dataclass(frozen=True)
class StrideAgreement:
    """Rules that update the statistics of a placement by a stride, and derive the walking direction from them.

    Parameters
    ----------
    memory_s : float
        Time constant of the sums, in time of walking, s.
    max_phase_rad : float
        Largest deviation of a person's phase from the usual one, rad. The phase is that by which the vertical force at
        step frequency is advanced to be in phase with the push forward (`Phases`).
    phase_strides : float
        Number of strides after which half of the largest deviation is allowed.
    swinging_mps2, swinging_lift, swinging_step_share, swinging_agreement : float
        Conditions for a swinging hand. The horizontal amplitude at stride frequency is at least `swinging_mps2`.
        Relative to it, the vertical amplitude at stride frequency is at least `swinging_lift` (a back pocket has less),
        and the horizontal amplitude at step frequency is at most `swinging_step_share` (a pocket has more). The vectors
        at step frequency agree by at most `swinging_agreement`, the squared length of their mean over their mean
        squared length: 0.1 in two walks of one person with a swinging hand, 0.5 to 0.97 in trouser pockets. The
        conditions are weaker for a hand whose carrying mode is swinging.
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

    def learn(self, placement: Placement, stride: Stride, elapsed_s: float) -> Placement:
        """Return the statistics of a placement updated with one more stride.

        `elapsed_s` is the time of walking by which earlier strides are forgotten.
        """
        n_strides = placement.n_strides + 1
        stay = math.exp(-elapsed_s / self.memory_s)
        (af, ar), (bf, br), (cf, cr) = placement.vectors
        (aa, bb, cc), (p, q, r), (a, b, c) = placement.squares, placement.powers, stride.vectors
        new_p, new_q, new_r = stride.powers
        share = 1.0 / min(float(n_strides), _POWER_STRIDES)
        return replace_unchecked(
            placement,
            n_strides=n_strides,
            vectors=(
                (stay * af + a.real, stay * ar + a.imag),
                (stay * bf + b.real, stay * br + b.imag),
                (stay * cf + c.real, stay * cr + c.imag),
            ),
            squares=(stay * aa + _inner(a, a), stay * bb + _inner(b, b), stay * cc + _inner(c, c)),
            product=stay * placement.product + _inner(b, c),
            weight=stay * placement.weight + 1.0,
            powers=(p + share * (new_p - p), q + share * (new_q - q), r + share * (new_r - r)),
        )

    def mix(self, placement: Placement) -> Vector:
        """Return the coefficients (3,) with which the sum of the three vectors of a stride points forward.

        The vectors are `Stride.vectors`: one of the motion at stride frequency, and two of the motion at step
        frequency, which differ by 90 degrees in phase. For a swinging hand the result is (1, 0, 0), the vector at
        stride frequency alone. Otherwise it is (0, cos x, sin x) with the phase x of this person minus the usual phase.
        """
        if self._swings(placement):
            return (1.0, 0.0, 0.0)
        ahead_rad = self._phase_ahead(placement)
        return (0.0, math.cos(ahead_rad), math.sin(ahead_rad))

    def agreement(self, placement: Placement, mix: Vector) -> tuple[float, float]:
        """Return the mean squared length of the combined stride vectors in (m/s2)^2, and their agreement, 0 to 1.

        The combined vector of a stride is the sum of its three vectors with the coefficients `mix`. Their agreement on
        a direction is the squared length of the mean vector relative to the mean squared length. The part due to
        chance, noise and sway is subtracted, and a prior is added as for two more strides that do not overlap.
        """
        (a, b, c), (aa, bb, cc) = mix, placement.squares
        (af, ar), (bf, br), (cf, cr) = placement.vectors
        forward, right = (a * af + b * bf + c * cf) / placement.weight, (a * ar + b * br + c * cr) / placement.weight
        length2 = (a * a * aa + b * b * bb + c * c * cc + 2.0 * b * c * placement.product) / placement.weight
        leak2 = _NOISE_MPS2**2 + (_LEAK**2 + (_SWAY_LEAK / placement.weight) ** 2) * placement.powers[0]
        n = 0.5 * placement.weight  # strides overlap by half, so two count as one
        # For n independent vectors, the squared length of their mean is length2 / n on average. It is subtracted.
        shared2 = max(n * (forward * forward + right * right - leak2) - length2, 0.0) / max(n - 1.0, 1.0)
        share = min(shared2 / length2, 1.0) if length2 > 0 else 0.0
        return length2, (n * share + _PRIOR_STRIDES * _PRIOR_SHARE) / (n + _PRIOR_STRIDES)

    def _swings(self, placement: Placement) -> bool:
        """Return True if the phone is in a swinging hand."""
        stride_power, step_power, lift_power = placement.powers
        if placement.carrying_mode not in _MAY_SWING or stride_power < self.swinging_mps2**2:
            return False
        # The motion at step frequency agrees on a direction in a pocket, but not in a swinging hand.
        (_, (forward, right), _), (_, length2, _) = placement.vectors, placement.squares
        agree = forward * forward + right * right > self.swinging_agreement * placement.weight * length2
        if placement.carrying_mode == _SWINGING:
            is_pocket = agree and placement.n_strides >= _SETTLED_STRIDES
            return not is_pocket and step_power <= _LABELLED_STEP_SHARE**2 * stride_power
        lifts = lift_power >= self.swinging_lift**2 * stride_power
        return not agree and lifts and step_power <= self.swinging_step_share**2 * stride_power

    def _phase_ahead(self, placement: Placement) -> float:
        """Return the phase of the push forward relative to the vertical force, of this person minus the usual one, rad.

        It is the angle x that maximises |a cos x + b sin x|, where the complex numbers a and b are the sums of the two
        vectors at step frequency. The result is limited while strides are few.
        """
        _, (af, ar), (bf, br) = placement.vectors
        ahead_rad = 0.5 * math.atan2(2.0 * (af * bf + ar * br), af * af + ar * ar - (bf * bf + br * br))
        limit_rad = self.max_phase_rad * placement.weight / (placement.weight + self.phase_strides)
        return min(max(ahead_rad, -limit_rad), limit_rad)


def _inner(a: complex, b: complex) -> float:
    """Return the inner product of two vectors given as complex numbers."""
    return a.real * b.real + a.imag * b.imag
