"""Description of a recording (rates, gaps, repeated times, units, truth) and of its reading (source, signs, clock)."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any, cast

import numpy as np

from pdr_filter.values import FloatArray, Samples, how_many, limits
from pdr_filter.values.recording import Recording

# A stream whose mean rate is below this part of the one that was asked for is named: phones often deliver half.
DELIVERED_ENOUGH = 0.9
# In `Recording.meta`: what the reader of another app's format found. Plain values, so that it survives being written.
READING_KEY = "reading"

STREAM_UNITS = {
    "accelerometer": "m/s2",
    "gyroscope": "rad/s",
    "magnetometer": "uT",
    "barometer": "hPa",
    "light": "lux",
    "proximity": "cm",
    "attitude": "quaternion wxyz",
    "location": "deg, m",
}

# Stream, quantity, unit, and where its median lies in a recording in the right unit.
PLAUSIBLE = (
    ("accelerometer", "|specific force|", "m/s2", limits.SPECIFIC_FORCE_RANGE_MPS2),
    ("gyroscope", "|angular rate|", "rad/s", (0.0, limits.MAX_MEDIAN_ANGULAR_RATE_RADPS)),
    ("magnetometer", "|magnetic field|", "uT", limits.MAGNETIC_FIELD_RANGE_UT),
    ("barometer", "pressure", "hPa", limits.PRESSURE_RANGE_HPA),
    ("attitude", "|quaternion|", "", limits.QUATERNION_NORM_RANGE),
)


@dataclass(frozen=True, slots=True)
class StreamDescription:
    """One sensor stream in numbers. None where there are too few samples to know."""

    name: str
    unit: str
    n_samples: int
    rate_hz: float | None  # delivered: 1 / median positive interval
    mean_rate_hz: float | None  # delivered: intervals / time, so gaps and a coarse clock count
    first_s: float | None
    last_s: float | None
    n_gaps: int  # intervals longer than 0.3 s and than 2.5 median intervals
    longest_gap_s: float  # zero without a gap
    n_duplicates: int  # times equal to the one before
    n_backward: int  # times before the one before
    n_missing_rows: int  # rows with an empty value in a column that has others, as not each app writes altitudes
    requested_hz: float | None = None  # None where the app does not say

    @property
    def is_slow(self) -> bool:
        """Whether clearly less was delivered than requested."""
        delivered_hz, asked_hz = self.mean_rate_hz, self.requested_hz
        return delivered_hz is not None and asked_hz is not None and delivered_hz < DELIVERED_ENOUGH * asked_hz

    def sentence(self) -> str:
        """One line for people."""
        rate = "rate unknown" if self.mean_rate_hz is None else f"{self.mean_rate_hz:.1f} Hz delivered"
        if self.requested_hz is not None and self.mean_rate_hz is not None:
            rate += f", {self.requested_hz:.1f} Hz requested"
            if self.is_slow:
                rate += f" ({100 * self.mean_rate_hz / self.requested_hz:.0f} %)"
        gaps = how_many(self.n_gaps, "gap") + (f" (longest {self.longest_gap_s:.2f} s)" if self.n_gaps else "")
        return f"{self.name}: {rate}, {gaps}, {self.n_duplicates} repeated and {self.n_backward} backward times"


@dataclass(frozen=True, slots=True)
class Description:
    """Contents of a recording in plain values."""

    name: str
    source: str
    duration_s: float
    streams: tuple[StreamDescription, ...]
    height_m: float | None  # height of the person, which step lengths depend on
    placement: str | None  # place of the phone, as stated by the recording
    units: tuple[str, ...]  # one sentence for each stream whose unit can be checked
    truth_rows: dict[str, int]  # rows of each truth table that exists
    notes: tuple[str, ...]  # what the reader found: source, signs, units, clock; what it repaired or found odd

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists that json can write."""
        return json.loads(json.dumps(asdict(self)))


@dataclass(frozen=True, slots=True)
class ReadingReport:
    """How a recording was read, in words and numbers."""

    source: str  # app or format, with version and platform as far as the file says
    found: tuple[str, ...]  # signs and units, one sentence for each decision
    clock: str  # where time zero lies, and whose clock it is
    streams: tuple[StreamDescription, ...]
    notes: tuple[str, ...]  # repairs and data that were not used

    def lines(self) -> tuple[str, ...]:
        """The report as lines of text."""
        return (*self.about(), *(stream.sentence() for stream in self.streams), *self.notes)

    def about(self) -> tuple[str, ...]:
        """The lines that the streams themselves do not show: source, signs and units, clock, rates not delivered."""
        slow = [
            f"{stream.name}: {stream.requested_hz:.1f} Hz requested, {stream.mean_rate_hz:.1f} Hz delivered"
            for stream in self.streams
            if stream.is_slow
        ]
        return (f"read as {self.source}", *self.found, f"clock: {self.clock}", *slow)

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists that json can write."""
        return json.loads(json.dumps(asdict(self)))


def describe(recording: Recording) -> Description:
    """Return rates, gaps, unit checks and truth of a recording, and how it was read if it is another app's."""
    report = reading_report(recording)
    return Description(
        name=recording.name,
        source=recording.source,
        duration_s=recording.duration_s,
        streams=report.streams,
        height_m=recording.subject.height_m,
        placement=recording.placement or None,
        units=_unit_sentences(recording),
        truth_rows={name: len(getattr(recording.truth, name)) for name in recording.truth.present()},
        notes=(*(report.about() if READING_KEY in recording.meta else ()), *recording.notes),
    )


