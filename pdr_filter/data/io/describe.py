"""Description of a recording (rates, gaps, repeated times, units, truth) and of its reading (source, signs, clock)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.column_names import PHONE_HEADING, PHONE_STEPS
from pdr_filter.values import FloatArray, Samples, as_plain, how_many, limits
from pdr_filter.values.recording import READING_KEY, Recording

# A stream is reported as slow if its mean rate is below this fraction of the requested rate. Phones often deliver half.
DELIVERED_ENOUGH = 0.9

STREAM_UNITS = {
    "accelerometer": "m/s2",
    "gyroscope": "rad/s",
    "magnetometer": "uT",
    "barometer": "hPa",
    "light": "lux",
    "proximity": "cm",
    "attitude": "quaternion wxyz",
    "location": "deg, m",
    PHONE_HEADING: "rad",
    PHONE_STEPS: "steps",
}

# Stream, quantity, unit, and range of its median in a recording with correct units.
PLAUSIBLE = (
    ("accelerometer", "|specific force|", "m/s2", limits.SPECIFIC_FORCE_RANGE_MPS2),
    ("gyroscope", "|angular rate|", "rad/s", (0.0, limits.MAX_MEDIAN_ANGULAR_RATE_RADPS)),
    ("magnetometer", "|magnetic field|", "uT", limits.MAGNETIC_FIELD_RANGE_UT),
    ("barometer", "pressure", "hPa", limits.PRESSURE_RANGE_HPA),
    ("attitude", "|quaternion|", "", limits.QUATERNION_NORM_RANGE),
)


@dataclass(frozen=True, slots=True)
class StreamDescription:
    """Statistics of one sensor stream. Values are None if there are too few samples."""

    name: str
    unit: str
    n_samples: int
    rate_hz: float | None  # delivered rate, 1 / median positive interval
    mean_rate_hz: float | None  # number of intervals / duration, which includes gaps and fits rounded timestamps
    first_s: float | None  # of the samples with a value
    last_s: float | None
    n_gaps: int  # number of intervals longer than 0.3 s and 2.5 median intervals
    longest_gap_s: float  # longest of these intervals in s, or zero
    n_duplicates: int  # number of times equal to the previous time
    n_backward: int  # number of times before the previous time
    n_missing_rows: int  # number of rows with a missing value in a column that is not completely empty
    requested_hz: float | None = None  # rate in Hz that the app requested, None if unknown

    @property
    def is_slow(self) -> bool:
        """Whether the mean delivered rate is below 90 % of the requested rate. False if one of them is unknown."""
        delivered_hz, asked_hz = self.mean_rate_hz, self.requested_hz
        return delivered_hz is not None and asked_hz is not None and delivered_hz < DELIVERED_ENOUGH * asked_hz

    def sentence(self) -> str:
        """Return a summary of the stream in one line."""
        rate = "rate unknown" if self.mean_rate_hz is None else f"{self.mean_rate_hz:.1f} Hz delivered"
        if self.requested_hz is not None and self.mean_rate_hz is not None:
            rate += f", {self.requested_hz:.1f} Hz requested"
            if self.is_slow:
                rate += f" ({100 * self.mean_rate_hz / self.requested_hz:.0f} %)"
        gaps = how_many(self.n_gaps, "gap") + (f" (longest {self.longest_gap_s:.2f} s)" if self.n_gaps else "")
        return f"{self.name}: {rate}, {gaps}, {self.n_duplicates} repeated and {self.n_backward} backward times"


@dataclass(frozen=True, slots=True)
class Description:
    """Contents of a recording as plain values; see `describe`.

    Attributes
    ----------
    name, source : str
        Name of the recording, and the file or app that it comes from.
    duration_s : float
        Duration in s.
    streams : tuple of StreamDescription
        Statistics of each sensor stream.
    height_m : float or None
        Height of the person in m, on which step lengths depend, as the recording states.
    placement : str or None
        Placement of the phone, as the recording states.
    units : tuple of str
        A sentence about the plausibility of the unit of each stream.
    truth_rows : dict of str to int
        Number of rows of each truth table.
    notes : tuple of str
        Findings of the reader: source, signs, units, clock, repairs and unusual data.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.data.io.describe import describe
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> describe(walk).streams[0].unit
    'm/s2'
    """

    name: str
    source: str
    duration_s: float
    streams: tuple[StreamDescription, ...]
    height_m: float | None
    placement: str | None
    units: tuple[str, ...]
    truth_rows: dict[str, int]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the description as plain dictionaries and lists for JSON.

        Returns
        -------
        dict
            Fields of the description.
        """
        return as_plain(self)


