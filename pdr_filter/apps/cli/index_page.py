"""Index page of the tracks in a folder, with a row and links to picture, report and table for each track."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from pdr_filter.apps.cli import console
from pdr_filter.values.safe_files import write_text
from pdr_filter.values.sanitise import printable

if TYPE_CHECKING:
    from pdr_filter.tracking.track import Track


def write_index(tracks: Mapping[str, Track], failed: Mapping[Path, str], path: Path) -> Path:
    """Write the index page of tracks, by the names of their files, and of recordings that failed, with reasons."""
    from pdr_filter.apps.report.templates import page
    from pdr_filter.values import how_many

    text = page(
        "cli/page/index.html",
        image_source="'self' file:",
        title=how_many(len(tracks), "track"),
        rows=[(quote(name), printable(track.name), _cells(track)) for name, track in tracks.items()],
        caption=console.STD_CAPTION,
        reasons=[printable(reason) for reason in failed.values()],
    )
    return write_text(path, text)


def _cells(track: Track) -> list[str]:
    std = console.in_m(track.summary()["end_std_m"]) if track.n_steps else ""
    return [str(track.n_steps), track.how_far, std, f"{track.duration_s:.0f} s"]
