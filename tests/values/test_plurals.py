"""Numbers with nouns in messages."""

from __future__ import annotations

import pytest

from pdr_filter.sensing.conditioning import IntakeReport
from pdr_filter.values import how_many, how_often


@pytest.mark.parametrize(("n", "words"), [(1, "once"), (2, "twice"), (3, "3 times"), (1200, "1,200 times")])
def test_once_and_twice_are_written_as_words(n: int, words: str) -> None:
    assert how_often(n) == words
    assert f"jumped back {words}:" in IntakeReport(n_clock_jumps=n).notes()[0]


def test_one_has_the_singular() -> None:
    assert how_many(1, "gap") == "1 gap"
    assert how_many(0, "gap") == "0 gaps"
    assert how_many(2, "person", "people") == "2 people"
    for n in (1, 2):
        text = " ".join(IntakeReport(n_gaps=n, n_implausible=n, n_wild_field=n).notes())
        s = "s" if n > 1 else ""
        assert all(words in text for words in (f"{n} gap{s} ", f"{n} sample{s} beyond", f"{n} magnetic field{s} "))
