"""Calibration of step lengths with many recordings, which several processes read.

A segment is a part of a recording with a known distance, and its steps. The process that reads a recording returns only
the segments, so that the samples are never copied between processes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from pdr_filter.apps.batch.workers import Failure, each
from pdr_filter.data.io.folders import absolute_recordings_of, notes_on_people, with_person_of_file
from pdr_filter.data.io.formats import known_format, read
from pdr_filter.offline.calibration.segments import Segment, segments_of, with_distinct_names
from pdr_filter.offline.robust_loss import LOSSES
from pdr_filter.tracking import whole_recording as recording_run
from pdr_filter.values.safe_files import whole_file
from pdr_filter.values.serialisation import from_bytes, to_bytes
from pdr_filter.version import __version__

if TYPE_CHECKING:
    from pdr_filter.offline.calibration.priors import StepLengthPrior
    from pdr_filter.recipes.calibration import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """Segments of known length of one recording, for the calibration of step lengths."""

    segments: tuple[Segment, ...]  # parts of the recording with a known distance, and their steps
    notes: tuple[str, ...]  # reasons why the recording, or a part of it, was not used
    is_nameless: bool = False  # the recording has segments but does not name its person


def calibrate(
    paths: str | Path | Iterable[str | Path],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    jobs: int = 1,
    scheduler: str | None = None,
    resume: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
    file_format: str | None = None,
    model: str | None = None,
    prior_std: float | None = None,
    subject: str | None = None,
    each_a_person: bool = False,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
    loss: str = "gnc",
) -> Calibration:
    """Calibrate step lengths on many recordings, in parallel.

    The result equals the result of `pdr_filter.calibrate` with all recordings. Each recording is reduced to its
    segments of known length in the process that reads it. Recordings that cannot be used are skipped, with the reason
    in the notes. The tracks are computed with the default recipe. For other contexts or parts, use
    `pdr_filter.calibrate` with `config`.

    Parameters
    ----------
    paths : str, Path or iterable of these
        Recordings, or folders of recordings.
    priors : mapping of str to StepLengthPrior, optional
        Step-length model and prior of each context. The default is `DEFAULT_PRIORS`.
    jobs : int, default 1
        Number of processes on this machine, or -1 for the number of cores.
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://host:8786", instead of `jobs`. Its workers must see the same files
        under the same paths and have the same version of this package.
    resume : str or Path, optional
        Folder for the reduced recordings. If an interrupted calibration is started again with the same folder and
        options, recordings in the folder are not read again.
    progress : callable, optional
        Function that is called with the fraction of recordings done, 0 to 1.
    file_format : str, optional
        Format of the files. By default it is detected from their content.
    model : str, optional
        Step-length model of walking. By default, the model with the smallest error on held-out segments is selected.
    prior_std : float, optional
        Relative standard deviation of the prior of walking. The default for "bounce" is 0.1.
    subject : str, optional
        Name of the person of recordings that do not name their person. The default is "unnamed".
    each_a_person : bool, default False
        Whether each recording that does not name its person is of another person.
    anchor_std_m : float, optional
        Standard deviation of the waypoints or fixes at the ends of segments, in m.
    measure : {"displacement", "length"}, default "displacement"
        Whether summed step vectors or summed step lengths are fitted to the known distances.
    loss : {"gnc", "cauchy", "huber", "none"}, default "gnc"
        Robust loss against wrong segments.

    Returns
    -------
    Calibration
        Step-length parameters of the population and of each person.

    Raises
    ------
    ValueError
        If an option is invalid, or if the recordings do not determine the parameters.

    See Also
    --------
    pdr_filter.calibrate : Calibrate on recordings in memory.

    Notes
    -----
    Processes exchange no samples, but the steps of the segments. All segments are then solved together in the order of
    the paths, so that the result is bit-identical for any number of processes.

    Examples
    --------
    >>> import tempfile
    >>> import pdr_filter as pdr
    >>> legs = [pdr.simulate.Leg("walking", distance_m=d, turn_rad=1.57) for d in (30.0, 20.0)]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pdr.simulate.simulate(legs).save(f"{folder}/walk.zip")
    ...     pdr.batch.calibrate([path], model="tian")
    Calibration(walking; 1 people, 2 segments)
    """
    from pdr_filter.offline.calibration.fit import calibrate_segments, check_subject, without_name
    from pdr_filter.offline.calibration.model_forms import forms_of

    # options are checked here, because in the workers they would fail for every recording
    if measure not in ("displacement", "length"):
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    if anchor_std_m is not None and not 0 <= anchor_std_m < inf:
        raise ValueError(f"anchor_std_m must be 0 or more and finite, got {anchor_std_m}")
    if file_format:
        known_format(file_format)
    check_subject(subject, each_a_person)
    files = absolute_recordings_of(paths)
    forms_of(priors, model, prior_std)  # an unknown model fails here, before any file is read
    reduce = partial(
        read_segments,
        subject=subject,
        each_a_person=each_a_person,
        file_format=file_format,
        anchor_std_m=anchor_std_m,
        measure=measure,
    )
    kept = None if resume is None else _Kept(Path(resume), repr(sorted(reduce.keywords.items())))
    known = {} if kept is None else {i: kept.get(file) for i, file in enumerate(files)}
    found = {i: value for i, value in known.items() if value is not None}
    todo = [i for i in range(len(files)) if i not in found]
    for k, result in each(reduce, [files[i] for i in todo], jobs=jobs, scheduler=scheduler):
        i = todo[k]
        if isinstance(result, Failure):
            result = Reduced((), (f"{files[i]}: skipped: {result.reason}",))
        elif kept is not None:
            kept.keep(files[i], result)
        found[i] = result
        if progress is not None:
            progress(len(found) / len(files))
    in_order = [found[i] for i in range(len(files))]
    segments = with_distinct_names((one.segments, each_a_person and one.is_nameless) for one in in_order)
    notes = list(dict.fromkeys(note for one in in_order for note in one.notes))
    if not segments:
        raise ValueError("no usable segments to calibrate with: " + ("; ".join(notes) or "no recordings"))
    name_notes = without_name(sum(one.is_nameless for one in in_order), subject, each_a_person)
    return calibrate_segments(
        segments, priors, model=model, prior_std=prior_std, loss=loss, notes=(*name_notes, *notes)
    )


def read_segments(
    path: str,
    subject: str | None = None,
    each_a_person: bool = False,
    file_format: str | None = None,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
) -> Reduced:
    """Read a recording and return its segments of known length."""
    recording = read(path, file_format)
    if subject is None and not each_a_person:
        recording = with_person_of_file(recording, path)
    name = recording.name if each_a_person else subject
    segments, notes = segments_of(recording, recording_run.track(recording, gnss="off"), anchor_std_m, measure, name)
    notes = (*notes, *notes_on_people([recording]))
    return Reduced(tuple(segments), notes, bool(segments) and not recording.subject.id)


@dataclass(frozen=True, slots=True)
class _Kept:
    """Folder of reduced recordings, with a file for each recording and set of options."""

    folder: Path
    options: str

    def get(self, file: str) -> Reduced | None:
        """Return the reduced recording of a file, or None if it is missing or unreadable."""
        with suppress(OSError, ValueError):
            if isinstance(value := from_bytes(self._path(file).read_bytes()), Reduced):
                return value
        return None

    def keep(self, file: str, result: Reduced) -> None:
        """Write a reduced recording atomically."""
        with whole_file(self._path(file)) as kept:
            kept.write(to_bytes(result))

    def _path(self, file: str) -> Path:
        """Return the path for a recording. It depends on its path, not on its content."""
        key = "\n".join((file, self.options, __version__))
        return self.folder / f"{hashlib.sha256(key.encode('utf-8', 'surrogateescape')).hexdigest()[:24]}.segments"
