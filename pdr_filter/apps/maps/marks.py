"""Marks of a walk: plain files beside its recording that say where the pedestrian was and who walked.

- `fixes.csv`: known positions, `time_s,east_m,north_m,std_m`, with `heading_deg,heading_std_deg` and `floor` where
  known.
- `loop_closures.csv`: two times at one place, `first_s,second_s,std_m`.
- `person.json`: step lengths of the person, as `Person.save` or `pdr_filter.Calibration.save` writes them.
- `walk.json`: an object with any of `person` (name), `height_m`, `is_loop`, `origin` (latitude and longitude in
  degrees), `plan` (path of a floor plan, relative to the folder of the marks), `keep_on_plan` and `truth_as_fixes`
  (true to use the waypoints of the recording, its ground truth, as fixes).

`pdr-filter smooth` and `pdr-filter app` read the same files with `read_marks`, so their results are the same.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pdr_filter.apps.maps.floor_plan import FloorPlan
from pdr_filter.data.io.files.archive import outside
from pdr_filter.data.io.fix_files import FIX_STD_M, LOOP_CLOSURE_STD_M, fixes_of_file, loop_closures_of_file
from pdr_filter.data.io.folders import only_recording_in
from pdr_filter.filter.fixes.gnss import origin_of
from pdr_filter.offline.smoothing.observations import waypoint_fixes
from pdr_filter.values import Origin, limits
from pdr_filter.values.recording import Recording, check_height
from pdr_filter.values.safe_files import open_regular, read_json, read_small, write_text
from pdr_filter.values.sanitise import file_name

if TYPE_CHECKING:
    from pdr_filter.offline.smoothing.observations import LoopClosure
    from pdr_filter.values import HeadingFix, PositionFix

FIXES, LOOP_CLOSURES, PERSON, WALK = NAMES = ("fixes.csv", "loop_closures.csv", "person.json", "walk.json")
# Complete set of new files while a save replaces the old ones; present only after a kill in the middle of a save.
_UNFINISHED = ".marks.json"
_COLUMNS = {
    FIXES: ("time_s", "east_m", "north_m", "std_m", "heading_deg", "heading_std_deg", "floor"),
    LOOP_CLOSURES: ("first_s", "second_s", "std_m"),
}
_STD_M = {FIXES: FIX_STD_M, LOOP_CLOSURES: LOOP_CLOSURE_STD_M}
_KINDS: dict[str, tuple[type, ...]] = {
    "person": (str,),
    "height_m": (int, float),
    "is_loop": (bool,),
    "origin": (list,),
    "plan": (str,),
    "keep_on_plan": (bool,),
    "truth_as_fixes": (bool,),
}


@dataclass(frozen=True, slots=True, eq=False)
class Marks:
    """Marks of one walk: positions, loop closures and person that a user has set, from files in `folder`."""

    folder: Path
    fixes: tuple[PositionFix | HeadingFix, ...] = ()
    loop_closures: tuple[LoopClosure, ...] = ()
    person: Path | None = None  # file with the step lengths of the person
    walk: Mapping[str, Any] = field(default_factory=dict[str, Any])  # content of `walk.json`
    names: tuple[str, ...] = ()  # names of the mark files that exist

    @property
    def plan(self) -> Path | None:
        """Path of the floor plan that `walk.json` names, or None."""
        return (self.folder / self.walk["plan"]).resolve() if self.walk.get("plan") else None

    @property
    def origin(self) -> Origin | None:
        """Origin of the positions that `walk.json` states, or None."""
        return None if self.walk.get("origin") is None else Origin.of(tuple(self.walk["origin"]))

    def all_closures(self, recording: Recording) -> list[LoopClosure]:
        """Return the loop closures of a recording, with one from start to end for a walk that `walk.json` calls one."""
        whole = [LoopClosure(0.0, recording.duration_s)] if self.walk.get("is_loop") else []
        return [*self.loop_closures, *whole]

    def recording(self, recording: Recording) -> Recording:
        """Return the recording with the height of the person that `walk.json` states, or unchanged without one."""
        height_m = self.walk.get("height_m")
        return recording if height_m is None else recording.of_height(height_m)

    def arguments(self, recording: Recording, with_own: bool = True) -> dict[str, Any]:
        """Return the arguments of `pdr_filter.smooth` for a recording with these marks.

        The locations of the recording are used in addition to the marks if `with_own` is True, there are marked points,
        and their origin is the first location. Its waypoints are ground truth, and are used as fixes only if
        `walk.json` asks for it. A floor plan in degrees gives the origin if `walk.json` has none.
        """
        found: dict[str, Any] = {"fixes": list(self.fixes), "loop_closures": list(self.loop_closures)}
        if self.person is not None:
            found["person"] = self.person
        if self.walk.get("is_loop"):
            found["loop"] = True
        origin = self.origin
        if self.plan is not None and (self.fixes or self.walk.get("keep_on_plan")):
            plan = FloorPlan.read(self.plan, origin)
            origin = origin or plan.origin
            if self.walk.get("keep_on_plan"):
                found["plan"] = plan
        location = recording.location
        # the locations are fixes in the frame of the first of them
        if with_own and self.fixes and location is not None and origin == origin_of(location):
            found["gnss"] = "filter"
        elif origin is not None:
            found["origin"] = origin
        if self.walk.get("truth_as_fixes"):
            found["fixes"] += waypoint_fixes(recording)
        return found


def marks_folder(recording: Path) -> Path:
    """Return the folder of the marks of a recording: the files in which a user has set positions and loop closures.

    A recording that is a folder has its marks inside. A file in a folder of its own name, such as walk/walk.zip, has
    them in this folder. Any other file has a folder beside it: walk.zip.marks. A recording inside an archive, or one of
    several in a folder, has a folder with both names: export.zip/walk_2 has export.zip.walk_2.marks.
    """
    path, inside = outside(only_recording_in(recording))
    if inside:
        return (path if path.is_dir() else path.parent) / f"{file_name(f'{path.name}.{inside}')}.marks"
    if path.is_dir():
        return path
    return path.parent if path.parent.name == path.stem else path.with_name(f"{path.name}.marks")


def read_marks(recording: str | Path, origin: tuple[float, float] | None = None) -> Marks:
    r"""Read the marks of a recording from their files.

    Marks are positions, loop closures and the person that a user has set. The files are `fixes.csv`,
    `loop_closures.csv`, `person.json` and `walk.json`, which `pdr-filter app` writes too.

    Parameters
    ----------
    recording : str or Path
        Path of the recording: a file or a folder.
    origin : (latitude_deg, longitude_deg), optional
        Geographic origin of the marks, which replaces the origin in `walk.json`.

    Returns
    -------
    Marks
        Marks of the recording. They are empty if there are no files.

    Raises
    ------
    ValueError
        If a file cannot be used. The message names the file and the remedy.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import pdr_filter as pdr
    >>> from pdr_filter.apps.maps.marks import read_marks
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = pdr.simulate.demo_walk().save(pathlib.Path(folder, "walk"))
    ...     _ = pathlib.Path(folder, "walk", "fixes.csv").write_text("time_s,east_m,north_m\n12.5,3.0,4.0\n")
    ...     marks = read_marks(pathlib.Path(folder, "walk"))
    >>> [fix.position_m.tolist() for fix in marks.fixes]
    [[3.0, 4.0]]
    """
    return marks_in(marks_folder(Path(recording)), origin)


def marks_in(folder: Path, origin: tuple[float, float] | None = None) -> Marks:
    """Return the marks of a walk from the files in a folder, as `read_marks` does."""
    _finish(folder)
    found = [name for name in NAMES if (folder / name).exists()]
    walk = read_json(folder / WALK, limits.MAX_SMALL_BYTES) if WALK in found else {}
    _check_walk(walk, folder / WALK)
    if origin is not None:
        walk = {**walk, "origin": origin}
    return Marks(
        folder,
        tuple(fixes_of_file(folder / FIXES, origin=walk.get("origin"))) if FIXES in found else (),
        tuple(loop_closures_of_file(folder / LOOP_CLOSURES)) if LOOP_CLOSURES in found else (),
        folder / PERSON if PERSON in found else None,
        walk,
        tuple(found),
    )


def mark_files(folder: Path) -> dict[str, bytes]:
    """Return the contents of the files of marks in a folder, by name. An interrupted save is completed."""
    _finish(folder)
    return {n: read_small(folder / n, limits.MAX_WHOLE_BYTES) for n in NAMES if (folder / n).exists()}


def checksum_of(recording: Path) -> str:
    """Return the checksum (SHA-256) of the bytes of a recording, without hidden files and without its marks."""
    path, inside = outside(recording)
    found = hashlib.sha256(inside.encode())
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file() and p.name not in NAMES)
    for file in files:
        if any(part.startswith(".") for part in file.relative_to(path).parts):
            continue
        found.update(f"\n{file.relative_to(path)}\n".encode("utf-8", "surrogateescape"))
        with open_regular(file) as opened:
            while block := opened.read(limits.BLOCK_BYTES):
                found.update(block)
    return found.hexdigest()


def version_of(files: Mapping[str, bytes]) -> str:
    """Return a checksum (16 hex digits) of files, which shows whether another program has changed them."""
    return hashlib.sha256(b"\0".join(p for n in sorted(files) for p in (n.encode(), files[n]))).hexdigest()[:16]


def write_mark_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Replace all files of marks in a folder. A kill at any moment leaves all the old ones or all the new ones."""
    old = mark_files(folder)
    if dict(files) == old:
        return
    write_text(folder / _UNFINISHED, json.dumps({name: content.decode() for name, content in files.items()}))
    _finish(folder)


