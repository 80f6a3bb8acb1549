"""From what a reader parsed to a recording: one time base, unknown values, checks, the reading report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.io.checks import (
    UP_COSINE_DOUBTFUL,
    UP_COSINE_WRONG_SIGN,
    check_accelerometer,
    check_gyroscope,
    finite,
    overlap_notes,
    up_cosine,
    with_time,
)
from pdr_filter.io.describe import describe_stream
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording, Truth
from pdr_filter.io.report import reading_meta
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.samples import Samples


@dataclass
class Parsed:
    """What a reader fills while it works: streams on any common time base, and what it found."""

    path: Path
    source: str  # app or format, as the report names it
    streams: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict[str, tuple[FloatArray, FloatArray]])
    truth: dict[str, dict[str, FloatArray]] = field(default_factory=dict[str, dict[str, FloatArray]])
    meta: dict[str, Any] = field(default_factory=dict[str, Any])
    found: list[str] = field(default_factory=list[str])  # signs and units
    clock: str = "seconds from the first accelerometer sample"
    requested_hz: dict[str, float] = field(default_factory=dict[str, float])
    notes: list[str] = field(default_factory=list[str])

    def recording(self) -> Recording:
        """The recording, with times from the first accelerometer sample; RecordingError if it cannot be right."""
        where = str(self.path)
        if "accelerometer" not in self.streams:
            raise RecordingError(f"{where}: no accelerometer with gravity; record it and export again")
        streams: dict[str, Samples] = {}
        zero_s = np.nan
        for name in sorted(self.streams, key=lambda name: name != "accelerometer"):
            time_s, values = self.streams[name]
            time_s, values = time_s.astype(float), finite(np.array(values, dtype=float), name, self.notes)
            finite(time_s, f"{name} times", self.notes)
            kept = with_time(time_s, name, self.notes)
            time_s, values = time_s[kept], values[kept]
            if name == "accelerometer":
                zero_s = time_s[0] if len(time_s) else 0.0
            samples = Samples(time_s - zero_s, values)
            if name == "accelerometer":
                check_accelerometer(samples, f"{where}: accelerometer")
            elif np.isnan(samples.values).all():  # also true of no rows
                self.notes.append(f"{name}: no values, left out")
                continue
            streams[name] = samples
        if "gyroscope" in streams:
            check_gyroscope(streams["gyroscope"], f"{where}: gyroscope")
        self._check_up(streams, where)
        self.notes += [note.replace(".csv", "") for note in overlap_notes(streams)]
        for name, samples in streams.items():
            stream = describe_stream(name, samples)
            if stream.n_duplicates or stream.n_backward:
                self.notes.append(
                    f"{name}: {stream.n_duplicates} repeated and {stream.n_backward} backward times, kept as recorded"
                )
        from pdr_filter.values.arrays import table

        truth = {
            name: table(
                {
                    key: column - zero_s if key in ("time_s", "start_s", "end_s") else column
                    for key, column in columns.items()
                }
            )
            for name, columns in self.truth.items()
        }
        reading = reading_meta(self.source, self.found, self.clock, self.requested_hz)
        return Recording(
            name=_name(self.path),
            **streams,
            truth=Truth(**truth),
            meta={**self.meta, "reading": reading},
            source=str(self.path),
            notes=tuple(self.notes),
        )

    def _check_up(self, streams: Mapping[str, Samples], where: str) -> None:
        """The phone's own attitude says which way is up: the only witness of the sign of the accelerometer."""
        if "attitude" not in streams:
            return
        cosine = up_cosine(streams["accelerometer"], streams["attitude"])
        if np.isnan(cosine):
            return
        if cosine < UP_COSINE_WRONG_SIGN:
            raise RecordingError(
                f"{where}: the specific force points down in the phone's own attitude (mean cosine {cosine:.2f}), so "
                "its sign does not fit the platform that the file names; correct the file's meta data"
            )
        if cosine < UP_COSINE_DOUBTFUL:
            self.notes.append(f"attitude: the specific force does not point up in it (mean cosine {cosine:.2f})")
        else:
            self.found.append(f"sign checked with the phone's attitude: mean cosine to up {cosine:.2f}")


def _name(path: Path) -> str:
    own = path.resolve().name if path.is_dir() else path.stem
    return own if own.isprintable() and own.strip(". ") else "recording"
