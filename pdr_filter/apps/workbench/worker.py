"""Worker process of the workbench: reads, smooths and exports walks, and converts pictures of floor plans.

Every request names files that the server has chosen, so no text from a browser becomes a path here. Results are in the
cache under the checksum of all that they depend on: the recording, its marks, its floor plan, the version and the
files of the report.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.apps.batch.worker_process import reason_of
from pdr_filter.apps.live.recorder import zip_parts
from pdr_filter.apps.maps.floor_plan import FloorPlan, plan_of
from pdr_filter.apps.maps.marks import NAMES, checksum_of, mark_files, marks_folder, marks_in, version_of
from pdr_filter.apps.report.html import html_report
from pdr_filter.apps.workbench.pictures import convert_picture, rectify
from pdr_filter.apps.workbench.plans import pictures_of
from pdr_filter.data.io.files.archive import outside
from pdr_filter.data.io.files.track_writers import GEOGRAPHIC_KINDS, write_by_suffix
from pdr_filter.data.io.folders import recordings_of
from pdr_filter.data.io.formats import read
from pdr_filter.offline.smoothing.smooth import SmoothingMemory, smooth
from pdr_filter.recipes import for_recording
from pdr_filter.tracking.track import Track
from pdr_filter.values import limits
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import read_small, write_text
from pdr_filter.version import __version__

_PACKAGE = Path(__file__).parents[2]
# Points of the small picture of a path.
_N_POINTS = 120
_MAX_CACHED = 2000
_PROGRESS_S = 0.2
# A path this far from its floor plan is not in view with it. A user marks points at places that are in view.
_FAR_M = 500.0
EXPORTS: dict[str, str] = {
    "csv": "text/csv",
    "geojson": "application/geo+json",
    "gpx": "application/gpx+xml",
    "kml": "application/vnd.google-earth.kml+xml",
    "zip": "application/zip",
}


def make_worker(cache: str) -> Callable[[tuple[str, Sequence[Any]]], Any]:
    """Return the function that answers requests; it is called in the worker process.

    A request is the name of a method of `Worker` and its arguments. The answer to a request that fails is
    {"error": reason, "errno": number of an OSError, otherwise None}.
    """
    worker = Worker(Path(cache))

    def answer(request: tuple[str, Sequence[Any]]) -> Any:
        method, arguments = request
        try:
            return getattr(worker, method)(*arguments)
        except Exception as error:  # a damaged file can raise any error
            if isinstance(error, FileNotFoundError) and Path(str(error.filename)).is_relative_to(_PACKAGE):
                words = "a file of pdr_filter is missing, because it was installed again: start the workbench again"
                return {"error": words, "errno": error.errno}
            return {"error": reason_of(error), "errno": error.errno if isinstance(error, OSError) else None}

    return answer


@dataclass(slots=True)
class _Opened:
    """Recording in memory, with intermediate results that make smoothing it again fast."""

    path: str
    checksum: str
    recording: Recording
    memory: SmoothingMemory = field(default_factory=SmoothingMemory)


class Worker:
    """Object in a worker process whose methods answer requests. The recording of the last one stays in memory."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self._opened: _Opened | None = None

    def walk(self, path: str, is_to_stay: bool = False) -> dict[str, Any]:
        """Return the summary of a walk (`_summary`), computed or from the cache. Its report is in the cache afterwards.

        `is_to_stay` keeps the recording in memory for further requests.
        """
        checksum = checksum_of(Path(path))
        key = self._key(Path(path), checksum)
        file = self.cache / f"{key}.json"
        if file.exists() and (self.cache / f"{key}.html").exists():
            if is_to_stay:  # a request with other marks then repeats only the least squares
                opened = self._open(path, checksum)
                with suppress(ValueError):
                    self._smoothed(opened, None)
            return json.loads(file.read_bytes())
        progress = self._progress(path)
        opened = self._open(path, checksum)
        track, plan = self._smoothed(opened, progress)
        track = _for_page(track, plan)
        write_text(self.cache / f"{key}.html", html_report(track, opened.recording, plan))
        person = marks_in(marks_folder(Path(path))).walk.get("person") or opened.recording.subject.id
        summary = _summary(track, opened.recording) | {
            "key": key,
            "subject": str(person or ""),
            "pictures": _pictures(Path(path), plan or plan_of(track)),
        }
        write_text(file, json.dumps(summary))
        (self.cache / f"{_name_of(path)}.progress").unlink(missing_ok=True)
        if not is_to_stay:
            self._opened = None
            self._prune()
        return summary

    def compare(self, path: str, variants: Sequence[tuple[str, str]]) -> dict[str, Any]:
        """Return the key of a cached report with pairs of a recipe and a weighting for a walk, as {"key": key}."""
        checksum = checksum_of(Path(path))
        names = json.dumps(list(variants))
        key = hashlib.sha256(f"{self._key(Path(path), checksum)} {names}".encode()).hexdigest()[:32]
        if not (self.cache / f"{key}.html").exists():
            opened = self._open(path, checksum)
            tracks: list[Track] = []
            plan = None
            for recipe, weighting in variants:
                recording = marks_in(marks_folder(Path(path))).recording(opened.recording)
                config = for_recording(recipe, recording)
                found, plan = self._smoothed(opened, None, config=config, weighting=weighting or None)
                tracks.append(replace(_for_page(found, plan), name=f"{recipe}, {weighting or found.weighting}"))
            write_text(self.cache / f"{key}.html", html_report(tracks, opened.recording, plan))
        return {"key": key}

    def export(self, path: str, kind: str) -> tuple[str, bytes]:
        """Return the name and content of an exported file of a walk.

        The kind "zip" is the recording with its marks. "csv", "geojson", "gpx" and "kml" are the smoothed track.
        ValueError for "gpx" and "kml" if the track has no place on Earth.
        """
        opened = self._open(path, checksum_of(Path(path)))
        if kind == "zip":
            return f"{opened.recording.name}.zip", _zipped(Path(path))
        track, _ = self._smoothed(opened, None)
        if track.origin is None and kind in GEOGRAPHIC_KINDS:
            raise ValueError(f"{kind} needs a place on Earth: place the walk on a map, or give Latitude of zero")
        with tempfile.TemporaryDirectory() as folder:
            file = write_by_suffix(track, Path(folder) / f"walk.{kind}", opened.recording.epoch_s)
            return f"{track.name}{file.name.removeprefix('walk')}", file.read_bytes()

    def teach(self, path: str, person: str) -> dict[str, Any]:
        """Save the step length that the fixes of a walk determine to the file `person`, and return it.

        The result has the step length in m, its relative standard deviation `std` and the number of fixes `n_fixes`.
        ValueError if the fixes do not determine it.
        """
        opened = self._open(path, checksum_of(Path(path)))
        track, _ = self._smoothed(opened, None)
        if track.person is None:
            raise ValueError(
                "the fixes do not determine the step length: add fixes that are farther apart along the walk"
            )
        track.person.save(person)
        session = track.person.sessions[-1]
        return {"step_length_m": session.step_length_m, "std": session.std, "n_fixes": session.n_fixes}

    def check(self, path: str) -> dict[str, Any]:
        """Return the number of recordings in a new file or folder, as {"n": number}, if the first can be read."""
        found = recordings_of(path)
        read(found[0])
        return {"n": len(found)}

    def picture(self, source: str, page: int, target: str) -> dict[str, Any]:
        """Convert a PNG, JPEG or a page of a PDF file to PNG and return its size."""
        return convert_picture(Path(source), page, Path(target))

    def rectify(self, path: str, corners: Sequence[Sequence[float]]) -> dict[str, Any]:
        """Turn the quadrilateral of four corners in a picture into a whole picture and return its size."""
        return rectify(Path(path), corners)

    # --- parts ---

    def _open(self, path: str, checksum: str) -> _Opened:
        if self._opened is None or (self._opened.path, self._opened.checksum) != (path, checksum):
            self._opened = None
            self._opened = _Opened(path, checksum, read(path))
        return self._opened

    def _smoothed(
        self, opened: _Opened, progress: Callable[[float], None] | None, **options: Any
    ) -> tuple[Track, FloorPlan | None]:
        """Return the smoothed track of a walk, and the floor plan to draw below it.

        The plan is None if the walk has none, or if the track itself holds it. The marks of the walk (fixes, loop
        closures, person and settings that the user has set in the workbench) are passed to the smoother.
        """
        marks = marks_in(marks_folder(Path(opened.path)))
        recording = marks.recording(opened.recording)
        if recording is not opened.recording:  # the memory knows a recording by its identity
            own = opened.memory.recording
            if own is not None and own.subject == recording.subject:
                recording = own
        known = marks.arguments(recording)
        track = smooth(recording, progress=progress, memory=opened.memory, **(known | options)).track
        if marks.plan is None or track.plan is not None:
            return track, None
        plan = FloorPlan.read(marks.plan)
        if plan.origin is not None and track.origin is not None:
            plan = FloorPlan.read(marks.plan, track.origin)
        return track, plan

    def _key(self, path: Path, checksum: str) -> str:
        folder = marks_folder(path)
        plan = marks_in(folder).plan
        drawn = b"" if plan is None or not plan.exists() else read_small(plan, limits.MAX_PLAN_BYTES)
        parts = checksum, version_of(mark_files(folder)), hashlib.sha256(drawn).hexdigest(), __version__, _of_report()
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]

    def _progress(self, path: str) -> Callable[[float], None]:
        """Return a function that writes the progress to a file, which the server looks at."""
        file, last_s = self.cache / f"{_name_of(path)}.progress", 0.0

        def show(fraction: float) -> None:
            nonlocal last_s
            if time.monotonic() - last_s > _PROGRESS_S:
                last_s = time.monotonic()
                with suppress(OSError):
                    file.write_text(f"{fraction:.2f}")

        return show

    def _prune(self) -> None:
        """Delete the oldest files of a cache that is too large."""
        files = sorted((p for p in self.cache.glob("*.*") if p.is_file()), key=lambda p: p.stat().st_mtime)
        for path in files[: max(len(files) - 2 * _MAX_CACHED, 0)]:
            path.unlink(missing_ok=True)


