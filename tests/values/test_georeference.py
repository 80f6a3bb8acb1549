"""Arguments for position, north and floor plan of a track, and their descriptions."""

from __future__ import annotations

from dataclasses import fields

import pytest
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.values.georeference import Georeference, texts

NAMES = [field.name for field in fields(Georeference)]


def test_each_argument_of_a_placement_has_a_description() -> None:
    assert list(texts()) == NAMES
    assert all(len(text.split()) > 5 and text.endswith(".") for text in texts().values())


def test_the_docstring_of_track_has_the_description_of_each_argument() -> None:
    words = " ".join((pdr.track.__doc__ or "").split())
    assert all(text in words for text in texts().values())


@pytest.mark.parametrize("command", ["track", "smooth"])
def test_the_help_of_an_option_is_the_first_sentence_of_its_description(command: str) -> None:
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "400", "TERM": "dumb"}).output
    words = " ".join(shown.replace("│", " ").split())
    for text in texts().values():
        # headings are in degrees on the command line
        assert text.split(". ")[0].replace("`", "").replace("in rad", "in degrees").rstrip(".") in words
