"""Notes: warnings about a recording or a track, each with its subject."""

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
    """Warning with its subject. The text is one sentence without a full stop: problem, likely cause and remedy."""

    about: NoteSubject
    text: str
