"""What a reader found: the source, signs and units, the rates asked for and delivered, the clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, cast

from pdr_filter.io.describe import StreamDescription, describe_stream
from pdr_filter.io.recording import Recording

# A stream whose mean rate is below this part of the one that was asked for is named: phones often deliver half.
DELIVERED_ENOUGH = 0.9
KEY = "reading"  # in `Recording.meta`
MAX_SENTENCES = 50  # of a report that came with a file


@dataclass(frozen=True, slots=True)
class StreamReading:
    """Rate of one stream: asked for and delivered, and what disturbs it."""

    name: str
    n_samples: int
    requested_hz: float | None  # None where the app does not say
    delivered_hz: float | None  # mean over the recording, so gaps count
    n_gaps: int
    longest_gap_s: float
    n_duplicates: int
    n_backward: int

    @property
    def is_slow(self) -> bool:
        """Whether clearly less was delivered than requested."""
        if self.requested_hz is None or self.delivered_hz is None:
            return False
        return self.delivered_hz < DELIVERED_ENOUGH * self.requested_hz

    def sentence(self) -> str:
        """One line for people."""
        rate = "rate unknown" if self.delivered_hz is None else f"{self.delivered_hz:.1f} Hz delivered"
        if self.requested_hz is not None and self.delivered_hz is not None:
            rate += f", {self.requested_hz:.1f} Hz requested"
            if self.is_slow:
                rate += f" ({100 * self.delivered_hz / self.requested_hz:.0f} %)"
        gaps = f"{self.n_gaps} gaps" + (f" (longest {self.longest_gap_s:.2f} s)" if self.n_gaps else "")
        return f"{self.name}: {rate}, {gaps}, {self.n_duplicates} repeated and {self.n_backward} backward times"


@dataclass(frozen=True, slots=True)
class ReadingReport:
    """How a recording was read, in words and numbers."""

    source: str  # app or format, with version and platform as far as the file says
    found: tuple[str, ...]  # signs and units, one sentence for each decision
    clock: str  # where time zero lies, and whose clock it is
    streams: tuple[StreamReading, ...]
    notes: tuple[str, ...]  # what was repaired or left out

    def lines(self) -> tuple[str, ...]:
        """The report as lines of text."""
        return (*self.about(), *(stream.sentence() for stream in self.streams), *self.notes)

    def about(self) -> tuple[str, ...]:
        """The lines that the streams themselves do not show: source, signs and units, clock, rates not delivered."""
        slow = [
            f"{stream.name}: {stream.requested_hz:.1f} Hz requested, {stream.delivered_hz:.1f} Hz delivered"
            for stream in self.streams
            if stream.is_slow and stream.requested_hz is not None and stream.delivered_hz is not None
        ]
        return (f"read as {self.source}", *self.found, f"clock: {self.clock}", *slow)

    def as_dict(self) -> dict[str, Any]:
        """Plain dicts and lists that json can write."""
        return asdict(self) | {
            "found": list(self.found),
            "streams": [asdict(stream) for stream in self.streams],
            "notes": list(self.notes),
        }


def reading_meta(
    source: str, found: list[str], clock: str, requested_hz: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """What a reader leaves in `Recording.meta["reading"]`; plain, so that it survives being written."""
    return {"source": source, "found": found, "clock": clock, "requested_hz": dict(requested_hz or {})}


def reading_report(recording: Recording) -> ReadingReport:
    """Return the report of a recording as it was read; of the project's own format if it says nothing else."""
    value: Any = recording.meta.get(KEY)
    said = cast("dict[str, Any]", value) if isinstance(value, dict) else {}
    asked: Any = said.get("requested_hz")
    requested = cast("dict[str, Any]", asked) if isinstance(asked, dict) else {}
    nominal: Any = recording.meta.get("nominal_rate_hz")
    if not requested and _is_rate(nominal):
        requested = {"accelerometer": nominal}
    found: Any = said.get("found")
    sentences = cast("list[Any]", found) if isinstance(found, list) else ["SI units, specific force +9.81 on z face up"]
    return ReadingReport(
        source=str(said.get("source") or "own format")[:500],
        found=tuple(str(sentence)[:500] for sentence in sentences[:MAX_SENTENCES]),
        clock=str(said.get("clock") or "seconds from the first accelerometer sample")[:500],
        streams=tuple(
            _stream(describe_stream(name, samples), requested.get(name)) for name, samples in recording.streams.items()
        ),
        notes=recording.notes,
    )


def _stream(found: StreamDescription, requested_hz: Any) -> StreamReading:
    return StreamReading(
        name=found.name,
        n_samples=found.n_samples,
        requested_hz=float(requested_hz) if _is_rate(requested_hz) else None,
        delivered_hz=found.mean_rate_hz,
        n_gaps=found.n_gaps,
        longest_gap_s=found.longest_gap_s,
        n_duplicates=found.n_duplicates,
        n_backward=found.n_backward,
    )


def _is_rate(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < 1e6