def reading_report(recording: Recording) -> ReadingReport:
    """Return the report of the reader, or that of the project's own format for recordings without one."""
    reading = _dict_of(recording.meta.get(READING_KEY))
    requested = _dict_of(reading.get("requested_hz")) or {"accelerometer": recording.meta.get("nominal_rate_hz")}
    found: Any = reading.get("found")
    sentences = cast("list[Any]", found) if isinstance(found, list) else ["SI units, specific force +9.81 on z face up"]
    most = limits.MAX_TEXT_CHARS
    return ReadingReport(
        source=str(reading.get("source") or "own format")[:most],
        found=tuple(str(sentence)[:most] for sentence in sentences[: limits.MAX_SENTENCES]),
        clock=str(reading.get("clock") or "seconds from the first accelerometer sample")[:most],
        streams=tuple(describe_stream(key, samples, requested.get(key)) for key, samples in recording.streams.items()),
        notes=recording.notes,
    )


def describe_stream(name: str, samples: Samples, requested_hz: Any = None) -> StreamDescription:
    """Return rates, gaps and oddities of one stream without NaN times. An invalid `requested_hz` counts as unknown."""
    time_s = samples.time_s
    interval_s = np.diff(time_s)
    forward_s = interval_s[interval_s > 0]
    median_s = float(np.median(forward_s)) if len(forward_s) else np.inf
    gaps_s = forward_s[forward_s > max(limits.GAP_S, limits.GAP_INTERVALS * median_s)]
    span_s = float(time_s.max() - time_s.min()) if len(time_s) else 0.0
    is_empty = np.isnan(samples.values)
    is_rate = isinstance(requested_hz, int | float) and not isinstance(requested_hz, bool) and 0 < requested_hz < 1e6
    return StreamDescription(
        name=name,
        unit=STREAM_UNITS.get(name, ""),
        n_samples=len(samples),
        rate_hz=1 / median_s if len(forward_s) else None,
        mean_rate_hz=(len(time_s) - 1) / span_s if span_s > 0 else None,
        first_s=float(time_s.min()) if len(time_s) else None,
        last_s=float(time_s.max()) if len(time_s) else None,
        n_gaps=len(gaps_s),
        longest_gap_s=float(gaps_s.max(initial=0.0)),
        n_duplicates=int((interval_s == 0).sum()),
        n_backward=int((interval_s < 0).sum()),
        n_missing_rows=int(is_empty[:, ~is_empty.all(axis=0)].any(axis=1).sum()),
        requested_hz=float(requested_hz) if is_rate else None,
    )


def median_norm(values: FloatArray) -> float:
    """Median Euclidean norm of the complete rows of values (N, d), in their unit; NaN if no row is complete."""
    with np.errstate(over="ignore"):  # the square of an absurd value may be infinite; the median does not mind
        squares = np.einsum("ij,ij->i", values, values)  # NaN of a row that is not complete
    squares = squares[~np.isnan(squares)]
    return float(np.median(np.sqrt(squares))) if len(squares) else float("nan")


def _unit_sentences(recording: Recording) -> tuple[str, ...]:
    sentences: list[str] = []
    for name, quantity, unit, (low, high) in PLAUSIBLE:
        samples = recording.streams.get(name)
        median = median_norm(samples.values) if samples else float("nan")
        if not np.isnan(median):
            verdict = "plausible" if low <= median <= high else f"not plausible, expected {low:g} to {high:g}"
            sentences.append(f"{name}: median {quantity} {median:.4g} {unit}".rstrip() + f", {verdict}")
    if (wifi := recording.wifi) is not None:
        sentences.append(f"wifi: {wifi.n_access_points} access points in {len(wifi.scans())} scans, {len(wifi)} rows")
    return tuple(sentences)


def _dict_of(value: Any) -> dict[str, Any]:
    """Return the value if it is a dict, else an empty one: untrusted files may hold anything."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}
