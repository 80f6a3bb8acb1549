"""Walks of a folder and their marks as the pages edit them: versions, undo and redo."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdr_filter.apps.maps.marks import (
    FIXES,
    LOOP_CLOSURES,
    PERSON,
    WALK,
    mark_files,
    marks_folder,
    marks_in,
    table_bytes,
    table_rows,
    version_of,
    write_mark_files,
)
from pdr_filter.data.io.folders import person_of_file, recordings_in
from pdr_filter.values import limits
from pdr_filter.values.safe_files import read_json, write_text
from pdr_filter.values.sanitise import file_name, printable

_MAX_UNDO = 200
HIDDEN = ".pdr_filter"
PLANS, PEOPLE, PHONES = "plans", "people", "phones"

Files = Mapping[str, bytes]


class ConflictError(ValueError):
    """Error for an edit of a version that another browser or program has changed in the meantime."""


@dataclass(slots=True, eq=False)
class Walk:
    """One recording of the folder, with its state of processing, its summary, and the history of its edits."""

    id: str
    path: Path
    name: str
    state: str = "waiting"  # or "working", "done", "failed"
    summary: dict[str, Any] = field(default_factory=dict[str, Any])
    reason: str = ""  # why it cannot be used
    stamp: tuple[int, int] = (0, 0)  # size and time of the last change, by which a changed file is noticed
    history: Path | None = None  # file of the edits that can be taken back
    # Files before an edit, with the version after it.
    _undo: list[tuple[Files, str]] = field(default_factory=list[tuple[Files, str]])
    _redo: list[tuple[Files, str]] = field(default_factory=list[tuple[Files, str]])

    def __post_init__(self) -> None:
        with suppress(OSError, ValueError, TypeError, AttributeError):  # no file yet, or a damaged one
            stored = [] if self.history is None else read_json(self.history, limits.MAX_WHOLE_BYTES)
            for stack, edits in zip((self._undo, self._redo), stored, strict=False):
                stack += [({n: str(c).encode() for n, c in files.items()}, str(v)) for files, v in edits]

    def event(self) -> dict[str, Any]:
        """Return the event that updates the row of this walk in the list of walks on all pages."""
        return {
            **self.summary,
            "subject": self.summary.get("subject") or person_of_file(self.path),
            "event": "walk",
            "id": self.id,
            "name": self.name,
            "state": self.state,
            "reason": self.reason,
            "changed_s": self.stamp[1] / 1e9,
        }

    @property
    def folder(self) -> Path:
        """Folder of the marks of this walk: known positions, loop closures, person and settings (`apps.maps.marks`)."""
        return marks_folder(self.path)

    def marks(self, folder: Path) -> dict[str, Any]:
        """Return the marks of the walk as JSON values for the pages, with their version."""
        files = mark_files(self.folder)
        content = _content(files, self.folder, folder)
        version = version_of(files)
        can_undo, can_redo = (bool(s) and s[-1][1] == version for s in (self._undo, self._redo))
        return {"version": version, "can_undo": can_undo, "can_redo": can_redo, "marks": content}

    def edit(self, version: str, content: Mapping[str, Any], folder: Path) -> None:
        """Replace all marks; ConflictError if they have another version, ValueError if they cannot be used."""
        old = self._old(version)
        new = _files(content, old, self.folder, folder)
        _check(new)
        self._write(old, new, self._undo)
        self._redo.clear()
        self._store_history()

    def undo(self, version: str) -> None:
        """Undo the last edit. ConflictError if there is none of this version."""
        self._back(version, self._undo, self._redo)

    def redo(self, version: str) -> None:
        """Redo the edit that was undone last. ConflictError if there is none of this version."""
        self._back(version, self._redo, self._undo)

    def _back(self, version: str, source: list[tuple[Files, str]], target: list[tuple[Files, str]]) -> None:
        old = self._old(version)
        if not source or source[-1][1] != version:
            raise ConflictError("there is no edit of this version to undo or to redo: reload the page")
        self._write(old, source[-1][0], target)
        source.pop()
        self._store_history()

    def _store_history(self) -> None:
        """Write the edits that can be undone or redone to the file `history`, which a restarted workbench reads."""
        if self.history is not None:
            stacks = [[[{n: c.decode() for n, c in f.items()}, v] for f, v in s] for s in (self._undo, self._redo)]
            with suppress(OSError):
                write_text(self.history, json.dumps(stacks))

    def _old(self, version: str) -> Files:
        old = mark_files(self.folder)
        if version_of(old) != version:
            raise ConflictError(
                "another browser or program has changed the marks of this walk in the meantime: reload the page"
            )
        return old

    def _write(self, old: Files, new: Files, stack: list[tuple[Files, str]]) -> None:
        write_mark_files(self.folder, new)
        stack.append((old, version_of(new)))
        del stack[:-_MAX_UNDO]


class Walks:
    """All walks of a folder, by id."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.by_id: dict[str, Walk] = {}

    def scan(self) -> list[Walk]:
        """Look for recordings, and return the walks that are new or have changed. Deleted ones are forgotten."""
        found: dict[str, Walk] = {}
        changed: list[Walk] = []
        for path in recordings_in(self.folder):
            stamp = _stamp(path)
            name = path.relative_to(self.folder) if path != self.folder else Path(path.name)
            id = hashlib.sha256(str(name).encode("utf-8", "surrogateescape")).hexdigest()[:16]
            walk = self.by_id.get(id)
            if walk is None or walk.stamp != stamp:
                if walk is None:
                    history = self.folder / HIDDEN / "undo" / f"{id}.json"
                    walk = Walk(id, path, printable(_shown(name)), history=history)
                walk.stamp, walk.state = stamp, "waiting"
                changed.append(walk)
            found[id] = walk
        self.by_id = found
        return changed

    def people(self) -> list[str]:
        """Return the names of the people whose step lengths are known, sorted."""
        return sorted(path.stem for path in (self.folder / PEOPLE).glob("*.json"))


