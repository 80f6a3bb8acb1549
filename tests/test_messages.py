"""The catalogue of messages in docs/messages.md contains the messages of real runs."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

import pdr_filter as pdr
from docs import catalogue
from pdr_filter.simulate import Leg, simulate
from pdr_filter.values import Samples
from pdr_filter.values.notes import NoteSubject

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "messages.md").read_text("utf-8")


def is_listed(text: str, messages: list[catalogue.Message]) -> bool:
    """Return True if a message is one of the catalogue, whose ellipses stand for any text."""
    patterns = (".*".join(map(re.escape, message.text.split(catalogue.ANY))) for message in messages)
    return any(re.search(pattern, text, re.DOTALL) for pattern in patterns)


@pytest.fixture(scope="module")
def walk() -> pdr.Recording:
    return simulate([Leg("stationary", duration_s=2.0), Leg("walking", distance_m=25.0)], seed=1)


def test_notes_of_tracks_are_in_the_catalogue(walk: pdr.Recording) -> None:
    force = walk.accelerometer
    gap = (force.time_s < 8.0) | (force.time_s > 12.0)
    with_gap = replace(walk, accelerometer=Samples(force.time_s[gap], force.values[gap]), gyroscope=None)
    far = [pdr.PositionFix(10.0, np.array([500.0, 500.0]), np.eye(2))]
    notes = [*pdr.track(with_gap).notes, *pdr.track(walk, fixes=far).notes]
    assert len(notes) >= 4
    assert [note for note in notes if not is_listed(note, catalogue.messages()[0])] == []


@pytest.mark.parametrize(
    "text",
    ["", "no table\n", "time_s,x,y,z\n" + "".join(f"{0.01 * k:.2f},0,0,0.99\n" for k in range(300)), '{"a": [1, 2'],
)
def test_refusals_of_files_are_in_the_catalogue(text: str, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    path.write_text(text, "utf-8")
    with pytest.raises(pdr.RecordingError) as refused:
        pdr.read(path)
    assert is_listed(str(refused.value), catalogue.messages()[1])


def test_a_message_that_no_code_has_is_not_in_the_catalogue() -> None:
    assert not is_listed("the moon is in the way: wait", [message for kind in catalogue.messages() for message in kind])


def test_the_page_has_cause_and_remedy_for_each_subject_of_notes() -> None:
    subjects = {note.about for note in catalogue.messages()[0]}
    assert subjects <= {*get_args(NoteSubject), *catalogue.SUBJECTS.values()}
    for subject in subjects:
        section = re.search(rf"^## {subject}$(.*?)(?=^## |\Z)", PAGE, re.MULTILINE | re.DOTALL | re.IGNORECASE)
        assert section, subject
        assert f"{{{{ notes_{subject.replace(' ', '_')} }}}}" in section[1]
        assert len(section[1].split()) > 15, f"{subject}: write cause and remedy"
