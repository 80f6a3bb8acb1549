"""Notes: what to keep in mind about a track, in plain words, each about one thing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NoteSubject = Literal[
    "samples",
    "sensors",
    "contexts",
    "steps",
    "heading",
    "placement",
    "height",
    "step lengths",
    "fixes",
    "recipe",
    "plan",
]


@dataclass(frozen=True, slots=True)
class Note:
    """One sentence without a full stop, and what it is about."""

    about: NoteSubject
    text: str