def _shown(name: Path) -> str:
    """Return the name of a walk in the list: its path in the folder, or that of a folder of its own name."""
    return str(name.parent) if name.parent.name == name.stem else str(name)


def _stamp(path: Path) -> tuple[int, int]:
    """Return the total size of the files of a recording and the time of their last change in ns, without its marks."""
    while not path.exists() and path != path.parent:  # a recording inside a file
        path = path.parent
    files = [path] if path.is_file() else [p for p in path.iterdir() if p.is_file() and p.name not in _MARKS]
    stats = [file.stat() for file in files]
    return sum(s.st_size for s in stats), max((s.st_mtime_ns for s in stats), default=0)


# Names of fields as the pages show them.
_FIELDS = {"height_m": "Height (m)", "origin": "Latitude of zero"}
_MARKS = (FIXES, LOOP_CLOSURES, PERSON, WALK)


def _content(files: Files, own: Path, folder: Path) -> dict[str, Any]:
    walk = json.loads(files[WALK]) if WALK in files else {}
    if walk.get("plan"):
        path = (own / walk["plan"]).resolve()
        is_ours = path.parent == (folder / PLANS).resolve()
        walk["plan"] = path.stem if is_ours else str(walk["plan"])
    return {
        "fixes": table_rows(FIXES, files[FIXES]) if FIXES in files else [],
        "loop_closures": table_rows(LOOP_CLOSURES, files[LOOP_CLOSURES]) if LOOP_CLOSURES in files else [],
        "has_person": PERSON in files,
        "walk": walk,
    }


def _files(content: Mapping[str, Any], old: Files, own: Path, folder: Path) -> Files:
    """Return the contents of the mark files, by file name, from the marks that a page has sent.

    `old` are the present files, `own` is their folder, and `folder` is the folder of the workbench. The file with the
    step length of the person is kept while the name of the person stays the same. For another name, it is the file of
    this person in `folder`, if there is one. ValueError for a floor plan that is not in `folder`.
    """
    walk = {name: value for name, value in dict(content["walk"]).items() if value not in (None, "", False)}
    before = json.loads(old[WALK]) if WALK in old else {}
    if plan := walk.get("plan"):
        known = next((p for p in (folder / PLANS).glob("*.geojson") if p.stem == plan), None)
        if known is not None:
            walk["plan"] = Path(os.path.relpath(known, own)).as_posix()
        elif before.get("plan") != plan:
            raise ValueError(f"there is no floor plan {str(plan)[:80]!r} in this folder: choose another one")
    files: dict[str, bytes] = {}
    for name, rows in ((FIXES, content["fixes"]), (LOOP_CLOSURES, content["loop_closures"])):
        if rows:
            files[name] = table_bytes(name, sorted(rows, key=lambda row: row[0]))
    if walk:
        files[WALK] = (json.dumps(walk, indent=1, sort_keys=True) + "\n").encode()
    if PERSON in old and content.get("has_person", True) and walk.get("person") == before.get("person"):
        files[PERSON] = old[PERSON]
    elif walk.get("person") and walk.get("person") != before.get("person"):
        stem = file_name(walk["person"])
        known = next((p for p in (folder / PEOPLE).glob("*.json") if p.stem == stem), None)
        if known is not None:
            files[PERSON] = known.read_bytes()
    return files


def _check(files: Files) -> None:
    """Raise ValueError unless the files can be read as marks. The message names the fields as the pages show them."""
    with tempfile.TemporaryDirectory() as folder:
        for name, content in files.items():
            (Path(folder) / name).write_bytes(content)
        try:
            marks_in(Path(folder))
        except ValueError as error:
            words = str(error).replace(f"{folder}/", "").removesuffix("; correct this value in the file")
            for name, field in _FIELDS.items():
                words = words.replace(f"{WALK}: {name}", f"the field {field}")
            raise ValueError(words) from None
