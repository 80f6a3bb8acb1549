"""Track of a file that is read, filtered and written in parts, so that the memory does not depend on its length."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO

from pdr_filter.data.io.files.track_writers import PiecesWriter, write_by_suffix
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.parts import RecordingPart, WholeOnlyError, recording_in_parts
from pdr_filter.filter.pedestrian.person import Person
from pdr_filter.recipes.calibration import Calibration
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.stream_merging import SENSORS, StreamMerger, absences
from pdr_filter.tracking import whole_recording as recording_run
from pdr_filter.tracking.filtering import (
    Output,
    State,
    add_fixes,
    add_location,
    add_pressure,
    finish_filter,
    init_filter,
    update_filter,
)
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import check_sensors
from pdr_filter.values import Fix, Note
from pdr_filter.values.georeference import Georeference, GnssUse
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import whole_file


@dataclass(frozen=True, slots=True, eq=False)
class WrittenTrack:
    """Track whose rows were written to a file.

    Attributes
    ----------
    path : Path
        File with one row for each step.
    n_steps : int
        Number of steps.
    distance_m : float
        Walked distance, m.
    about : Track
        Track without rows, with start, duration, frame, origin, device, person and notes.

    Examples
    --------
    >>> import tempfile, pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = pdr.batch.track_file(walk.save(f"{folder}/walk.zip"), f"{folder}/track.csv")
    >>> written.n_steps > 20
    True
    """

    path: Path
    n_steps: int
    distance_m: float
    about: Track


def track_file(
    path: str | Path,
    out: str | Path,
    config: Config | Callable[[Recording], Config] | None = None,
    *,
    weighting: str | None = None,
    fixes: Iterable[Fix] = (),
    calibration: Calibration | str | Path | None = None,
    device: Device | str | Path | None = None,
    person: Person | Calibration | str | Path | None = None,
    gnss: GnssUse | None = None,
    file_format: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> WrittenTrack:
    """Track a recording of any length, which is read, filtered and written in parts.

    The file has the rows that `Track.to_csv` or `Track.to_parquet` writes for the result of `pdr_filter.track`. The
    memory does not depend on the length, for files of the own format, tables as text, and files of RoNIN. The rows then
    lack the steps and headings that the phone computed itself. Other formats, and files whose times go back by 0.1 s or
    more, are read as a whole.

    Parameters
    ----------
    path : str or Path
        File or folder of a recording.
    out : str or Path
        File to write, whose suffix is .csv or .parquet. It appears when it is complete.
    config : Config or callable, optional
        Configuration, as returned by a recipe, or a function that returns it for the first samples of the recording.
        The default is the default recipe.
    weighting, fixes, calibration, device, person, gnss : optional
        Arguments of `pdr_filter.track`.
    file_format : str, optional
        Format of the file. By default it is detected from its content.
    progress : callable, optional
        Function that is called with the fraction of the file done, 0 to 1.

    Returns
    -------
    WrittenTrack
        Number of steps, distance, and the track without rows.

    Raises
    ------
    ValueError
        If an argument is invalid, or if the file cannot be read.
    MissingSensorError
        If the recording lacks a sensor that the recipe or an argument requires.

    Notes
    -----
    Notes that count samples of the whole file, such as those on repeated times, count those of its first minutes.

    Examples
    --------
    >>> import tempfile, pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = walk.save(f"{folder}/walk.zip")
    ...     written = pdr.batch.track_file(path, f"{folder}/parts.csv")
    ...     whole = pdr.track(pdr.read(path)).to_csv(f"{folder}/whole.csv")
    ...     written.path.read_bytes() == whole.read_bytes()
    True
    """
    path, out = Path(path), Path(out)
    if out.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"out must be a file with the suffix .csv or .parquet, got {out}: change its name")
    given = tuple(fixes)

    def config_of(recording: Recording) -> Config | None:
        return config(recording) if callable(config) else config

    def run_of(recording: Recording) -> recording_run.Run:
        georeference = Georeference(gnss)
        return recording_run.prepared_run(
            recording, config_of(recording), given, georeference, weighting, calibration, device, person
        )

    try:
        if gnss == "align":
            raise WholeOnlyError("the alignment uses all locations")
        with recording_in_parts(path, file_format) as opened, whole_file(out) as file:
            run = run_of(opened.head)
            check_sensors(run.recording, run.config)
            settings = replace(run.config, keeps_path=False)
            with tempfile.TemporaryFile() as waiting:
                rows = _WrittenRows(PiecesWriter(out, file), waiting)
                results = _outputs(run, settings, opened.parts, progress)
                absent = partial(_absences, opened.spans_s)
                about = recording_run.track_of_outputs(run.recording, settings, results, None, rows, absent)
                about = run.with_given_origin(about)
                rows.writer.close(about)
            return WrittenTrack(out, rows.n_steps, rows.distance_m, about)
    except WholeOnlyError:
        recording = read(path, file_format)
        track = recording_run.track(
            recording,
            config_of(recording),
            weighting=weighting,
            fixes=given,
            progress=progress,
            calibration=calibration,
            device=device,
            person=person,
            gnss=gnss,
        )
        write_by_suffix(track, out, None)
        return WrittenTrack(out, track.n_steps, track.distance_m, recording_run.without_rows(track))


def _outputs(
    run: recording_run.Run, config: Config, parts: Iterator[RecordingPart], progress: Callable[[float], None] | None
) -> Iterator[tuple[State, Output]]:
    """Yield the state of the filter and its output for each part of a recording, and at its end."""
    state = add_fixes(config, init_filter(config), run.fixes)
    for part in parts:
        if (pressure := part.others.get("barometer")) is not None:
            state = add_pressure(config, state, pressure.time_s, pressure.values[:, 0])
        if run.with_location and (location := part.others.get("location")) is not None:
            state = add_location(config, state, location)
        state, output = update_filter(config, state, part.block)
        yield state, output
        if progress is not None:
            progress(part.fraction)
    yield finish_filter(config, state)


def _absences(spans_s: Mapping[str, tuple[float, float]]) -> list[Note]:
    return absences({sensor: spans_s[sensor] for sensor in SENSORS if sensor in spans_s}, StreamMerger().wait_s)


class _WrittenRows(recording_run.RowStore):
    """Rows of a track that are written at once, or wait in a temporary file if a later fix can move them."""

    def __init__(self, writer: PiecesWriter, waiting: IO[bytes]) -> None:
        super().__init__()
        self.writer, self.n_steps, self.distance_m = writer, 0, 0.0
        self._waiting = waiting

    def add(self, piece: Track) -> None:
        """Write rows."""
        self.writer.write(piece)
        self.n_steps += piece.n_steps
        self.distance_m = piece.distance_m if piece.n_steps else self.distance_m
        self.pieces[:] = [recording_run.without_rows(piece)]

    def wait(self, output: Output) -> None:
        """Keep an output in the temporary file. The file is of this process only, so that unpickling it is safe."""
        pickle.dump(output, self._waiting)

    def outputs(self) -> Iterator[Output]:
        """Yield the outputs that wait."""
        self._waiting.seek(0)
        with suppress(EOFError):
            while True:
                yield pickle.load(self._waiting)
