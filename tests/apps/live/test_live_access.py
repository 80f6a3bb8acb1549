"""How much each sender may send, and whose height is given."""

from __future__ import annotations

import pytest
import typer

from pdr_filter.apps.cli.live import Phones
from pdr_filter.apps.live.access import Rates
from pdr_filter.apps.live.settings import Settings


def test_what_is_refused_does_not_count_and_each_sender_has_its_own_bounds() -> None:
    rates = Rates(bytes_per_s=0.0, burst_bytes=20.0)
    assert [rates.allows("one", n) for n in (15, 15, 5, 1)] == [True, False, True, False]
    assert rates.allows("other", 20)


def test_a_height_is_of_all_persons_or_of_the_person_with_one_phone() -> None:
    def settings(*heights: str) -> Settings:
        return Phones(None, [*heights], "default", 64, 1, None).settings()

    found = settings("1.8", "wat=1.55", "a=b=1.6")
    assert (found.height_m, found.heights_m) == (1.8, (("wat", 1.55), ("a=b", 1.6)))
    for wrong in ("watch=178", "watch=", "tall"):
        with pytest.raises(typer.BadParameter, match="height of a person in metres"):
            settings(wrong)


def test_the_height_of_a_phone_is_that_of_the_longest_name_with_which_its_own_begins() -> None:
    settings = Settings(heights_m=(("iPhone", 1.7), ("iPhone 2", 1.85), ("iPhone", 1.6)))
    found = [settings.of_phone(name, {}).subject.height_m for name in ("iPhone 2", "iPhone 2b", "iPhone 3", "Pixel")]
    assert found == [1.85, 1.85, 1.6, None]  # the last height of a name that is given twice is used
