"""Samples in a wrong unit, without gravity or with the wrong sign are detected within seconds and reported once."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import FloatArray, ImuBlock

LEGS = [Leg("stationary", duration_s=3.0), Leg("walking", distance_m=12.0)]
SAMPLES: ImuBlock = pdr.merge_streams(simulate(LEGS, seed=5))
TIME_S, FORCE, RATE = SAMPLES.time_s, SAMPLES.specific_force_mps2, SAMPLES.angular_rate_radps
GRAVITY = FORCE * (9.81 / np.linalg.norm(FORCE, axis=1))[:, None]


def give(force: FloatArray, rate: FloatArray, n: int = 50, time_s: FloatArray = TIME_S) -> tuple[pdr.OnlineFilter, str]:
    """Filter that received samples in blocks, and the messages of the errors that it raised, one per line."""
    online, errors = pdr.OnlineFilter(), list[str]()
    for begin, end in pairwise([*range(0, len(time_s), n), len(time_s)]):
        try:
            online.push(time_s[begin:end], force[begin:end], rate[begin:end])
        except ValueError as error:
            errors.append(str(error))
    return online, "\n".join(errors)


@pytest.mark.parametrize("n", [1, 37, 10_000])
@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda f: f / 9.80665, "this looks like g units; multiply by 9.80665"),
        (lambda f: f - GRAVITY, "if gravity was removed, record it too"),
        (lambda f: f * 9.80665, "must be specific force in m/s2, about 9.81 at rest"),
    ],
    ids=["g", "without gravity", "twice"],
)
def test_an_implausible_specific_force_is_refused_once_and_noted(
    wrong: Callable[[FloatArray], FloatArray], words: str, n: int
) -> None:
    online, errors = give(wrong(FORCE), RATE, n)
    assert errors.count(words) == 1
    assert len(errors.splitlines()) == 1
    if n < 10_000:
        assert sum(words in note for note in online.notes) == 1


def test_an_implausible_specific_force_is_noticed_within_two_seconds() -> None:
    online = pdr.OnlineFilter()
    with pytest.raises(ValueError, match="g units"):
        for i in range(210):
            online.push(TIME_S[i : i + 1], FORCE[i : i + 1] / 9.80665, RATE[i : i + 1])


def test_a_walk_in_degrees_per_second_gives_one_note() -> None:
    online, errors = give(FORCE, np.degrees(RATE))
    assert errors == ""
    assert sum("this looks like deg/s" in note for note in online.notes) == 1


def test_a_phone_with_the_wrong_sign_in_the_hand_gives_a_note_and_a_right_one_none() -> None:
    other, errors = give(-FORCE, RATE)
    right, _ = give(FORCE, RATE)
    assert errors == ""
    assert sum("the screen seems to face down" in note for note in other.notes) == 1
    assert not any("face down" in note or "deg/s" in note or "specific force" in note for note in right.notes)


def test_the_note_about_a_sensor_that_starts_with_zeros_disappears() -> None:
    force = FORCE.copy()
    force[:250] = 0.0
    online, errors = give(force, RATE)
    assert "median |a| is 0" in errors
    assert not any("median" in note for note in online.notes)


@pytest.mark.parametrize(
    ("factor", "begin", "words"),
    [
        (1e9, 1.7e18, "divide milliseconds by 1e3, nanoseconds by 1e9"),
        (1e3, 1.7e12, "divide milliseconds by 1e3"),
        (1e3, 0.0, "the times look like milliseconds, convert them to seconds"),
        (1e9, 0.0, "the times look like nanoseconds, convert them to seconds"),
    ],
)
def test_times_that_are_not_in_seconds_are_refused(factor: float, begin: float, words: str) -> None:
    time = (begin + factor * TIME_S[:100]).astype(np.int64)
    with pytest.raises(ValueError, match=words):
        pdr.OnlineFilter().push(time, FORCE[:100])
    online = pdr.OnlineFilter()
    with pytest.raises(ValueError, match=words):
        for t, f in zip(time, FORCE, strict=False):
            online.push_accelerometer(t, f)
    assert pdr.OnlineFilter().push(1.7e9 + TIME_S[:100], FORCE[:100]) == []


def test_the_check_of_units_does_not_depend_on_blocks() -> None:
    first, second = (give(-FORCE, np.degrees(RATE), n)[0] for n in (1, 77))
    a, b = (one.state.sensing.conditioner.units for one in (first, second))
    assert (a.n, a.n_wrong_force, a.n_wrong_rate, a.n_down) == (b.n, b.n_wrong_force, b.n_wrong_rate, b.n_down)
    assert (a.wrong_rate, a.n > 4) == (b.wrong_rate, True)
    np.testing.assert_array_equal(a.rows, b.rows)