def _finish(folder: Path) -> None:
    """Complete an interrupted save: write the files of marks in `_UNFINISHED`, and delete all other files of marks."""
    if not (folder / _UNFINISHED).exists():
        return
    new = read_json(folder / _UNFINISHED, 4 * limits.MAX_WHOLE_BYTES)
    for name in NAMES:
        if name not in new:
            (folder / name).unlink(missing_ok=True)
        elif not (folder / name).exists() or (folder / name).read_bytes() != new[name].encode():
            write_text(folder / name, new[name])
    (folder / _UNFINISHED).unlink()


def table_rows(name: str, content: bytes) -> list[list[float | None]]:
    """Return the rows of the CSV file of marks `name` with the bytes `content`.

    An empty cell or a missing column is None, except for a standard deviation, which has its default.
    """
    rows = csv.DictReader(io.StringIO(content.decode()))
    default = {"std_m": _STD_M[name]}
    return [[float(row[c]) if row.get(c) else default.get(c) for c in _COLUMNS[name]] for row in rows]


def table_bytes(name: str, rows: list[list[float | None]]) -> bytes:
    """Return the bytes of the CSV file of marks `name`, with all digits of its rows. None is an empty cell.

    Columns of headings and storeys exist only if one is known. Missing cells at the end of a row are empty.
    """
    columns = _COLUMNS[name]
    whole = [[*row, *[None] * (len(columns) - len(row))] for row in rows]
    if name == FIXES:
        is_empty = {column: all(row[k] is None for row in whole) for k, column in enumerate(columns)}
        is_empty["heading_std_deg"] = is_empty["heading_deg"]
        columns = (*columns[:4], *(column for column in columns[4:] if not is_empty[column]))
    places = [_COLUMNS[name].index(column) for column in columns]
    lines = [",".join("" if (v := row[k]) is None else repr(float(v)) for k in places) for row in whole]
    return ("\n".join([",".join(columns), *lines]) + "\n").encode()


