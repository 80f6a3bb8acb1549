"""Demonstration, which tracks one walk, writes report, picture, map and table, and prints a summary."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Column, Table

from pdr_filter.apps.cli.console import escape, estimates, modified_ns, overwritten, unique_name
from pdr_filter.apps.report import palette, plot
from pdr_filter.apps.report.html import write_report
from pdr_filter.apps.report.page_data import track_data
from pdr_filter.apps.report.palette import context_colours
from pdr_filter.data.io.files.track_writers import write_map
from pdr_filter.data.io.formats import read
from pdr_filter.simulate import demo_walk
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.trust_report import WITHOUT_STEPS, closure, direction, is_end_known
from pdr_filter.values.georeference import GnssUse
from pdr_filter.values.recording import Recording

_BAR_CELLS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Demo:
    """Recording, its track (smoothed, or online with --online), and the files that the demonstration has written."""

    recording: Recording
    track: Track
    is_simulated: bool  # whether the recording is the simulated walk
    report: Path
    picture: Path
    geojson: Path
    csv: Path
    replaced: tuple[Path, ...] = ()  # files that existed before

    def print(self, console: Console, said: set[str] | None = None) -> None:
        """Print the summary. Notes in the set `said` are skipped as already printed; printed notes are added to it."""
        said = set() if said is None else said
        result = self.track
        console.print()
        if self.is_simulated:
            console.print("[bold]A simulated walk[/], whose ground truth is known exactly.")
        else:
            console.print(f"[bold]{escape(result.name)}[/] from {escape(self.recording.source)}", soft_wrap=True)
        console.print()
        console.print(_facts(self))
        console.print(f"  {result.about_estimate}", soft_wrap=True)
        console.print()
        console.print(_context_bars(result))
        console.print()
        notes = [note for note in result.notes if note not in said]
        said.update(notes)
        for note in notes:
            console.print(f"note: {escape(note)}")
        if notes:
            console.print()
        for what, path, remark in (
            ("report", self.report, "open it in a browser"),
            ("picture", self.picture, ""),
            ("map", self.geojson, _georeferenced(result)),
            ("table", self.csv, "one row per step"),
        ):
            console.print(f"  {what:<10} {escape(str(path))}{remark and f' ({remark})'}", soft_wrap=True)
        if self.is_simulated:
            console.print()
            console.print("Next, with your own recording:  pdr-filter demo YOUR.zip", soft_wrap=True)


def run_demo(
    file: Path | None,
    out_dir: Path,
    progress: Callable[[float], None] | None = None,
    gnss: GnssUse | None = None,
    written: set[str] | None = None,
    online: bool = False,
    loop: bool = False,
    height_m: float | None = None,
    platform: str | None = None,
) -> Demo:
    """Track a file, or the simulated walk if `file` is None, and write report, picture, map and table to a folder.

    The track is smoothed, or the online estimate if `online` is true. The report shows both. `written` contains the
    names that earlier recordings of the same command use. The name of this recording is added to it. `height_m`
    replaces the height of the person in the file, and `platform` is as in `pdr_filter.read`.
    """
    is_simulated = file is None
    recording = demo_walk() if file is None else read(file, platform=platform)
    if height_m is not None:
        recording = recording.of_height(height_m)
    tracks = estimates(recording, online, loop, True, progress, gnss=gnss)
    result = tracks[0]
    name = unique_name(result.name, set() if written is None else written)
    before = modified_ns(out_dir, name)
    picture = out_dir / f"{name}.png"
    position: Any = recording.truth.position
    plot.track(result, picture, np.column_stack([position.east_m, position.north_m]) if is_simulated else None)
    done = Demo(
        recording=recording,
        track=result,
        is_simulated=is_simulated,
        report=write_report(tracks, out_dir / f"{name}.html", recording),
        picture=picture,
        geojson=write_map(result, out_dir / f"{name}.geojson"),
        csv=result.to_csv(out_dir / f"{name}.csv"),
    )
    return replace(done, replaced=tuple(overwritten(before)))


def _georeferenced(result: Track) -> str:
    """Return a remark that says how the map is georeferenced."""
    if result.origin is None:
        return "shape only, because the position on Earth is unknown"
    return "georeferenced by the locations in the recording"


def _facts(demo: Demo) -> Table:
    """Return a table of steps, distance and end point, with the ground truth of a simulated walk."""
    result = demo.track
    table = Table.grid("", "", "", padding=(0, 3))
    truth = _true_facts(demo.recording, result) if demo.is_simulated else ("", "", "")
    table.add_row("  distance", result.how_far, truth[1])
    table.add_row("  duration", f"{result.duration_s:.0f} s", "")
    table.add_row("  steps", f"{result.n_steps}", truth[0])
    table.add_row("  end", closure(result), truth[2])
    if is_end_known(result):
        table.add_row("", direction(result), "")
    if result.n_steps:
        table.add_row("", f"± {result.position_std_m[-1]:.1f} m", "standard deviation in the worst direction")
    return table


def _true_facts(recording: Recording, result: Track) -> tuple[str, str, str]:
    """Return the true number of steps, the true distance, and the error of the end after rigid alignment, as texts."""
    truth: Any = recording.truth
    end_error_m = track_data(result, recording, None, 1)["from_truth"][-1]
    return (
        f"(truth: {len(truth.steps)})",
        f"(truth: {truth.segments.distance_m.sum():.1f} m)",
        f"(error {end_error_m:.1f} m after rigid alignment)",
    )


def _context_bars(result: Track) -> Table:
    """Return a table of the seconds in each context and of moving without steps, with a bar: its share of the walk."""
    table = Table.grid("", Column(justify="right"), "", padding=(0, 2))
    seconds = {**result.context_seconds(), WITHOUT_STEPS: result.seconds_without_steps}
    total_s = sum(seconds.values())
    for name, colour in {**context_colours(result.contexts), WITHOUT_STEPS: palette.WITHOUT_STEPS}.items():
        if seconds[name] > 0:
            cells = max(1, round(_BAR_CELLS * seconds[name] / total_s))
            table.add_row(f"  {name}", f"{seconds[name]:.0f} s", f"[{colour}]{'█' * cells}[/]")
    return table
