"""Conversion of parsed streams to a recording: common clock, missing values, and checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.data.io.checks import checked_streams, constant_axis, is_of_phone, up_cosine
from pdr_filter.data.io.files.own_format_writer import RESTORED_GRAVITY_KEY, TIME_COLUMNS
from pdr_filter.data.io.row_times import in_order, streams_with_own_times
from pdr_filter.data.io.wifi_rows import wifi_of
from pdr_filter.sensing.gravity import with_gravity
from pdr_filter.values import FloatArray, Samples, limits, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import READING_KEY, Recording, Truth


@dataclass
class Parsed:
    """Streams on a common clock, and findings about them, which the reader of a format stores here."""

    path: Path
    source: str  # app or format, as the report names it
    streams: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict[str, tuple[FloatArray, FloatArray]])
    wifi: tuple[FloatArray, FloatArray] | None = None  # times (N,); address, dBm and MHz (N, 3)
    truth: dict[str, dict[str, FloatArray]] = field(default_factory=dict[str, dict[str, FloatArray]])
    meta: dict[str, Any] = field(default_factory=dict[str, Any])
    found: list[str] = field(default_factory=list[str])  # signs and units
    clock: str = "seconds from the first accelerometer sample"
    is_unit_of_time_declared: bool = False  # by the file itself
    is_clock: bool = False  # times are dates or clock times
    rate_hz: float = 0.0  # of samples whose packs have one time; 0 if it is to be estimated
    requested_hz: dict[str, float] = field(default_factory=dict[str, float])
    linear: str = ""  # name of the acceleration, if it lacks gravity
    instead: str = "the accelerometer with gravity"  # sensor to record in place of it
    notes: list[str] = field(default_factory=list[str])

    def set_device(self, *words: str | None) -> None:
        """Store the words, joined by spaces, as phone model in `meta`, unless all are empty or None."""
        if device := " ".join(word for word in words if word).strip():
            self.meta["device"] = device[: limits.MAX_NAME_CHARS]

    def recording(self) -> Recording:
        """Return the recording of the stored streams. Its time zero is the first accelerometer sample.

        Rows are sorted, samples of one time spread, and gravity added to an acceleration that lacks it (`linear`).
        RecordingError if there is no accelerometer, or if its values, times or sign are implausible.
        """
        where = str(self.path)
        if "accelerometer" not in self.streams:
            raise RecordingError(f"{where}: no accelerometer with gravity; record it and export again")
        first_s = self.streams["accelerometer"][0][:1]
        self.streams = in_order(self.streams, "", self.notes)
        self.streams = streams_with_own_times(self.streams, self.is_clock, self.rate_hz, self.notes)
        if self.linear:
            self._restore_gravity(where)
        time_s = self.streams["accelerometer"][0]
        self._move_epoch(float((time_s[:1] - first_s).sum()))
        zero_s = float(next(iter(time_s[np.abs(time_s) <= limits.LARGEST_VALUE]), 0.0))
        self._leave_out_of_phone()
        streams = checked_streams(self.streams, zero_s, "", where, self.notes, self.is_unit_of_time_declared)
        self._check_up(streams, where)
        truth = {
            name: table({key: column - zero_s if key in TIME_COLUMNS else column for key, column in columns.items()})
            for name, columns in self.truth.items()
        }
        reading = {"source": self.source, "found": self.found, "clock": self.clock, "requested_hz": self.requested_hz}
        own_name = self.path.resolve().name if self.path.is_dir() else self.path.stem
        return Recording(
            name=own_name if own_name.isprintable() and own_name.strip(". ") else "recording",
            **streams,
            wifi=None if self.wifi is None else wifi_of(self.wifi[0] - zero_s, self.wifi[1], "wifi", self.notes),
            truth=Truth(**truth),
            meta={**self.meta, READING_KEY: reading},
            source=where,
            notes=tuple(self.notes),
        )

    def _leave_out_of_phone(self) -> None:
        """Leave out the phone's own steps and headings if they are something else. `found` gets a sentence about it."""
        time_s = self.streams["accelerometer"][0]
        known_s = time_s[np.isfinite(time_s)]
        duration_s = float(np.ptp(known_s)) if len(known_s) else 0.0
        for name, (at_s, values) in [*self.streams.items()]:
            if not is_of_phone(name, at_s, values, duration_s):
                del self.streams[name]
                self.found.append(f"{name}: left out, because its values are not those of a phone")

    def _restore_gravity(self, where: str) -> None:
        """Add gravity to the stored acceleration, along the vertical of gyroscope and steps, with a note.

        RecordingError if the samples do not show the vertical, or if an axis is constant.
        """
        if still := constant_axis(self.streams["accelerometer"][1]):
            raise RecordingError(
                f"{where}: {self.linear}: {still}, and the other axes lack gravity; record all three axes"
            )
        gyroscope = Samples(*self.streams["gyroscope"]) if "gyroscope" in self.streams else None
        try:
            restored = with_gravity(Samples(*self.streams["accelerometer"]), gyroscope)
        except ValueError as error:
            raise RecordingError(f"{where}: {self.linear}: {error}; or export {self.instead}") from error
        self.streams["accelerometer"] = restored.force.time_s, restored.force.values
        self.found.append(f"accelerometer: {self.linear}, with gravity along the vertical of the walk")
        if gyroscope is None:
            words = (
                "and there is no gyroscope: only steps and distance can be trusted; next time record the gyroscope and "
            )
        else:
            mirrored = "" if restored.is_sense_sure else ", and the path may be mirrored"
            words = (
                "so that the vertical was estimated from the gyroscope and the steps: turns and directions are less "
            )
            words += f"certain{mirrored}; next time record "
        self.notes.insert(0, f"the acceleration ({self.linear}) lacks gravity, {words}{self.instead}")
        self.meta[RESTORED_GRAVITY_KEY] = True

    def _move_epoch(self, by_s: float) -> None:
        """Add `by_s` seconds to the Unix time of time zero, because time zero moves by that much."""
        if by_s:
            for name, per_s in (("epoch_s", 1.0), ("epoch_ns", 1e9)):
                if name in self.meta:
                    self.meta[name] += type(self.meta[name])(by_s * per_s)

    def _check_up(self, streams: Mapping[str, Samples], where: str) -> None:
        """Raise RecordingError if the sign of the accelerometer contradicts the phone's own attitude.

        A weak agreement gives a note. Without an attitude nothing is checked.
        """
        cosine = up_cosine(streams["accelerometer"], streams["attitude"]) if "attitude" in streams else np.nan
        if np.isnan(cosine):
            return
        if cosine < limits.UP_COSINE_WRONG_SIGN:
            raise RecordingError(
                f"{where}: the specific force points down in the phone's own attitude (mean cosine {cosine:.2f}): "
                "the acceleration has the opposite sign, such as that of another platform, or the attitude is wrong; "
                "correct the platform or the sign, or leave the attitude out"
            )
        if cosine < limits.UP_COSINE_DOUBTFUL:
            self.notes.append(f"attitude: the specific force does not point up in it (mean cosine {cosine:.2f})")
        else:
            self.found.append(
                "the sign of the acceleration agrees with the phone's attitude: it points up on average "
                f"(mean cosine {cosine:.2f}, 1 is right)"
            )