@dataclass(frozen=True, slots=True)
class ReadingReport:
    """Report about the reading of a recording; see `reading_report`.

    Attributes
    ----------
    source : str
        App or format, with version and platform if the file states them.
    found : tuple of str
        A sentence for each decision about signs and units.
    clock : str
        Clock of the timestamps, and its zero.
    streams : tuple of StreamDescription
        Statistics of each sensor stream.
    notes : tuple of str
        Repairs, and data that were not used.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.data.io.describe import reading_report
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> reading_report(walk).clock
    'seconds from the first accelerometer sample'
    """

    source: str
    found: tuple[str, ...]
    clock: str
    streams: tuple[StreamDescription, ...]
    notes: tuple[str, ...]

    def lines(self) -> tuple[str, ...]:
        """Return the complete report as lines of text.

        Returns
        -------
        tuple of str
            Lines of `about`, a line for each stream, and the notes.
        """
        return (*self.about(), *(stream.sentence() for stream in self.streams), *self.notes)

    def about(self) -> tuple[str, ...]:
        """Return source, signs, units, clock and slow streams as lines of text.

        Returns
        -------
        tuple of str
            Lines of text.
        """
        slow = [
            f"{stream.name}: {stream.requested_hz:.1f} Hz requested, {stream.mean_rate_hz:.1f} Hz delivered"
            for stream in self.streams
            if stream.is_slow
        ]
        return (f"read as {self.source}", *self.found, f"clock: {self.clock}", *slow)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain dictionaries and lists for JSON.

        Returns
        -------
        dict
            Fields of the report.
        """
        return as_plain(self)


def describe(recording: Recording) -> Description:
    """Describe a recording: rates, gaps, plausibility of units, ground truth, and findings of the reader.

    Parameters
    ----------
    recording : Recording
        Recording to describe.

    Returns
    -------
    Description
        Contents of the recording. `pdr-filter info` prints them.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.data.io.describe import describe
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> [stream.name for stream in describe(walk).streams]
    ['accelerometer', 'gyroscope', 'magnetometer']
    """
    from pdr_filter.sensing.stream_merging import absences_in  # imported late: the live server does not load the filter

    report = reading_report(recording)
    return Description(
        name=recording.name,
        source=recording.source,
        duration_s=_without_clock_jumps(recording).duration_s,
        streams=report.streams,
        height_m=recording.subject.height_m,
        placement=recording.placement or None,
        units=_unit_sentences(recording),
        truth_rows={name: len(getattr(recording.truth, name)) for name in recording.truth.present()},
        notes=(
            *(report.about() if READING_KEY in recording.meta else ()),
            *recording.notes,
            *(note.text for note in absences_in(recording.streams)),
            *_sensor_notes(recording),
        ),
    )


def reading_report(recording: Recording) -> ReadingReport:
    """Return the report about the reading of a recording: source, signs, units, clock and rates.

    Parameters
    ----------
    recording : Recording
        Recording, such as from `pdr_filter.read`.

    Returns
    -------
    ReadingReport
        Report of the reader. A recording without one is described as in the project's own format.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.data.io.describe import reading_report
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> reading_report(walk).lines()[0]
    'read as own format'
    """
    continuous = _without_clock_jumps(recording)
    reading = dict_of(recording.meta.get(READING_KEY))
    requested = dict_of(reading.get("requested_hz")) or {"accelerometer": recording.meta.get("nominal_rate_hz")}
    found: Any = reading.get("found")
    sentences = cast("list[Any]", found) if isinstance(found, list) else ["SI units, specific force +9.81 on z face up"]
    most = limits.MAX_TEXT_CHARS
    return ReadingReport(
        source=str(reading.get("source") or "own format")[:most],
        found=(
            *(str(sentence)[:most] for sentence in sentences[: limits.MAX_SENTENCES]),
            *_phone_sentences(recording),
        ),
        clock=str(reading.get("clock") or "seconds from the first accelerometer sample")[:most],
        streams=tuple(
            describe_stream(key, samples, requested.get(key), _span_s(continuous.streams[key].time_s))
            for key, samples in recording.streams.items()
        ),
        notes=recording.notes,
    )


def _phone_sentences(recording: Recording) -> tuple[str, ...]:
    """Return sentences about the steps and the heading that the phone computed itself."""
    sentences: list[str] = []
    if recording.phone_steps is not None:
        sentences.append(f"steps counted by the phone: {recording.phone_steps}")
    heading = recording.phone_heading
    heading_deg = np.degrees(np.empty(0) if heading is None else heading.values[:, 0]) % 360
    heading_deg = heading_deg[np.isfinite(heading_deg)]
    if len(heading_deg):
        start_deg, end_deg = heading_deg[0], heading_deg[-1]
        sentences.append(f"heading by the phone: {start_deg:.0f} degrees at the start, {end_deg:.0f} at the end")
    return tuple(sentences)


def _without_clock_jumps(recording: Recording) -> Recording:
    from pdr_filter.sensing.clock import one_clock  # imported late: the live server does not load the filter

    return one_clock(recording)[0]


def _span_s(time_s: FloatArray) -> float:
    return float(time_s.max() - time_s.min()) if len(time_s) else 0.0


def describe_stream(
    name: str, samples: Samples, requested_hz: Any = None, duration_s: float | None = None
) -> StreamDescription:
    """Return rates, gaps, and counts of repeated and backward times of one stream, whose times must not be NaN.

    An invalid `requested_hz` counts as unknown. `duration_s` is the duration without backward clock jumps, if known.
    """
    time_s = samples.time_s
    interval_s = np.diff(time_s)
    forward_s = interval_s[interval_s > 0]
    median_s = float(np.median(forward_s)) if len(forward_s) else np.inf
    gaps_s = forward_s[forward_s > max(limits.GAP_S, limits.GAP_INTERVALS * median_s)]
    duration_s = _span_s(time_s) if duration_s is None else duration_s
    is_empty = np.isnan(samples.values)
    known_s = time_s[~is_empty.all(axis=1)] if is_empty.any() else time_s
    is_rate = isinstance(requested_hz, int | float) and not isinstance(requested_hz, bool) and 0 < requested_hz < 1e6
    return StreamDescription(
        name=name,
        unit=STREAM_UNITS.get(name, ""),
        n_samples=len(samples),
        rate_hz=1 / median_s if len(forward_s) else None,
        mean_rate_hz=(len(time_s) - 1) / duration_s if duration_s > 0 else None,
        first_s=float(known_s.min()) if len(known_s) else None,
        last_s=float(known_s.max()) if len(known_s) else None,
        n_gaps=len(gaps_s),
        longest_gap_s=float(gaps_s.max(initial=0.0)),
        n_duplicates=int((interval_s == 0).sum()),
        n_backward=int((interval_s < 0).sum()),
        n_missing_rows=int(is_empty[:, ~is_empty.all(axis=0)].any(axis=1).sum()),
        requested_hz=float(requested_hz) if is_rate else None,
    )


def median_norm(values: FloatArray) -> float:
    """Median Euclidean norm of the complete rows of values (N, d), in their unit; NaN if no row is complete."""
    with np.errstate(over="ignore"):  # squares of absurd values may be infinite, which does not affect the median
        squares = np.einsum("ij,ij->i", values, values)  # NaN for incomplete rows
    squares = squares[~np.isnan(squares)]
    return float(np.median(np.sqrt(squares))) if len(squares) else float("nan")


def _sensor_notes(recording: Recording) -> list[str]:
    """Return warnings about stuck and coarse sensors, as those of a track."""
    # imported late: the live server does not load the filter
    from pdr_filter.sensing.conditioning import Conditioner, merge_streams
    from pdr_filter.sensing.features.barometer import ClimbRate

    found: list[str] = []
    with suppress(ValueError):  # times of another clock, which `absences_in` names, or an absurd unit
        conditioner = Conditioner()
        state, _ = conditioner.update(conditioner.init(), merge_streams(recording))
        found += state.report.sensor_notes()
    if recording.barometer is not None:
        with suppress(ValueError):  # pressures in Pa, which `_unit_sentences` names
            stage = ClimbRate()
            climbs, _ = stage.update(stage.init(), recording.barometer.time_s, recording.barometer.values[:, 0])
            found += [climbs.note] if climbs.note else []
    return found


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


def dict_of(value: Any) -> dict[str, Any]:
    """Return the value if it is a dict, else an empty one: untrusted files may hold anything."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else {}
