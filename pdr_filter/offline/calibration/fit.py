"""Step-length parameters of people from walks of known length, with covariance: `calibrate`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import date
from typing import Any

import numpy as np

from pdr_filter.calibration import Calibration, slices_of
from pdr_filter.config import Config
from pdr_filter.filter.step_length import StepLengthModel
from pdr_filter.io.recording import Recording
from pdr_filter.offline.calibration.estimation import Hierarchy, ParameterEstimate, estimate_parameters
from pdr_filter.offline.calibration.hierarchy import SingularError
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, candidates
from pdr_filter.offline.calibration.segments import Segment, SegmentSums, integrate, segments_of
from pdr_filter.offline.robust import DISTRUST
from pdr_filter.recording_run import track as track_of
from pdr_filter.tracks import Track
from pdr_filter.values import CONTEXTS, FloatArray, Table, table
from pdr_filter.version import __version__

# One person's scale differs by so much between walks: 2.3 % over nine walks of one (docs/methods/step_length.md).
RECORDING_STD = 0.025


def calibrate(
    recordings: Recording | Iterable[Recording],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    tracks: Iterable[Track] | None = None,
    config: Config | None = None,
    measure: str = "displacement",
    loss: str = "gnc",
    anchor_std_m: float | None = None,
    recording_std: float = RECORDING_STD,
    progress: Callable[[float], None] | None = None,
) -> Calibration:
    """Step-length parameters from walks between places whose distance is known.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        With truth segments of known distance, strides, waypoints, or GNSS fixes. `subject.id` says whose they are; one
        without is a person of its own.
    priors : mapping, optional
        Model and prior of contexts, in place of those of `DEFAULT_PRIORS`; `eq12_priors()` has Martinelli's for all.
    tracks : iterable of Track, optional
        Tracks of the recordings, if they are there already.
    config : Config, optional
        Finds steps, headings and contexts; the default recipe if not given.
    measure : {"displacement", "length"}
        Fit summed step vectors to distances, or summed step lengths (docs/methods/calibration.md has why not).
    loss : {"gnc", "cauchy", "huber", "none"}
        How little segments count that do not fit.
    anchor_std_m : float, optional
        Standard deviation of the known distances; if not given 0.35 m for segments, 0.9 m for waypoints.
    recording_std : float
        How much one person's scale differs between recordings, at the start; 0 for not at all.
    progress : callable, optional
        Called with the fraction of recordings done.

    Raises
    ------
    ValueError
        Nothing to calibrate with, or parameters that nothing determines; it says which and what to do.
    """
    chosen = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if not chosen:
        raise ValueError("no recordings: give at least one")
    known = list(tracks) if tracks is not None else [None] * len(chosen)
    if len(known) != len(chosen):
        raise ValueError(f"{len(known)} tracks for {len(chosen)} recordings: give one for each")
    segments: list[Segment] = []
    notes: list[str] = []
    nameless = 0
    for done, (recording, own) in enumerate(zip(chosen, known, strict=True), 1):
        own = own if own is not None else track_of(recording, config)
        found, remarks = segments_of(recording, own, anchor_std_m, measure)
        nameless += bool(found) and not recording.subject.id
        segments += found
        notes += remarks
        if progress is not None:
            progress(done / len(chosen))
    if not segments:
        raise ValueError("nothing to calibrate with: " + "; ".join(notes))
    if nameless:
        what = "1 recording has" if nameless == 1 else f"{nameless} recordings have"
        notes.append(f"{what} no subject id: each is a person of its own")
    return calibrate_segments(segments, priors, loss=loss, recording_std=recording_std, notes=notes)


def calibrate_segments(
    segments: Sequence[Segment],
    priors: Mapping[str, StepLengthPrior] | None = None,
    *,
    loss: str = "gnc",
    recording_std: float = RECORDING_STD,
    notes: Sequence[str] = (),
) -> Calibration:
    """`calibrate` for segments that are already cut out (`segments_of`)."""
    full = {**DEFAULT_PRIORS, **(priors or {})}
    if unknown := set(full) - set(CONTEXTS):
        raise ValueError(f"no context {', '.join(sorted(unknown))}; there are {', '.join(CONTEXTS)}")
    if not segments:
        raise ValueError("no segments: give at least one stretch of known length with steps in it")
    for segment in segments:
        if not segment.distance_m > 0:
            raise ValueError(f"{segment.name}: distance_m must be positive, got {segment.distance_m:g}")
        if not float(segment.inside.sum()) > 0:
            raise ValueError(f"{segment.name}: no steps in it; leave it out")
    order = [c for c in CONTEXTS if c in full]
    models = {name: full[name].model for name in order}
    slices, _ = slices_of(models)
    start = {name: full[name].mean for name in order}
    sums = integrate(segments, models, start)
    linear = all(hasattr(model, "regressors") for model in models.values())

    def relinearise(theta: FloatArray) -> SegmentSums:
        about = [{name: theta[s][part] for name, part in slices.items()} for s in sums.subject]
        return integrate(segments, models, about)

    hierarchy = hierarchy_of({name: full[name] for name in order}, recording_std)
    found = solve_sums(sums, hierarchy, models, loss, None if linear else relinearise)
    return _assemble(segments, sums, found, models, full, notes)


def compare_models(
    segments: Sequence[Segment],
    models: Mapping[str, Mapping[str, StepLengthPrior]] | None = None,
    *,
    loss: str = "gnc",
    recording_std: float = RECORDING_STD,
) -> dict[str, Calibration]:
    """A calibration for each candidate model, the one that predicts segments left out best first.

    By the RMS of the relative error of segments that none distrusts. For other people `stranger_m` may tell otherwise.
    """
    found = {
        name: calibrate_segments(segments, priors, loss=loss, recording_std=recording_std)
        for name, priors in (candidates() if models is None else models).items()
    }
    good = ~np.any([c.segments.distrusted for c in found.values()], axis=0)
    if not good.any():
        good[:] = True

    def error(calibration: Calibration) -> float:
        rows = calibration.segments[good]
        return float(np.square(rows["left_out_m"] / rows["distance_m"] - 1).mean())

    return dict(sorted(found.items(), key=lambda item: error(item[1])))


def hierarchy_of(priors: Mapping[str, StepLengthPrior], recording_std: float = RECORDING_STD) -> Hierarchy:
    """The priors of all contexts, one after the other."""
    step_std_m = np.full(len(CONTEXTS), 0.08)
    for name, prior in priors.items():
        step_std_m[CONTEXTS.index(name)] = prior.step_std_m
    mean, std, between = (
        np.concatenate([getattr(p, name) for p in priors.values()]) for name in ("mean", "std", "between_std")
    )
    return Hierarchy(mean, std, between, step_std_m, recording_std)


def solve_sums(
    sums: SegmentSums,
    hierarchy: Hierarchy,
    models: Mapping[str, StepLengthModel],
    loss: str = "gnc",
    relinearise: Callable[[FloatArray], SegmentSums] | None = None,
) -> ParameterEstimate:
    """`estimate_parameters`, with names of the parameters in its error messages."""
    try:
        return estimate_parameters(sums, hierarchy, loss, relinearise)
    except SingularError as error:
        names = [f"{name} k{i}" for name, model in models.items() for i in range(model.n_params)]
        free = np.flatnonzero((hierarchy.std > 0) | (hierarchy.between_std > 0))
        which = ", ".join(names[free[i]] for i in error.indices) or "all parameters"
        raise ValueError(
            f"the segments do not determine {which} (no steps of the context, or all at one speed): give these "
            "parameters a prior (std less than inf), hold them (std 0), or add segments at other speeds"
        ) from error


def _assemble(
    segments: Sequence[Segment],
    sums: SegmentSums,
    found: ParameterEstimate,
    models: Mapping[str, StepLengthModel],
    priors: Mapping[str, StepLengthPrior],
    notes: Sequence[str],
) -> Calibration:
    rows = _table(segments, sums, found, np.concatenate([priors[name].mean for name in models]))
    heights = {s.subject: s.height_m for s in segments}
    return Calibration(
        models=dict(models),
        theta=found.population,
        theta_cov=found.population_cov,
        between_cov=found.between_cov,
        people=found.people,
        people_cov=found.people_cov,
        subject_ids=sums.subjects,
        heights_m=np.array([np.nan if (h := heights[name]) is None else h for name in sums.subjects]),
        residual_std_m={
            name: float(priors[name].step_std_m * np.sqrt(found.noise_factor[CONTEXTS.index(name)])) for name in models
        },
        recording_std=found.recording_std,
        n_segments=_shares(segments, models),
        segments=rows,
        notes=(*notes, *_notes(rows, found, models)),
        card={
            "date": date.today().isoformat(),
            "pdr_filter": __version__,
            "people": len(sums.subjects),
            "recordings": len(sums.recordings),
            "segments": len(segments),
            "metres": round(float(sums.distance_m.sum()), 1),
        },
    )


def _table(segments: Sequence[Segment], sums: SegmentSums, found: ParameterEstimate, start: FloatArray) -> Table:
    """The table `Calibration.segments`; `start` are the parameters before the calibration (P,)."""
    vector = sums.regressors @ start + sums.offset_m
    return table(
        {
            "subject": np.array([s.subject for s in segments]),
            "recording": np.array([s.recording for s in segments]),
            "context": np.array([CONTEXTS[c] for c in sums.context]),
            "start_s": np.array([s.start_s for s in segments]),
            "end_s": np.array([s.end_s for s in segments]),
            "distance_m": sums.distance_m,
            "n_steps": sums.n_steps,
            "summed": np.array([s.heading_rad is None for s in segments]),
            "predicted_m": found.predicted_m,
            "left_out_m": found.left_out_m,
            "stranger_m": found.stranger_m,
            "uncalibrated_m": np.hypot(vector[:, 0], vector[:, 1]),
            "misfit": found.misfit,
            "weight": found.weight,
            "distrusted": np.abs(found.misfit) > DISTRUST,
        }
    )


def _shares(segments: Sequence[Segment], names: Iterable[str]) -> dict[str, float]:
    """How many segments each context had, in shares of their steps."""
    share = np.zeros(len(CONTEXTS))
    for segment in segments:
        weight = segment.inside @ segment.context_prob
        share += weight / max(float(weight.sum()), 1e-9)
    return {name: float(share[CONTEXTS.index(name)]) for name in names}


def _notes(rows: Any, found: ParameterEstimate, models: Mapping[str, StepLengthModel]) -> list[str]:
    notes: list[str] = []
    if not found.converged:
        notes.append(f"the variances still changed after {found.n_iterations} iterations")
    doubtful = rows[rows.distrusted]
    for r in doubtful[np.argsort(-np.abs(doubtful.misfit))]:
        notes.append(
            f"distrusted: {r.recording} {r.start_s:.1f}-{r.end_s:.1f} s: {r.distance_m:.2f} m given, "
            f"{r.predicted_m:.2f} m walked by its steps, {abs(r.misfit):.1f} standard deviations, weight {r.weight:.2f}"
        )
    without = [c for c in models if c != "stationary" and c not in set(rows.context.tolist())]
    if without:
        notes.append(f"no segments of {', '.join(without)}: the filter keeps the lengths that it had")
    return notes