def unused_fixes(recordings: Collection[Path]) -> dict[Path, Path]:
    """Return the files `fixes.csv` in the folders of recordings that are not the marks of any of these recordings.

    Each is mapped to the file from which the marks of the first recording in its folder are read.
    """
    first = {path.parent: path for path in reversed(list(recordings))}
    used = {
        path if path.is_dir() else path.parent for path in recordings if path.is_dir() or path.stem == path.parent.name
    }
    unused = [folder for folder in sorted(first.keys() - used) if (folder / FIXES).is_file()]
    return {folder / FIXES: marks_folder(first[folder]) / FIXES for folder in unused}


def _check_walk(walk: Any, path: Path) -> None:
    """Raise ValueError unless the content of `walk.json` is known and plausible."""
    unknown = sorted(walk.keys() - _KINDS.keys()) if isinstance(walk, dict) else []
    if not isinstance(walk, dict) or unknown:
        got = str(unknown or walk)[:80]
        raise ValueError(
            f"{path}: must be an object with no other names than {', '.join(_KINDS)}, got {got}; correct it"
        )
    for name, value in walk.items():
        if not isinstance(value, _KINDS[name]) or (isinstance(value, bool) and bool not in _KINDS[name]):
            kinds = " or ".join(kind.__name__ for kind in _KINDS[name])
            raise ValueError(f"{path}: {name} must be {kinds}, got {repr(value)[:80]}: correct it in the file")
    try:
        if "height_m" in walk:
            check_height(walk["height_m"])
        if "origin" in walk:
            Origin.of(tuple(walk["origin"]))
    except ValueError as error:
        raise ValueError(f"{path}: {error}; correct this value in the file") from None
