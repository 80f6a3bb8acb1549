"""Whatever number a configuration is given: it is refused, or the filter runs."""

from __future__ import annotations

import faulthandler
import itertools
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.sensing.attitude import AttitudeEstimator
from pdr_filter.sensing.conditioning import Conditioner
from pdr_filter.values import check_array, check_numbers

WRONG = (np.nan, np.inf, -1.0, 0.0)
HANG_S = 30.0


def numbers_in(value: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Paths of all float fields of the dataclasses in a configuration, those in tuples of dataclasses too."""
    for f in fields(value) if is_dataclass(value) else ():
        part = getattr(value, f.name)
        if isinstance(part, float):
            yield (*path, f.name)
        elif isinstance(part, tuple) and part and is_dataclass(part[0]):
            yield from numbers_in(part[0], (*path, f.name))
        else:
            yield from numbers_in(part, (*path, f.name))


def with_number(value: Any, path: tuple[str, ...], number: float) -> Any:
    """A configuration in which one number is another one; of a tuple, in its first part."""
    name, *rest = path
    part = getattr(value, name)
    if isinstance(part, tuple):
        return replace(value, **{name: (with_number(part[0], tuple(rest), number), *part[1:])})
    return replace(value, **{name: with_number(part, tuple(rest), number) if rest else number})


def short_walk() -> pdr.Recording:
    """A walk of twelve seconds, of which the phone is carried seven."""
    walk = pdr.simulate.demo_walk()
    streams = {name: pdr.Samples(s.time_s[s.time_s < 12], s.values[s.time_s < 12]) for name, s in walk.streams.items()}
    return replace(walk, **streams)


def class_at(value: Any, path: tuple[str, ...]) -> type:
    """The class whose field is at the end of a path; of a tuple, that of its first part."""
    for name in path[:-1]:
        value = getattr(value, name)
        value = value[0] if isinstance(value, tuple) else value
    return type(value)


def try_all() -> list[str]:
    """Return the errors. A field that several recipes share is tried in one of them."""
    warnings.simplefilter("ignore")
    walk, wrong, known = short_walk(), list[str](), set[tuple[type, str]]()
    for recipe, weighting in itertools.product(recipes.RECIPES, ("imm", "wc")):
        good = recipes.RECIPES[recipe](recipes.Subject(height_m=1.7)).with_weighting(weighting)
        pdr.track(walk, good)
        for path in numbers_in(good):
            field = class_at(good, path), path[-1]
            if field in known:
                continue
            known.add(field)
            for number in WRONG:
                what = f"{recipe} {weighting} {'.'.join(path)} = {number}"
                faulthandler.dump_traceback_later(HANG_S, exit=True)
                try:
                    pdr.track(walk, with_number(good, path, number))
                except ValueError as error:
                    if path[-1] not in str(error):
                        wrong.append(f"{what}: {error}")
                except Exception as error:
                    wrong.append(f"{what}: {type(error).__name__}: {error}")
                finally:
                    faulthandler.cancel_dump_traceback_later()
    return wrong


def test_every_number_of_a_recipe_is_refused_by_its_name_or_gives_a_filter_that_runs() -> None:
    """In a process of its own: a C library that is given nonsense may end it."""
    done = subprocess.run(
        [sys.executable, __file__], check=False, capture_output=True, text=True, cwd=Path(__file__).parent
    )
    assert (done.returncode, done.stdout.splitlines()) == (0, ["all tried"]), done.stderr


@pytest.mark.parametrize("tau_acc_s", [0.0, -1.0, np.nan, np.inf, "3", None, True])
def test_an_attitude_that_would_end_the_interpreter_is_refused(tau_acc_s: Any) -> None:
    with pytest.raises(ValueError, match=r"tau_acc_s of AttitudeEstimator must be positive .*its default is 3\.0"):
        AttitudeEstimator(tau_acc_s=tau_acc_s)


def test_a_count_must_be_whole_and_a_number_may_be_of_numpy() -> None:
    with pytest.raises(ValueError, match="hop_samples of Conditioner must be positive and whole"):
        Conditioner(hop_samples=2.5)  # type: ignore[arg-type]
    assert Conditioner(rate_hz=np.float32(50), hop_samples=np.int64(5)).hop_samples == 5  # type: ignore[arg-type]


def test_zero_any_sign_and_infinity_are_where_a_configuration_says_so_and_in_tuples_too() -> None:
    @dataclass
    class Numbers:
        may_be_zero: float = 1.0
        signed: float = 1.0
        infinite: float = 1.0
        several: tuple[float, ...] = (1.0, 2.0)
        other: str | None = None

        def __post_init__(self) -> None:
            check_numbers(self, zero=("may_be_zero",), signed=("signed",), infinite=("infinite",))

    Numbers(0.0, -1.0, np.inf, (), "text")
    for wrong in ({"may_be_zero": -1.0}, {"signed": np.inf}, {"infinite": -np.inf}, {"several": (1.0, 0.0)}):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))} of Numbers must be"):
            Numbers(**wrong)  # type: ignore[arg-type]


if __name__ == "__main__":
    found = try_all()
    print("\n".join(found) or "all tried")


@pytest.mark.parametrize(
    ("value", "kind", "shape", "words"),
    [
        ([1.0, np.nan], "finite", None, r"must be finite, got \[1\.0, nan\]: mend it"),
        (0.0, "positive", None, "must be positive and finite, got 0.0: mend it"),
        (np.inf, "positive", None, "must be positive and finite, got inf"),
        ([-1e-9, 1.0], "0 or more", (2,), r"must be \(2,\), 0 or more and finite"),
        ([1.0, 1.0], "increasing", None, "must be increasing and finite"),
        (np.ones((4, 10)), "finite", (4,), r"must be \(4,\), finite, got 1\.0 to 1\.0 in an array \(4, 10\)"),
        ("1", "finite", None, "must be finite, got '1'"),
        (True, "finite", None, "must be finite, got True"),
    ],
)
def test_an_array_of_another_kind_is_refused_with_its_value_and_the_remedy(
    value: Any, kind: Any, shape: tuple[int, ...] | None, words: str
) -> None:
    with pytest.raises(ValueError, match=f"x_m {words}"):
        check_array("x_m", value, kind, shape, "mend it")


@pytest.mark.parametrize(
    ("value", "kind"), [(0, "0 or more"), (1e-9, "positive"), ([1, 2], "increasing"), ([], "positive")]
)
def test_an_array_of_its_kind_is_taken(value: Any, kind: Any) -> None:
    check_array("x_m", value, kind)
