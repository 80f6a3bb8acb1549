"""Untrusted text is sanitised for terminals, CSV cells and file names."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pdr_filter.values.errors import RecordingError
from pdr_filter.values.sanitise import csv_cell, file_name, free_name, of_csv_cell, printable, printable_lines

LIVE = ["=1+1", "+1", "-1", "@SUM(1)", " =1", "\t=1", "a;=1", "a; -1"]


@given(st.text())
def test_printable_characters_are_kept_and_others_are_escaped(text: str) -> None:
    assert printable(text).isprintable()
    if text.isprintable():
        assert printable(text) == text


@pytest.mark.parametrize("text", ["\x1b[2J", "\x9b2J", "\x07", "a\rb", "\u202egpj", "\x00", "\udc80"])
def test_terminal_control_sequences_are_escaped(text: str) -> None:
    assert printable(text).isascii()
    assert str(RecordingError(f"{text}: no file\nsecond line")).splitlines() == [
        f"{printable(text)}: no file",
        "second line",
    ]
    assert printable_lines(f"a\n{text}").startswith("a\n")


@pytest.mark.parametrize("text", LIVE)
def test_no_cell_starts_like_a_formula(text: str) -> None:
    for part in csv_cell(text).split(";"):
        assert part.strip()[:1] not in {"=", "+", "-", "@"}


@given(st.text() | st.text("'=+-@;\t ab"))
def test_a_cell_read_back_is_the_text_that_was_written(text: str) -> None:
    assert of_csv_cell(csv_cell(text)) == text


@given(st.text() | st.text("/\\:. \u4e00", min_size=100, max_size=400))
def test_a_file_name_has_no_folders_and_leaves_room_for_a_suffix(name: str) -> None:
    found = file_name(name)
    assert found
    assert len(found.encode()) <= 200
    assert found.isprintable()
    assert not set(found) & set("/\\:")
    assert found.strip(". ")


def test_long_names_that_differ_at_the_end_stay_different() -> None:
    assert file_name("n" * 300 + "1") != file_name("n" * 300 + "2")
    assert file_name("walk 1") == "walk 1"


def test_a_free_name_is_kept_and_a_taken_one_gets_the_smallest_free_number_from_2() -> None:
    taken = {"walk", "walk_2", "walk_4", "a (2)"}
    assert free_name("other", taken.__contains__) == "other"
    assert free_name("walk", taken.__contains__) == "walk_3"
    assert free_name("{0}", {"{0}"}.__contains__, "{} ({})") == "{0} (2)"