def progress_of(cache: Path, path: str) -> float:
    """Return the fraction of the work on a walk that is done, as its worker last wrote it to a file, or 0."""
    with suppress(OSError, ValueError):
        return float((cache / f"{_name_of(path)}.progress").read_text())
    return 0.0


@cache
def _of_report() -> str:
    """Return the checksum of all files that make a report: a stored report must fit the page that shows it."""
    files = [p for p in (_PACKAGE / "apps" / "report").rglob("*") if p.suffix in (".py", ".js", ".css", ".html")]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files))).hexdigest()


def _name_of(path: str) -> str:
    return hashlib.sha256(path.encode("utf-8", "surrogateescape")).hexdigest()[:16]


def _for_page(track: Track, plan: FloorPlan | None) -> Track:
    """Return the track with notes in the words of the pages: without code marks, and with seconds for windows.

    If the floor plan is more than 500 m from the path, a note in front says so.
    """
    notes = [note.replace("`", "").replace(" windows", " seconds") for note in track.notes]  # one window a second
    lines = [] if plan is None else [line for s in plan.storeys for f in s.features for line in f.lines]
    if lines and track.n_steps:
        corners = np.concatenate(lines)
        beyond = np.maximum(corners.min(axis=0) - track.position_m, track.position_m - corners.max(axis=0))
        apart_m = float(np.linalg.norm(np.maximum(beyond, 0.0), axis=1).min())
        if apart_m > _FAR_M:
            apart = f"{apart_m:.0f} m" if apart_m < 10_000 else f"{apart_m / 1000:.0f} km"
            notes.insert(
                0,
                f"the floor plan lies {apart} from the path and is out of view: one of them is at a wrong place on "
                "Earth; choose another floor plan, or mark two points of the path on this one",
            )
    return replace(track, notes=tuple(notes))


