"""Calibration with many recordings, each reduced to its segments where it is read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING

from pdr_filter.batch.workers import Failure, each
from pdr_filter.io.files.safe_files import whole_file
from pdr_filter.io.folders import recordings_of
from pdr_filter.io.formats import known_format, read
from pdr_filter.offline.calibration.segments import AnySegment, SummedSegment, segments_of
from pdr_filter.offline.robust_loss import LOSSES
from pdr_filter.tracking import whole_recording as recording_run
from pdr_filter.values.serialisation import from_bytes, to_bytes
from pdr_filter.version import __version__

if TYPE_CHECKING:
    from pdr_filter.filter.step_length.models import StepLengthModel
    from pdr_filter.offline.calibration.priors import StepLengthPrior
    from pdr_filter.recipes.step_length_calibration import Calibration


@dataclass(frozen=True, slots=True, eq=False)
class Reduced:
    """All that a calibration needs of one recording."""

    segments: tuple[AnySegment, ...]
    notes: tuple[str, ...]
    is_nameless: bool = False  # it has segments and does not say whose they are


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
    """What `pdr_filter.calibrate` finds from all recordings, each reduced to its segments where it is read.

    No samples travel. For models that are linear in their parameters, as all by default, not even steps do, but their
    sums for each segment. Then all segments are solved for at once, in the order of the paths, so the result has the
    same bits wherever the work was done. Recordings that cannot be used are left out, with their reason in the notes.
    Tracks are those of the default recipe: for other contexts or parts give `pdr_filter.calibrate` their config.

    Parameters
    ----------
    paths, jobs, scheduler, file_format
        As in `track`.
    priors, model, prior_std, subject, each_a_person, anchor_std_m, measure, loss
        As in `pdr_filter.calibrate`.
    resume : path, optional
        Folder that keeps what each recording was reduced to as soon as it is. Started again with the same folder and
        options, after a kill too, recordings that are in it are not read again.
    progress : callable, optional
        Called with the fraction of recordings done.

    Raises
    ------
    ValueError
        If an option cannot be used, or nothing determines the parameters.
    """
    from pdr_filter.offline.calibration.fit import calibrate_segments, check_subject, without_name
    from pdr_filter.offline.calibration.model_forms import forms_of

    if measure not in ("displacement", "length"):  # otherwise the reason of every recording
        raise ValueError(f'measure must be "displacement" or "length", got {measure!r}')
    if loss not in LOSSES:
        raise ValueError(f"loss must be one of {', '.join(LOSSES)}, got {loss!r}")
    if anchor_std_m is not None and not 0 <= anchor_std_m < inf:
        raise ValueError(f"anchor_std_m must be 0 or more, got {anchor_std_m}")
    if file_format:
        known_format(file_format)
    check_subject(subject, each_a_person)
    files = recordings_of(paths)
    every = {pair: None for form in forms_of(priors, model, prior_std).values() for pair in models_in(form)}
    sums = tuple(every) if all(hasattr(m, "regressors") for _, m in every) else None
    reduce = partial(
        reduced,
        models=sums,
        subject=subject,
        each_a_person=each_a_person,
        file_format=file_format,
        anchor_std_m=anchor_std_m,
        measure=measure,
    )
    kept = None if resume is None else _Kept(Path(resume), repr(sorted(reduce.keywords.items())))
    found: dict[int, Reduced] = {} if kept is None else kept.all_of(files)
    todo = [i for i in range(len(files)) if i not in found]
    for k, result in each(reduce, [files[i] for i in todo], jobs=jobs, scheduler=scheduler):
        i = todo[k]
        if isinstance(result, Failure):
            result = Reduced((), (f"{files[i]}: left out: {result.reason}",))
        elif kept is not None:
            kept.keep(files[i], result)
        found[i] = result
        if progress is not None:
            progress(len(found) / len(files))
    in_order = [found[i] for i in range(len(files))]
    segments = [segment for one in in_order for segment in one.segments]
    notes = [note for one in in_order for note in one.notes]
    if not segments:
        raise ValueError("nothing to calibrate with: " + ("; ".join(notes) or "no recordings"))
    whose = without_name(sum(one.is_nameless for one in in_order), subject, each_a_person)
    return calibrate_segments(segments, priors, model=model, prior_std=prior_std, loss=loss, notes=(*whose, *notes))


def models_in(priors: Mapping[str, StepLengthPrior]) -> list[tuple[str, StepLengthModel]]:
    """Contexts with their models."""
    return [(context, prior.model) for context, prior in priors.items()]


def reduced(
    path: str,
    models: tuple[tuple[str, StepLengthModel], ...] | None,
    subject: str | None = None,
    each_a_person: bool = False,
    file_format: str | None = None,
    anchor_std_m: float | None = None,
    measure: str = "displacement",
) -> Reduced:
    """Segments of known length of one recording: their sums for these models, or with None their steps."""
    recording = read(path, file_format)
    name = recording.name if each_a_person else subject
    segments, notes = segments_of(recording, recording_run.track(recording, gnss="off"), anchor_std_m, measure, name)
    small = segments if models is None else [SummedSegment.of(segment, models) for segment in segments]
    return Reduced(tuple(small), tuple(notes), bool(segments) and not recording.subject.id)


@dataclass(frozen=True, slots=True)
class _Kept:
    """A folder with a file for each recording that was reduced with these options."""

    folder: Path
    options: str

    def all_of(self, files: list[str]) -> dict[int, Reduced]:
        """What is there, by the number of the file; what cannot be read is done again."""
        found: dict[int, Reduced] = {}
        for i, file in enumerate(files):
            try:
                value = from_bytes(self._path(file).read_bytes())
            except (OSError, ValueError):
                continue
            if isinstance(value, Reduced):
                found[i] = value
        return found

    def keep(self, file: str, result: Reduced) -> None:
        """Write it whole or not at all."""
        with whole_file(self._path(file)) as kept:
            kept.write(to_bytes(result))

    def _path(self, file: str) -> Path:
        """Another recording under the same path is taken for the same one."""
        key = "\n".join((file, self.options, __version__))
        return self.folder / f"{hashlib.sha256(key.encode('utf-8', 'surrogateescape')).hexdigest()[:24]}.segments"
