import argparse
import json
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

from tests.benchmarks.common import Tables
from tests.studies.data import Part, with_sets


def walk(tables: Tables, arguments: argparse.Namespace) -> None:
    """A part."""


def stairs(tables: Tables, arguments: argparse.Namespace) -> None:
    """Another part."""


PARTS = (Part(make=walk, uses=("one", "two"), trained_on=("three",)), Part(make=stairs, needs=("two",)))


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """The data set `one` with two recordings of each of two people; no other set."""
    (tmp_path / "one").mkdir()
    for name in ("anna_1", "anna_2", "ben_1", "ben_2"):
        with ZipFile(tmp_path / "one" / f"{name}.zip", "w") as file:
            file.writestr("meta.json", json.dumps({"subject": {"id": name[:-2]}}))
    return tmp_path


def arguments(data: Path, sets: str = "", people: int = 0) -> argparse.Namespace:
    return argparse.Namespace(data=data, sets=sets, people=people, print=False)


def test_a_study_goes_on_with_the_sets_that_are_there(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = arguments(data)
    assert with_sets(found, PARTS) == ["walk"]
    assert (found.data, found.whole, found.print) == (data, data, True)  # no table of an incomplete study is written
    said = capsys.readouterr().err
    assert "walk: no recordings of two, so that their rows are left out" in said
    assert "models are trained without three" in said
    assert "stairs is left out: it needs two" in said


def test_a_subset_has_the_last_people_of_the_chosen_sets(data: Path) -> None:
    found = arguments(data, sets="one", people=1)
    with_sets(found, PARTS)
    assert [path.name for path in sorted((found.data / "one").iterdir())] == ["ben_1.zip", "ben_2.zip"]
    assert (found.whole, found.print) == (data, True)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sets": "two"}, "has no recordings of two"),
        ({"sets": "four"}, "--sets has four, but the sets here are one, two"),
        ({"people": -1}, "--people must be at least 1"),
    ],
)
def test_a_study_without_recordings_is_refused(data: Path, given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        with_sets(arguments(data, **given), PARTS)
    with pytest.raises(ValueError, match="nowhere has no recordings of one, two"):
        with_sets(arguments(data / "nowhere"), PARTS)
