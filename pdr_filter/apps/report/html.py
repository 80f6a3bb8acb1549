"""HTML report of tracks, a self-contained page without network access, fonts or other files.

The page is the template `page/report.html`, filled with texts and the data of `page_data`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, urlsplit

import numpy as np

from pdr_filter.apps.maps.floor_plan import FloorPlan, plan_of
from pdr_filter.apps.report import palette
from pdr_filter.apps.report.geometry import shown_context_prob
from pdr_filter.apps.report.page_data import track_data
from pdr_filter.apps.report.templates import MAP_SCRIPTS, page
from pdr_filter.data.io.describe import ReadingReport, reading_report
from pdr_filter.tracking import trust_report as trust
from pdr_filter.values import TrackRows, how_many
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import write_text

# A context that never exceeds this probability is invisible in the chart, and is not listed.
_VISIBLE_PROB = 0.01
_SCRIPTS = (*MAP_SCRIPTS, "report/assets/uPlot.iife.min.js", "report/page/map.js", "report/page/report.js")
_SMOOTHED_OR_ONLINE = (
    "The smoothed track is the best estimate from the whole recording. The online track shows the estimates that were "
    "available at each step."
)
_WITHOUT_TILES = (
    "This page loads nothing from the network. For a street map below the path, name a tile server: pdr-filter track "
    "--report --tiles URL, or the argument tiles of write_report."
)
_TRACK_COLOURS = (palette.BLUE, palette.ORANGE, palette.GREEN, palette.PURPLE, palette.YELLOW)


def write_report(
    tracks: TrackRows | Sequence[TrackRows],
    path: str | Path,
    recording: Recording | None = None,
    plan: FloorPlan | None = None,
    tiles: str = "",
) -> Path:
    """Write an HTML report of tracks to a file.

    The page is self-contained: without `tiles` it needs no network, no fonts and no other files.

    Parameters
    ----------
    tracks : TrackRows or sequence of TrackRows
        One track, or several tracks in one frame, such as the tracks of several recipes.
    path : str or Path
        File to write, such as "walk.html". Missing folders are created.
    recording : Recording, optional
        Recording of the tracks. If given, the page also shows its ground truth, its locations and how it was read.
    plan : FloorPlan, optional
        Floor plan below the path, in the frame of the tracks. The default is the plan of each track.
    tiles : str, optional
        URL of map tiles, which contains {z}, {x} and {y}. The browser then asks this server for tiles of the place of
        the walk, if the walk is on Earth. By default it asks no server for anything.

    Returns
    -------
    Path
        Path of the file.

    Raises
    ------
    ValueError
        If `tracks` is empty, or `tiles` is not a URL of tiles.
    OSError
        If the file cannot be written.

    See Also
    --------
    html_report : Return the page as text.

    Examples
    --------
    >>> import tempfile
    >>> import pdr_filter as pdr
    >>> from pdr_filter.apps.report.html import write_report
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_report(pdr.track(walk), f"{folder}/walk.html", walk)
    ...     print(path.name, path.exists())
    walk.html True
    """
    return write_text(path, html_report(tracks, recording, plan, tiles))


def html_report(
    tracks: TrackRows | Sequence[TrackRows],
    recording: Recording | None = None,
    plan: FloorPlan | None = None,
    tiles: str = "",
) -> str:
    """Return an HTML report of tracks as text.

    The page shows the path with its 95 % uncertainty, warnings, contexts, speed and step lengths. It is interactive:
    the user can move and zoom the path, select a step, and replay the walk.

    Parameters
    ----------
    tracks : TrackRows or sequence of TrackRows
        One track, or several tracks in one frame, such as the tracks of several recipes. The page shows one track at a
        time in full, and the paths of the others as thin lines.
    recording : Recording, optional
        Recording of the tracks. If given, the page also shows its ground truth, its locations and how it was read.
    plan : FloorPlan, optional
        Floor plan below the path, in the frame of the tracks. The default is the plan of each track.
    tiles : str, optional
        URL of map tiles, which contains {z}, {x} and {y}. The browser then asks this server for tiles of the place of
        the walk, if the walk is on Earth. By default it asks no server for anything.

    Returns
    -------
    str
        Complete HTML document with all scripts, styles and data.

    Raises
    ------
    ValueError
        If `tracks` is empty, or `tiles` is not a URL of tiles.

    See Also
    --------
    write_report : Write the page to a file.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.apps.report.html import html_report
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=10.0)])
    >>> page = html_report(pdr.track(walk), walk)
    >>> page.startswith("<!DOCTYPE html>"), "Walking speed" in page
    (True, True)
    """
    every = [tracks] if isinstance(tracks, TrackRows) else list(tracks)
    if not every:
        raise ValueError("tracks must contain at least one track, got none; pass a Track")
    if tiles and not all(part in tiles for part in ("://", "{z}", "{x}", "{y}")):
        raise ValueError(
            f"tiles must be a URL with {{z}}, {{x}} and {{y}}, such as https://tile.example.org/{{z}}/{{x}}/{{y}}.png, "
            f"got {tiles!r}"
        )
    places = [track.origin for track in every if track.origin is not None and track.frame != "start"]
    origin = [places[0].latitude_deg, places[0].longitude_deg] if places else None
    server = urlsplit(tiles) if tiles and origin else None
    names = _names(every)
    colours = [_TRACK_COLOURS[i % len(_TRACK_COLOURS)] for i in range(len(every))]
    data = [
        track_data(track, recording, plan or plan_of(track), len(every)) | {"colour": colour}
        for track, colour in zip(every, colours, strict=True)
    ]
    return page(
        "report/page/report.html",
        _SCRIPTS,
        title=_title(every, recording),
        tracks=[
            _texts(track) | {"name": name, "colour": colour, "locations": trust.about_locations(track, recording)}
            for track, name, colour in zip(every, names, colours, strict=True)
        ],
        reading=None if recording is None else _reading(recording, reading_report(recording), set(every[0].notes)),
        file_name=_file_name(recording),
        estimates=_SMOOTHED_OR_ONLINE if len({track.estimate for track in every}) > 1 else "",
        data={"tracks": data, "tiles": tiles, "origin": origin},
        about_tiles=_about_tiles(server) if origin else "",
        image_source=f"data: {server.scheme}://{server.netloc.replace('{s}', '*')}" if server else "",
    )


# --- texts -----------------------------------------------------------------------------------------------------------


def _title(tracks: Sequence[TrackRows], recording: Recording | None) -> str:
    """Return the title of the page: the name of the recording, else of the only track, else the number of tracks."""
    if recording is not None and recording.name:
        return recording.name
    return tracks[0].name or "track" if len(tracks) == 1 else f"{len(tracks)} tracks"


def _file_name(recording: Recording | None) -> str:
    """Return the name of the file of a recording if the title of the page does not have it, or an empty string."""
    name = "" if recording is None else Path(recording.source).name
    return "" if recording is None or recording.name in (name, Path(name).stem) or name == "simulated" else name


def _names(tracks: Sequence[TrackRows]) -> list[str]:
    """Return distinct names of tracks. The estimate, the weighting or a number is added if names are equal."""
    estimates = [f"{t.name}, {t.estimate}" for t in tracks]
    for names in ([t.name for t in tracks], estimates, [f"{t.name}, {t.weighting}" for t in tracks]):
        if len(set(names)) == len(names):
            return names
    return [f"{i}: {track.name}, {track.weighting}" for i, track in enumerate(tracks, 1)]


def _texts(track: TrackRows) -> dict[str, Any]:
    """Return the texts of the page about one track, by the names that the template uses."""
    return {
        "facts": _facts(track),
        "doubts": trust.problems(track),
        "has_steps": track.n_steps > 0,
        "has_phone_heading": len(track.phone_heading_rad) > 0,
        "about": f"{track.about_frame} {track.about_estimate} {trust.about_weighting(track)}",
        "seconds": _seconds(track),
        "floor_changes": [
            f"{c.start_s:.0f} to {c.end_s:.0f} s: from floor {c.from_floor} to floor {c.to_floor}, "
            + ("by unknown means" if c.how == "unknown" else f"by {c.how}")
            for c in track.floor_changes()
        ],
        "lengths": _lengths(track),
    }


def _facts(track: TrackRows) -> str:
    minutes, seconds = divmod(round(track.duration_s), 60)
    lasted = f"{minutes} min {seconds} s" if minutes else f"{seconds} s"
    facts = [track.how_far, lasted, how_many(track.n_steps, "step")]
    if track.n_steps:
        facts.append(f"end {trust.end(track)}")
    if track.fixes:
        n_used = sum(fix.accepted for fix in track.fixes)
        facts.append(f"{n_used} of {how_many(len(track.fixes), 'fix', 'fixes')} used")
    return " · ".join(facts)


def _about_tiles(server: SplitResult | None) -> str:
    if server is None:
        return _WITHOUT_TILES
    return f"Map tiles are from {server.netloc}: this server learns where the walk was."


def _seconds(track: TrackRows) -> list[tuple[str, str, str]]:
    """Return name, colour and duration (as text, with its share) of each context that occurs.

    The last entry is the time of moving without steps, if there is any.
    """
    seconds, without_steps_s = track.context_seconds(), track.seconds_without_steps
    total_s = sum(seconds.values()) + without_steps_s
    if total_s <= 0:
        return []

    def lasting(value_s: float) -> str:
        return f"{value_s:.0f} s ({100 * value_s / total_s:.0f} %)"

    prob = shown_context_prob(track)
    items = [
        (name, colour, lasting(seconds[name]))
        for i, (name, colour) in enumerate(palette.context_colours(track.contexts).items())
        if seconds[name] >= 0.5 or (prob[:, i] > _VISIBLE_PROB).any()
    ]
    if without_steps_s > 0:
        items.append((trust.WITHOUT_STEPS, palette.WITHOUT_STEPS, lasting(without_steps_s)))
    return items


def _lengths(track: TrackRows) -> str:
    length_m = track.step_length_m[np.isfinite(track.step_length_m)]
    if not len(length_m):
        return ""
    low, median, high = (float(q) for q in np.quantile(length_m, [0.05, 0.5, 0.95]))
    return f"Coloured by context. Median {median:.2f} m, 5th to 95th percentile {low:.2f} to {high:.2f} m."


def _reading(recording: Recording, report: ReadingReport, already_shown: set[str]) -> dict[str, Any]:
    """Return the texts about the reading of a recording: "lines", and "streams" with a sentence about each stream.

    Each sentence has a flag, True if the stream is unusual. Notes in `already_shown` are left out.
    """
    lines = [f"File: {recording.source}"] if recording.source else []
    lines += [trust.sentence(line) for line in report.about()]
    lines += [trust.sentence(note) for note in report.notes if note not in already_shown]
    streams = [(s.sentence(), s.is_slow or s.n_gaps + s.n_duplicates + s.n_backward > 0) for s in report.streams]
    return {"lines": lines, "streams": streams}
