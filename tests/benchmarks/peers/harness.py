"""Runs methods over walks and makes tables in which nothing is hidden."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .walks import Found, Method, Walk

Table = tuple[list[str], list[list[str]]]


@dataclass(frozen=True)
class Outcome:
    """What a method made of the walks of a site."""

    method: Method
    found: tuple[tuple[Walk, Found], ...]
    failures: tuple[str, ...]  # errors, one for each walk that it did not get through
    missing: str  # why the package cannot be used; empty if it can

    @property
    def title(self) -> str:
        """Its name, and on how many walks it failed."""
        if not self.failures:
            return self.method.name
        return f"{self.method.name} (failed on {len(self.failures)}: {self.failures[0]})"


def outcome(method: Method, walks: Sequence[Walk]) -> Outcome:
    """Return what the method finds on each walk."""
    try:
        run = method.load()
    except ImportError as error:
        return Outcome(method, (), (), f"not run: {method.package} is not installed ({error})")
    found: list[tuple[Walk, Found]] = []
    failures: list[str] = []
    for walk in walks:
        try:
            found.append((walk, run(walk)))
        except Exception as error:  # whatever a package raises on real data is a result, and no reason to stop
            failures.append(f"{walk.recording.name}, {type(error).__name__}: {error}")
    return Outcome(method, tuple(found), tuple(failures), "")


def table(columns: Sequence[str], outcomes: Sequence[Outcome], cells: Callable[[Outcome], Sequence[str]]) -> Table:
    """Columns and rows of a table with a row for each method, those that could not run included."""
    rows = []
    for o in outcomes:
        found = cells(o) if o.found else [o.missing or "failed on every walk", *[""] * (len(columns) - 1)]
        rows.append([o.title, *found])
    return ["method", *columns], rows
