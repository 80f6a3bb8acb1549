"""Command `pdr-filter info`, which describes the contents of a recording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pdr_filter.apps.cli import console
from pdr_filter.apps.cli.options import AsJson, Files, Format


def info_command(files: Files, file_format: Format = None, as_json: AsJson = False) -> None:
    """Describe recordings: sensors, sampling rates, gaps, plausibility of units, ground truth."""
    import pdr_filter as pdr
    from pdr_filter.data.io.describe import describe

    def describe_one(file: Path, progress: Callable[[float], None]) -> dict[str, Any]:
        description = describe(pdr.read(file, file_format)).as_dict()
        if as_json:
            console.print_json(description)
        return description

    with console.one_line_errors():
        files = console.recording_paths(files)
    descriptions, failed = console.each_file(files, describe_one, as_json)
    if not as_json:
        for description in descriptions:
            _print(description)
    console.exit_if_failed(failed, len(files))


def _print(description: dict[str, Any]) -> None:
    console.print_line(f"{description['name']}: {description['duration_s']:.1f} s, from {description['source']}")
    columns = "sensor", "unit", "samples", "from", "to", "rate", "gaps", "longest", "repeated", "backward", "empty"
    table = console.new_table(*columns)
    for stream in description["streams"]:
        rate_hz = stream["mean_rate_hz"]  # the median rate is wrong if timestamps are rounded to whole milliseconds
        table.add_row(
            stream["name"],
            stream["unit"],
            str(stream["n_samples"]),
            *("" if time_s is None else f"{time_s:z.1f} s" for time_s in (stream["first_s"], stream["last_s"])),
            "unknown" if rate_hz is None else f"{rate_hz:.1f} Hz",
            str(stream["n_gaps"]),
            f"{stream['longest_gap_s']:.2f} s",
            str(stream["n_duplicates"]),
            str(stream["n_backward"]),
            str(stream["n_missing_rows"]),
        )
    console.print_table(table)
    truth = ", ".join(f"{name} ({rows} rows)" for name, rows in description["truth_rows"].items())
    height_m = description["height_m"]
    height = "unknown (pdr-filter track --height sets it)" if height_m is None else f"{height_m:.2f} m"
    lines = [
        *description["units"],
        f"person's height: {height}; phone: {description['placement'] or 'not stated'}",
        f"truth: {truth or 'none'}",
        *(f"note: {n}" for n in description["notes"]),
    ]
    for line in (*lines, ""):
        console.print_line(line)
