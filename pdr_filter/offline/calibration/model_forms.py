"""Which form of step length: every one calibrated without some of the people or recordings, and scored on these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pdr_filter.filter.step_length.models import RECORDING_STD, StepLengthModel
from pdr_filter.offline.calibration.estimation import Hierarchy, ParameterEstimate, estimate_parameters
from pdr_filter.offline.calibration.hierarchy import SingularError
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, as_wide_as, candidates
from pdr_filter.offline.calibration.segments import AnySegment, SegmentSums, integrate
from pdr_filter.offline.robust_loss import DISTRUST
from pdr_filter.recipes.step_length_calibration import slices_of
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray

# Fewer segments, people or recordings do not choose a form. From so many on the chosen one is no worse than the default
# on the totals of walks left out of the choice, but for 0.2 points at one of five sites (docs/benchmarks.md).
MIN_SEGMENTS, MIN_GROUPS = 30, 5
_MAX_SEGMENTS = 2000  # about so many choose it in a large cohort: more would only take longer
_N_FOLDS = 5
# Share by which the held-out error of a form must be smaller than that of the default.
_CLEARLY = 0.05

Priors = Mapping[str, StepLengthPrior]


def forms_of(
    priors: Priors | None = None,
    model: str | None = None,
    prior_std: float | None = None,
    contexts: tuple[str, ...] = CONTEXTS,
    walking: str = "walking",
) -> dict[str, dict[str, StepLengthPrior]]:
    """Priors of all contexts for each form that walking may have, by name, in the order of `contexts`.

    One form if `priors` has the context of walking or a `model` is named; else all of `candidates`.
    """
    given, known = dict(priors or {}), {name: {walking: of["walking"]} for name, of in candidates().items()}
    if unknown := set(given) - set(contexts):
        raise ValueError(
            f"priors are of no context {', '.join(sorted(unknown))}; there are {', '.join(contexts)}: contexts of "
            "yours need pdr_filter.calibrate(recordings, config=config)"
        )
    if model is not None and walking in given:
        raise ValueError(f"priors has a model of walking, and model is {model!r}: leave out one of them")
    if model is not None and model not in known:
        raise ValueError(f"model must be one of {', '.join(known)}, got {model!r}")
    if prior_std is not None and not 0 < prior_std <= 1:
        raise ValueError(
            f"prior_std (--prior) must be a share of a step, above 0 and up to 1, got {prior_std}; 0.1 is usual"
        )
    chosen = {"given": given} if walking in given else known if model is None else {model: known[model]}
    forms: dict[str, dict[str, StepLengthPrior]] = {}
    for name, own in chosen.items():
        full = {**DEFAULT_PRIORS, **given, **own}
        if prior_std is not None:
            full[walking] = as_wide_as(full[walking], prior_std)
        forms[name] = {c: full[c] for c in contexts if c in full}
    return forms


def models_of(priors: Priors) -> dict[str, StepLengthModel]:
    """The step-length model of each context."""
    return {name: p.model for name, p in priors.items()}


def start_of(priors: Priors) -> dict[str, FloatArray]:
    """The parameters of each context before a calibration."""
    return {name: p.mean for name, p in priors.items()}


def hierarchy_of(
    priors: Priors, recording_std: float = RECORDING_STD, contexts: tuple[str, ...] = CONTEXTS
) -> Hierarchy:
    """The priors of all contexts, one after the other."""
    step_std_m = np.full(len(contexts), 0.08)
    for name, prior in priors.items():
        step_std_m[contexts.index(name)] = prior.step_std_m
    mean, std, between = (
        np.concatenate([getattr(p, name) for p in priors.values()]) for name in ("mean", "std", "between_std")
    )
    return Hierarchy(mean, std, between, step_std_m, recording_std)


def solved(
    segments: Sequence[AnySegment], sums: SegmentSums, priors: Priors, loss: str, recording_std: float
) -> ParameterEstimate:
    """`estimate_parameters` for segments and their sums; it names the parameters in its error messages."""
    models = models_of(priors)
    slices, _ = slices_of(models)

    def relinearise(theta: FloatArray) -> SegmentSums:
        about = [{name: theta[s][part] for name, part in slices.items()} for s in sums.subject]
        return integrate(segments, models, about)

    linear = all(hasattr(model, "regressors") for model in models.values())
    prior = hierarchy_of(priors, recording_std, segments[0].context_names)
    return solve_sums(sums, prior, models, loss, None if linear else relinearise)


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


def left_out_errors(
    segments: Sequence[AnySegment], forms: Mapping[str, Priors], loss: str = "gnc", recording_std: float = RECORDING_STD
) -> tuple[dict[str, FloatArray], BoolArray]:
    """Relative errors (N,) of each form on segments it has not seen, and which of them no form distrusts (N,).

    Left out are whole people, or whole recordings if there are fewer than five people: a fifth of them at a time.
    """
    errors: dict[str, FloatArray] = {}
    good = np.ones(len(segments), dtype=bool)
    for name, priors in forms.items():
        sums = integrate(segments, models_of(priors), start_of(priors))
        fold = _groups(sums) % _N_FOLDS
        predicted = np.empty(len(sums))
        for k in np.unique(fold):
            training = fold != k
            seen = [segments[i] for i in np.flatnonzero(training).tolist()]
            found = solved(seen, sums.rows(training), priors, loss, recording_std)
            predicted[~training] = lengths(sums.rows(~training), found.people)
        errors[name] = predicted / sums.distance_m - 1
        good &= np.abs(solved(segments, sums, priors, loss, recording_std).misfit) <= DISTRUST
    return errors, good


def lengths(sums: SegmentSums, people: FloatArray) -> FloatArray:
    """Predicted lengths (N,) with the parameters of all people (S, P), for models that are linear in them."""
    vector = np.einsum("ndp,np->nd", sums.regressors, people[sums.subject]) + sums.offset_m
    return np.hypot(vector[:, 0], vector[:, 1])


def best_form(
    segments: Sequence[AnySegment], forms: Mapping[str, Priors], loss: str, recording_std: float
) -> tuple[str, list[str]]:
    """Name of the form with a clearly smaller held-out error than the first, else of the first, and a note about it.

    Clearly smaller: by `_CLEARLY` of the error, and by two standard errors of the paired difference of squares.
    """
    first = next(iter(forms))
    walked = [s for s in segments if s.context_names[int(np.argmax(s.steps_in))] == "walking"]
    groups = _groups_of([s.subject for s in walked], [s.recording for s in walked])
    n_groups = len(set(groups.tolist()))
    if len(forms) < 2 or len(walked) < MIN_SEGMENTS or n_groups < MIN_GROUPS:
        return first, []
    every = min(-(-len(walked) // _MAX_SEGMENTS), n_groups // MIN_GROUPS)
    some = [s for s, g in zip(walked, groups.tolist(), strict=True) if g % every == 0]
    errors, good = left_out_errors(some, forms, loss, recording_std)
    rms = {name: 100 * float(np.sqrt(np.square(e[good]).mean())) for name, e in errors.items()}
    best = min(rms, key=lambda name: rms[name])
    gained = (np.square(errors[first]) - np.square(errors[best]))[good]
    std = standard_error(gained, _groups_of([s.subject for s in some], [s.recording for s in some])[good])
    is_clear = rms[best] <= (1.0 - _CLEARLY) * rms[first] and float(gained.mean()) >= 2.0 * std
    best, which = (best, f"clearly better than {first}") if is_clear else (first, "no other form is clearly better")
    others = ", ".join(f"{name} {value:.1f} %" for name, value in rms.items() if name != best)
    kind = "people" if n_groups == len({s.subject for s in walked}) else "recordings"
    n_left_out = len(range(0, n_groups, every))
    return best, [
        f"step lengths of walking by {best} ({len(forms)} forms for the ways of carrying the phone here, {which}): "
        f"{rms[best]:.1f} % off on {kind} left out in turn ({good.sum()} segments, {n_left_out} {kind}); {others}"
    ]


def standard_error(values: FloatArray, group: NDArray[Any]) -> float:
    """Standard error of the mean of values (N,) that are alike within groups; inf for less than two groups.

    sqrt(G / (G - 1) sum_g (sum_i (x_i - mean))^2) / N, the sums over the values of each group.
    """
    number = np.unique(group, return_inverse=True)[1]
    sums = np.bincount(number, values - values.mean())
    n_groups = len(sums)
    return float(np.sqrt(n_groups / (n_groups - 1) * (sums**2).sum()) / len(values)) if n_groups > 1 else np.inf


def _groups(sums: SegmentSums) -> IntArray:
    return _groups_of(sums.subject.tolist(), sums.recording.tolist())


def _groups_of(subject: Sequence[object], recording: Sequence[object]) -> IntArray:
    """Number of the group of each segment, in order of appearance: people, or recordings of fewer than five people."""
    names = subject if len(set(subject)) >= MIN_GROUPS else recording
    order = {name: i for i, name in enumerate(dict.fromkeys(names))}
    return np.array([order[name] for name in names], dtype=np.int64)
