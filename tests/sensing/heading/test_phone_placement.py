"""Rules that distinguish a swinging hand from a pocket, on statistics of strides with known values."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from pdr_filter.sensing.heading.phone_placement import Placement, StrideAgreement
from pdr_filter.values import CARRYING_MODES

RULES = StrideAgreement()
SWINGING, POCKET, TEXTING = (CARRYING_MODES.index(name) for name in ("swinging", "pocket", "texting"))


def placement(
    carrying_mode: int, agreement: float, step_share: float = 0.5, lift: float = 0.5, n_strides: int = 8
) -> Placement:
    """Statistics of strides with an amplitude of 2 m/s2 at stride frequency.

    `agreement` is the squared length of the mean vector at step frequency over the mean squared length. `step_share`
    and `lift` are amplitudes relative to that at stride frequency.
    """
    weight, length2 = 6.0, (2.0 * step_share) ** 2
    mean_length = math.sqrt(agreement * length2)
    return Placement(
        start_s=0.0,
        carrying_mode=carrying_mode,
        old_mode=-1,
        up=(0.0, 0.0, 1.0),
        n_strides=n_strides,
        vectors=((weight * 2.0, 0.0), (weight * mean_length, 0.0), (0.0, 0.0)),
        squares=(weight * 4.0, weight * length2, weight * length2),
        weight=weight,
        powers=(4.0, length2, (2.0 * lift) ** 2),
    )


def swings(place: Placement) -> bool:
    """The vector at stride frequency alone points forward in a swinging hand."""
    return RULES.mix(place) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("mode", [-1, SWINGING, POCKET])
def test_strides_that_do_not_agree_at_step_frequency_are_of_a_swinging_hand(mode: int) -> None:
    assert swings(placement(mode, agreement=0.1))


@pytest.mark.parametrize("mode", [-1, SWINGING, POCKET])
def test_strides_that_agree_at_step_frequency_are_of_a_pocket(mode: int) -> None:
    assert not swings(placement(mode, agreement=0.8))


def test_a_few_agreeing_strides_do_not_overrule_the_carrying_mode_swinging() -> None:
    assert swings(placement(SWINGING, agreement=0.8, n_strides=3))


def test_a_phone_in_front_of_the_body_never_swings() -> None:
    assert not swings(placement(TEXTING, agreement=0.1))


@pytest.mark.parametrize(("mode", "largest"), [(SWINGING, 1.3), (-1, 0.85)])
def test_a_hand_with_much_motion_at_step_frequency_does_not_swing(mode: int, largest: float) -> None:
    assert swings(placement(mode, 0.1, step_share=0.98 * largest))
    assert not swings(placement(mode, 0.1, step_share=1.02 * largest))


def test_a_phone_without_the_label_swings_only_if_it_also_moves_up_and_down() -> None:
    assert not swings(placement(-1, 0.1, lift=0.2))
    assert swings(placement(SWINGING, 0.1, lift=0.2))


def test_a_phone_that_hardly_moves_at_stride_frequency_does_not_swing() -> None:
    assert not swings(replace(placement(SWINGING, 0.1), powers=(1.0, 0.1, 1.0)))
