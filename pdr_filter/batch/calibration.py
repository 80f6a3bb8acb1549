"""Calibration with many recordings, each reduced to its segments where it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from pdr_filter import recording_run
from pdr_filter.batch.workers import Failure, each
from pdr_filter.io.folders import recordings_of
from pdr_filter.io.formats import read

if TYPE_CHECKING:
    from pdr_filter.calibration import Calibration
    from pdr_filter.offline.calibration.priors import StepLengthPrior
    from pdr_filter.offline.calibration.segments import Segment


def calibrate(
    paths: str | Path | Iterable[str | Path],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    progress: Callable[[float], None] | None = None,
    file_format: str | None = None,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
    loss: str = "gnc",
) -> Calibration:
    """What `pdr_filter.calibrate` finds from all recordings, each reduced to its segments where it is read.

    Only the steps between known places travel, no samples; then all segments are solved for at once. They are taken in
    the order of the paths, so the result has the same bits wherever the work was done. Recordings that cannot be used
    are left out, with their reason in the notes. `priors`, `anchor_std_m`, `measure` and `loss` are as in
    `pdr_filter.calibrate`, `paths`, `jobs`, `scheduler` and `file_format` as in `track`; `progress` is called with the
    fraction of recordings done. ValueError if an option cannot be used, or nothing determines the parameters.
    """
    from pdr_filter.offline.calibration.fit import calibrate_segments

    if measure not in ("displacement", "length"):  # otherwise the reason of every recording
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    files = recordings_of(paths)
    reduce = partial(reduced, file_format=file_format, anchor_std_m=anchor_std_m, measure=measure)
    found: dict[int, tuple[list[Segment], list[str]]] = {}
    for i, result in each(reduce, files, jobs=jobs, scheduler=scheduler):
        found[i] = ([], [f"{files[i]}: left out: {result.reason}"]) if isinstance(result, Failure) else result
        if progress is not None:
            progress(len(found) / len(files))
    segments = [segment for i in range(len(files)) for segment in found[i][0]]
    notes = [note for i in range(len(files)) for note in found[i][1]]
    if not segments:
        raise ValueError("nothing to calibrate with: " + ("; ".join(notes) or "no recordings"))
    return calibrate_segments(segments, priors, loss=loss, notes=notes)


def reduced(
    path: str, file_format: str | None, anchor_std_m: float | None, measure: str
) -> tuple[list[Segment], list[str]]:
    """Segments of known length of one recording, and notes: what a calibration needs of it."""
    from pdr_filter.offline.calibration.segments import segments_of

    recording = read(path, file_format)
    segments, notes = segments_of(recording, recording_run.track(recording), anchor_std_m, measure)
    if segments and not recording.subject.id:
        notes.append(f"{recording.name}: no subject id, so a person of its own")
    return segments, notes
