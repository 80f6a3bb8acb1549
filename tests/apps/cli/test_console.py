"""Tables and notes on a terminal of any width."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import pytest
import typer

import pdr_filter as pdr
from pdr_filter.apps.cli import console

WORDS = {"recording", "steps", "distance", "east", "north", "duration", "contexts", "stationary", "136.7 m"}


@cache
def demo_track() -> pdr.Track:
    return pdr.track(pdr.simulate.demo_walk())


def printed(capsys: pytest.CaptureFixture[str]) -> str:
    """Return the printed text without terminal styles."""
    return re.sub(r"\x1b\[[0-9;]*m", "", capsys.readouterr().out)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Text stream that claims to be a terminal without colours."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    return monkeypatch


@pytest.mark.parametrize("columns", [50, 60, 80, 100, 160])
def test_a_table_is_no_wider_than_the_terminal_and_breaks_no_word(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], columns: int
) -> None:
    terminal.setenv("COLUMNS", str(columns))
    console.print_tracks([demo_track(), replace(demo_track(), name="a_walk_in_the_corridor")])
    table = printed(capsys).partition("±: one")[0]
    assert max(map(len, table.splitlines())) <= columns
    assert all(word in table for word in {*WORDS, "a_walk_in_the_corridor"})
    assert all(f"{name} {s:.0f} s" in table for name, s in demo_track().context_seconds().items() if s >= 0.5)


def test_the_end_of_a_track_is_unknown_if_its_direction_from_the_start_is(capsys: pytest.CaptureFixture[str]) -> None:
    known = demo_track()
    unsure = replace(known, position_cov_m2=1e4 * known.position_cov_m2)
    assert console.end_of(unsure) == ("unknown", "unknown")
    summary = known.summary()
    expected = console.in_m(summary["end_east_m"]), console.in_m(summary["end_north_m"])
    assert console.end_of(known) == console.end_of(replace(unsure, frame="fixes")) == expected
    console.print_tracks([unsure])
    assert console.in_m(unsure.position_std_m[-1]) in printed(capsys)


def test_the_steps_of_the_phone_are_a_column_if_one_recording_has_them(capsys: pytest.CaptureFixture[str]) -> None:
    console.print_tracks([demo_track(), demo_track()], [None, 4321])
    shown = printed(capsys).partition("±: one")[0]
    assert "phone" in shown
    assert shown.count("4321") == 1
    console.print_tracks([demo_track()], [None])
    assert "phone" not in printed(capsys).partition("±: one")[0]


def test_each_part_of_a_table_begins_with_what_tells_its_rows_apart(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    terminal.setenv("COLUMNS", "40")
    table = console.new_table("recording", "track", "first number", "second number", "third number", n_keys=2)
    table.add_row("walk", "hc", "100000.0 m", "200000.0 m", "300000.0 m")
    console.print_table(table)
    rows = [line for line in printed(capsys).splitlines() if "00000.0 m" in line]
    assert len(rows) > 1
    assert all(line.split()[:2] == ["walk", "hc"] for line in rows)
    assert [n for line in rows for n in ("1", "2", "3") if f"{n}00000.0 m" in line] == ["1", "2", "3"]


def test_a_note_is_broken_between_words_on_a_terminal_and_is_one_line_elsewhere(
    terminal: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    note = "the heading is uncertain by more than 0.5 rad in 195 of 195 steps [bold], from 5 to 109 s; " * 3
    terminal.setenv("COLUMNS", "80")
    console.print_notes([replace(demo_track(), notes=(note,))])
    lines = printed(capsys).splitlines()
    assert max(map(len, lines)) <= 80
    assert " ".join(lines).split() == f"{demo_track().name}: {note}".split()
    terminal.delenv("FORCE_COLOR")
    console.print_notes([replace(demo_track(), notes=(note,))])
    assert len(capsys.readouterr().out.splitlines()) == 1


def test_a_note_that_several_recordings_share_stands_once(capsys: pytest.CaptureFixture[str]) -> None:
    tracks = [replace(demo_track(), name=f"walk {i}", notes=("the height is not known",)) for i in range(9)]
    tracks[4] = replace(tracks[4], notes=("the height is not known", "2 gaps"))
    console.print_notes(tracks)
    assert capsys.readouterr().out.splitlines() == ["9 of 9 recordings: the height is not known", "walk 4: 2 gaps"]


def test_a_note_that_differs_between_recordings_only_in_its_numbers_stands_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    notes = [("rest", f"{i} gaps, {0.5 * i} s in all") if i else ("rest",) for i in range(4)]
    console.print_notes([replace(demo_track(), name=f"walk {i}", notes=own) for i, own in enumerate(notes)])
    told = capsys.readouterr().out.splitlines()
    assert told == ["4 of 4 recordings: rest", "3 of 4 recordings, such as walk 1: 1 gaps, 0.5 s in all"]


def test_an_optional_package_that_is_missing_is_named_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(typer.Exit) as stopped, console.one_line_errors():
        raise ImportError('floor plans need shapely: pip install "pdr_filter[maps]"')
    assert stopped.value.exit_code == console.UNUSABLE
    assert capsys.readouterr().err == 'error: floor plans need shapely: pip install "pdr_filter[maps]"\n'
