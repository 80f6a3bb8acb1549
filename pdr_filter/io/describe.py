"""What is in a recording: rates, gaps, repeated times, plausibility of units, truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pdr_filter.io.recording import Recording
from pdr_filter.values.arrays import FloatArray
from pdr_filter.values.samples import Samples

# A pause longer than this in a sensor that samples faster is a gap: within it a step can be missed.
GAP_S = 0.3
# A slow sensor (1 Hz GNSS) has a gap only where samples are missing, so where an interval is this many usual ones.
GAP_INTERVALS = 2.5

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

# Stream, quantity, unit, and where its median lies in a recording in the right unit. Specific force and angular rate:
# rest, walking, jogging with the phone in the pocket or on the foot (up to 15.5 m/s2 and 4.3 rad/s in 349 real
# recordings). Field: the Earth's is 22 to 67 uT, steel indoors bends it a little further. Pressure: 5000 m up to a deep
# valley. The norm of a quaternion is one.
PLAUSIBLE = (
    ("accelerometer", "|specific force|", "m/s2", 5.0, 25.0),
    ("gyroscope", "|angular rate|", "rad/s", 0.0, 12.0),
    ("magnetometer", "|magnetic field|", "uT", 20.0, 80.0),
    ("barometer", "pressure", "hPa", 500.0, 1100.0),
    ("attitude", "|quaternion|", "", 0.98, 1.02),
)


@dataclass(frozen=True, slots=True)
class StreamDescription:
    """One sensor stream in numbers. None where there are too few samples to tell."""

    name: str
    unit: str
    n_samples: int
    rate_hz: float | None  # delivered: 1 / median positive interval
    mean_rate_hz: float | None  # delivered: intervals / time, so gaps and a coarse clock count
    first_s: float | None
    last_s: float | None
    n_gaps: int  # intervals longer than 0.3 s and than 2.5 usual ones
    longest_gap_s: float  # zero where there is no gap
    n_duplicates: int  # times equal to the one before
    n_backward: int  # times before the one before
    n_missing_rows: int  # rows with at least one empty value


@dataclass(frozen=True, slots=True)
class Description:
    """What is in a recording, in plain values."""

    name: str
    source: str
    duration_s: float
    streams: tuple[StreamDescription, ...]
    height_m: float | None  # of the person; step lengths depend on it
    placement: str | None  # of the phone, as the recording states it
    units: tuple[str, ...]  # one sentence for each stream whose unit can be checked
    truth_rows: dict[str, int]  # rows of each truth table that exists
    notes: tuple[str, ...]  # what the reader found: source, signs, units, clock; what it repaired or found odd

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists that json can write."""
        return asdict(self) | {
            "streams": [asdict(stream) for stream in self.streams],
            "units": list(self.units),
            "notes": list(self.notes),
        }


def describe(recording: Recording) -> Description:
    """Return rates, gaps, unit checks and truth of a recording, and how it was read if it is another app's."""
    from pdr_filter.io.report import KEY, reading_report  # which describes streams with this module

    truth = recording.truth
    said = reading_report(recording).about() if KEY in recording.meta else ()
    return Description(
        name=recording.name,
        source=recording.source,
        duration_s=recording.duration_s,
        streams=tuple(describe_stream(name, samples) for name, samples in recording.streams.items()),
        height_m=recording.subject.height_m,
        placement=str(recording.meta["placement"]) if recording.meta.get("placement") else None,
        units=_unit_sentences(recording),
        truth_rows={name: len(getattr(truth, name)) for name in truth.present()},
        notes=(*said, *recording.notes),
    )


def describe_stream(name: str, samples: Samples) -> StreamDescription:
    """Return rates, gaps and oddities of one stream; times may repeat and go back, but not be NaN."""
    time_s = samples.time_s
    interval_s = np.diff(time_s)
    forward_s = interval_s[interval_s > 0]
    median_s = float(np.median(forward_s)) if len(forward_s) else np.inf
    gaps_s = forward_s[forward_s > max(GAP_S, GAP_INTERVALS * median_s)]
    span_s = float(time_s.max() - time_s.min()) if len(time_s) else 0.0
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
        n_missing_rows=int(np.isnan(samples.values).any(axis=1).sum()),
    )


def median_norm(values: FloatArray) -> float:
    """Median Euclidean norm of the complete rows of values (N, d), in their unit; NaN if no row is complete."""
    complete = values[~np.isnan(values).any(axis=1)]
    if len(complete) == 0:
        return float("nan")
    with np.errstate(over="ignore"):  # the square of an absurd value may be infinite; the median does not mind
        return float(np.median(np.sqrt(np.square(complete).sum(axis=1))))


def _unit_sentences(recording: Recording) -> tuple[str, ...]:
    sentences: list[str] = []
    for name, quantity, unit, low, high in PLAUSIBLE:
        samples = recording.streams.get(name)
        median = median_norm(samples.values) if samples else float("nan")
        if not np.isnan(median):
            verdict = "plausible" if low <= median <= high else f"not plausible, expected {low:g} to {high:g}"
            sentences.append(f"{name}: median {quantity} {median:.4g} {unit}".rstrip() + f", {verdict}")
    return tuple(sentences)