def _summary(track: Track, recording: Recording) -> dict[str, Any]:
    """Return the entry of a walk in the list of walks, as JSON values by name.

    It has the unix time of its begin, duration, number of steps, distance, notes, frame and origin of the track, the
    height of the person in the recording, and whether this has waypoints. The thumbnail `path` has at most `_N_POINTS`
    positions of the track in m. `unused` has time, outcome and normalised innovation squared of the fixes that were
    not used.
    """
    points = np.vstack([track.start_position_m, track.position_m])
    points = points[np.isfinite(points).all(axis=1)]
    rows = np.unique(np.linspace(0, len(points) - 1, min(_N_POINTS, len(points))).astype(int))
    origin = track.origin
    return {
        "epoch_s": recording.epoch_s,
        "duration_s": round(track.duration_s, 1),
        "n_steps": track.n_steps,
        "distance_m": round(track.distance_m, 1),
        "path": np.round(points[rows], 1).tolist(),
        "notes": list(track.notes),
        "frame": track.frame,
        "origin": None if origin is None else [origin.latitude_deg, origin.longitude_deg],
        "unused": [
            [fix.time_s, fix.outcome, fix.nis if np.isfinite(fix.nis) else None]
            for fix in track.fixes
            if not fix.accepted
        ],
        "height_m": recording.subject.height_m,
        "has_waypoints": recording.truth.waypoints is not None,
    }


def _pictures(path: Path, plan: FloorPlan | None) -> list[dict[str, Any]]:
    """Return the pictures of the floor plan of a walk (`plans.pictures_of`), in the frame of the drawn plan."""
    file = marks_in(marks_folder(path)).plan
    return [] if file is None or plan is None else pictures_of(file, plan.origin)


def _zipped(recording: Path) -> bytes:
    """Return the bytes of a zip file with the files of a recording, without hidden ones, and its marks."""
    path, _ = outside(recording)
    folder = marks_folder(recording)
    inside = [p for p in path.rglob("*") if p.is_file() and not p.name.startswith(".")]
    members = {path.name: path} if path.is_file() else {str(p.relative_to(path)): p for p in inside}
    return b"".join(zip_parts(members | {name: folder / name for name in NAMES if (folder / name).exists()}))
