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
    """Warning with its subject.

    Attributes
    ----------
    about : str
        Subject of the warning, one of `NoteSubject`.
    text : str
        One sentence without a full stop: problem, likely cause and remedy.

    Examples
    --------
    >>> from pdr_filter.values.notes import Note
    >>> Note("steps", "no steps were detected: the phone did not move").about
    'steps'
    """

    about: NoteSubject
    text: str
