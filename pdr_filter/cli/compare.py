"""`pdr-filter compare`: the weightings HC, WC and IMM side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pdr_filter.cli import console
from pdr_filter.cli.console import escape
from pdr_filter.cli.options import Files

if TYPE_CHECKING:
    from pdr_filter.tracks import Track


def compare(files: Files) -> None:
    """Compare the weightings HC, WC and IMM on recordings."""
    import pdr_filter as pdr

    def compare_one(file: Path, progress: Callable[[float], None]) -> list[Track]:
        return list(pdr.evaluate.weighting_tracks(pdr.read(file), progress=progress).values())

    with console.one_line_errors():
        files = console.recordings_of(files)
    compared, failed = console.each(files, compare_one)
    if compared:
        _print(compared)
    console.exit_if_failed(failed, len(files))


def _print(compared: Sequence[Sequence[Track]]) -> None:
    columns = ("recording", "weighting", "steps", "distance", "against imm", "end east", "end north", "end apart")
    table = console.new_table(*columns)
    for tracks in compared:
        reference = tracks[-1]
        reference_end = reference.summary()
        for i, result in enumerate(tracks):
            end = result.summary()
            apart_east_m = end["end_east_m"] - reference_end["end_east_m"]
            apart_north_m = end["end_north_m"] - reference_end["end_north_m"]
            is_reference = result is reference
            table.add_row(
                escape(result.name) if i == 0 else "",
                result.weighting,
                str(result.n_steps),
                console.in_m(result.distance_m),
                "" if is_reference else console.in_m(result.distance_m - reference.distance_m, "+.1f"),
                console.in_m(end["end_east_m"]),
                console.in_m(end["end_north_m"]),
                "" if is_reference else console.in_m((apart_east_m**2 + apart_north_m**2) ** 0.5),
                end_section=is_reference,
            )
    console.print_table(table)
    for tracks in compared:
        console.print_notes(tracks[-1])
