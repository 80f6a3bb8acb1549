"""Fitting of context models on labelled recordings with any people and labels.

The shipped models use the same protocol (`cross_validation`), with data sets and options of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.familiarity import unknown_share
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.offline.training.classifier_choice import machine_fit_of
from pdr_filter.offline.training.context_sequences import UNKNOWN, LabelledProbabilities
from pdr_filter.offline.training.cross_validation import (
    HeldOut,
    LabelledWindows,
    TextArray,
    TrainingPlan,
    calibrated_prob,
    cross_calibrated,
    in_window_order,
    label_row,
    score,
    temperature_and_slip,
    train_one,
    with_familiarity,
    worst_person_accuracy,
)
from pdr_filter.offline.training.transition_training import (
    MAX_PARTS,
    EvidenceEstimate,
    LabelledSequences,
    contexts_at,
    estimate_evidence,
    stretches,
)
from pdr_filter.recipes import default
from pdr_filter.sensing.conditioning import merge_streams
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindow, FeatureWindows
from pdr_filter.sensing.front_end import feature_windows
from pdr_filter.values import (
    CARRYING_MODES,
    DEFAULT_CONTEXTS,
    BoolArray,
    Context,
    FeatureFunction,
    FeatureSet,
    FloatArray,
    IntArray,
    Table,
    feature_set_of,
    how_many,
)
from pdr_filter.values.recording import Recording

Head = Literal["context", "carrying_mode"]

# Shipped models whose features an own model uses by default, without a suffix for phones without a gyroscope.
_SHIPPED: dict[Head, str] = {"context": "context", "carrying_mode": "carrying"}
UNNAMED = "unnamed"  # person of recordings without a subject id
# Places in the format of recordings (docs/conventions.md) for which the filter has no carrying mode.
_OTHER_PLACES = ("waist", "foot", "chest")
# Smallest number of windows for parallel folds. With fewer, all folds finish before the worker processes have started.
_WINDOWS_FOR_PARALLEL = 5000
_WINDOWS_SHARE, _STEPS_SHARE = 0.4, 0.2  # shares of the progress; the folds take the rest


def fit_contexts(
    recordings: Recording | Iterable[Recording],
    classifier: object = "rvm",
    features: FeatureSet | FeatureFunction | None = None,
    *,
    head: Head = "context",
    people: Sequence[str] | None = None,
    name: str = "",
    progress: Callable[[float], None] | None = None,
) -> ContextModel:
    """Fit a context model on labelled recordings, with calibrated probabilities.

    A window of 2 s is used if it lies inside one label. Each person is held out in turn, or a tenth of the people if
    there are more than ten. The predictions for held-out people calibrate the probabilities, and give the scores of
    `ContextModel.report` and of the card. If all recordings are of one person, recordings are held out instead, and the
    report says that nothing is known about other people.

    If any window has an angular rate, windows without one are not used. If the labels have at least 10 changes of
    context between two steps, the transition matrix is estimated too. With at least 4 people, the exponents of the
    evidence are estimated as well, if this lowers the log loss of held-out people. `Config.with_contexts` uses both.

    Parameters
    ----------
    recordings : Recording or iterable of Recording
        Recordings with `truth.labels` (columns start_s, end_s, context, carrying_mode). Any names are allowed, and an
        empty name means unknown. `subject.id` of the metadata names the person. All recordings without one are
        attributed to one person.
    classifier : {"rvm", "forest", "blend", "boosted"} or object
        Relevance vector machine (default), random forest, the mean of relevance vector machines and extremely
        randomised trees (as in the default recipe), or the mean of logistic regression and boosted trees. Or an
        object with `fit(X, y)`, `predict_proba(X)` and `classes_`, such as a scikit-learn classifier. It receives
        standardised features.
    features : FeatureSet or callable, optional
        Features of a window. A function receives the signals of a window by name (`values.WINDOW_SIGNALS`, arrays (N,))
        and returns a dict of numbers. The default is the feature set of the default recipe.
    head : {"context", "carrying_mode"}
        Column of the labels to be learnt, "context" by default. Carrying modes must have the names in `CARRYING_MODES`.
        Windows with the context "stationary", or with the phone at the waist, foot or chest, are not used for them.
    people : sequence of str, optional
        Name of the person of each recording, in place of `subject.id`.
    name : str, optional
        Name of the model and its files. The default is "contexts" or "carrying".
    progress : callable, optional
        Called with the fraction done, 0 to 1.

    Returns
    -------
    ContextModel
        Model fitted on all people, with calibration, `Familiarity` and card.

    Raises
    ------
    ValueError
        If there are no labels, labels of a single class, a single recording, or invalid arguments. The message names
        the problem and the remedy.

    See Also
    --------
    pdr_filter.Config.with_contexts : Configuration that uses a fitted model.

    References
    ----------
    M. E. Tipping, "Sparse Bayesian learning and the relevance vector machine", J. Machine Learning Research 1, 2001.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.simulate import Gait, Leg, simulate
    >>> legs = [Leg(c, duration_s=12.0) for c in ("stationary", "walking", "running")]
    >>> walks = [simulate(legs, Gait.random(seed), "pocket", seed=seed) for seed in range(3)]
    >>> model = pdr.fit_contexts(walks, classifier="forest", people=["anna", "ben", "carla"])
    >>> model.contexts
    ('running', 'stationary', 'walking')
    >>> print(model.report().splitlines()[1])
    96 windows of 3 people: running 30, stationary 33, walking 33
    """
    if head not in ("context", "carrying_mode"):
        raise ValueError(f'head must be "context" or "carrying_mode", got {head!r}: name a column of the labels')
    machine_fit, kind = machine_fit_of(classifier)
    feature_set = ATTITUDE_FREE if features is None else feature_set_of(features)
    done: Callable[[float], None] = progress or (lambda _: None)
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    for each in given:
        if not isinstance(each, Recording):  # pyright: ignore[reportUnnecessaryIsInstance]
            raise ValueError(f"recordings must contain Recording objects, got {each!r}: read files with pdr.read")
    if people is not None and len(people) != len(given):
        raise ValueError(
            f"people must have {len(given)} names, one for each recording, got {len(people)}: name the person of each"
        )
    labelled = _labelled(given, feature_set, head, people, done)
    windows = labelled.windows
    elsewhere = np.isin(windows.carrying_mode, _OTHER_PLACES) & (head == "carrying_mode")
    others = np.unique(windows.carrying_mode[elsewhere])
    windows = replace(windows, carrying_mode=np.where(elsewhere, "", windows.carrying_mode))
    labels = _labels_of(windows, head)
    unit, what = _held_out_units(windows, labelled.sequence, head)
    _check_units(windows.label(head), unit, what)
    names = feature_set.names
    if features is None:
        names = load_model(f"{_SHIPPED[head]}{'' if labelled.has_gyroscope else '_accelerometer'}").feature_names
    columns = [feature_set.names.index(each) for each in names]
    sequences = None if head != "context" else _step_labels(given, labelled, labels, done)
    once = [c for c in labels if len(np.unique(unit[windows.label(head) == c])) == 1]
    limits = [f"Labelled for one {what} only, and not in the scores: {', '.join(once)}."] if once else []
    limits += [f"Not learnt, because the filter has no such carrying mode: {', '.join(others)}."] if len(others) else []
    plan = FittingPlan(
        name=name or ("contexts" if head == "context" else "carrying"),
        head=head,
        feature_set=feature_set.name,
        feature_names=names,
        machine_fit=machine_fit,
        description=f"{kind} on {how_many(len(names), 'feature')} ({feature_set.name})",
        use="Windows like those of the recordings that the model learnt from.",
        limits=" ".join(limits),
        has_gyroscope=labelled.has_gyroscope,
        own_labels=labels,
        command=f"pdr_filter.fit_contexts(recordings, {classifier!r}, head={head!r})",
        n_recordings=len(given),
        step_labels=sequences,
        at_middle=labelled.at_middle,
        sequence=labelled.sequence,
        unit=unit,
        held_out_unit=what,
    )
    start = _WINDOWS_SHARE + _STEPS_SHARE
    model = train_one(
        plan,
        replace(windows, features=windows.features[:, columns]),
        lambda _, fraction: done(start + (1 - start) * fraction),
        n_jobs=1 if len(windows.person) < _WINDOWS_FOR_PARALLEL else -1,
    )
    return model if features is None else replace(model, features=feature_set)


@dataclass(frozen=True, eq=False)
class _Labelled:
    """Windows of all recordings in order, including those outside every label, with empty strings as labels."""

    windows: LabelledWindows
    at_middle: TextArray  # (W,) context at the middle of each window, or an empty string outside every label
    sequence: TextArray  # (W,) recording and stretch without gaps, such as "3/0"
    has_gyroscope: bool  # True if all windows have an angular rate, False if none has one


def _labelled(
    recordings: Sequence[Recording],
    features: FeatureSet,
    head: Head,
    people: Sequence[str] | None,
    progress: Callable[[float], None],
) -> _Labelled:
    """Return the windows of the recordings, with labels only for those inside one label.

    If any window has an angular rate, windows without one are left out. For carrying modes, windows of "stationary"
    have no label. Raise ValueError if no window has a label of the kind `head` ("context" or "carrying_mode"), or a
    feature is not finite.
    """
    stage = FeatureWindows(features=features)
    rows: list[tuple[Any, ...]] = []
    names = [None] * len(recordings) if people is None else people
    for number, (recording, person) in enumerate(zip(recordings, names, strict=True)):
        dataset = str(recording.meta.get("dataset") or "own recordings")
        own = f"{dataset}/{recording.subject.id or UNNAMED}" if person is None else str(person)
        labels, end_s, stretch = recording.truth.labels, -np.inf, -1
        for window in feature_windows(stage, [merge_streams(recording)]):
            _check_finite(window, recording)
            stretch += window.time_s > end_s + 1.5 * stage.hop_s
            end_s, middle_s = window.time_s, 0.5 * (window.start_s + window.time_s)
            context, mode = (_name_in(labels, c, window.start_s, window.time_s) for c in ("context", "carrying_mode"))
            if head == "carrying_mode" and context == "stationary":
                mode = ""
            of_window = window.features, context, mode, own, dataset, recording.name, window.has_gyroscope
            rows.append((*of_window, _name_in(labels, "context", middle_s, middle_s), f"{number}/{stretch}"))
        progress(_WINDOWS_SHARE * (number + 1) / len(recordings))
    arrays = [np.array(column) for column in zip(*rows, strict=True)]
    if not arrays or not (arrays[2 if head == "carrying_mode" else 1] != "").any():
        what = "context" if head == "context" else "carrying mode of moving people"
        raise ValueError(
            f"recordings must have labels of the {what}, got {how_many(len(recordings), 'recording')} with "
            f"{len(rows)} windows of 2 s, none of them inside such a label: give truth.labels, or truth_labels.csv in "
            "their folders"
        )
    with_gyroscope = arrays[6]
    has_gyroscope = bool(with_gyroscope.any())
    *own, at_middle, sequence = (array[with_gyroscope == has_gyroscope] for array in arrays)
    return _Labelled(LabelledWindows(*own), at_middle, sequence, has_gyroscope)


def _check_finite(window: FeatureWindow, recording: Recording) -> None:
    """Raise ValueError with the name of the first feature of a window that is not finite."""
    bad = [name for name, value in zip(window.names, window.features.tolist(), strict=True) if not np.isfinite(value)]
    if bad:
        raise ValueError(
            f"features must be finite, but {bad[0]} is NaN or infinite in {recording.name!r} at {window.time_s:.1f} s: "
            "return a finite number for every window"
        )


def _name_in(labels: Table | None, column: str, start_s: float, end_s: float) -> str:
    """Return the name of the label that contains a time interval.

    The name is empty outside every label, and if the labels lack this column.
    """
    if labels is None or column not in (labels.dtype.names or ()):
        return ""
    row = label_row(labels, column, start_s, end_s)
    return "" if row is None else str(labels[column][row])


def _labels_of(windows: LabelledWindows, head: Head) -> tuple[str, ...]:
    """Return the labels of the model in order: contexts of the windows, or all `CARRYING_MODES`.

    Raise ValueError if the windows have fewer than two classes, or unknown carrying modes.
    """
    found = tuple(str(c) for c in np.unique(windows.label(head)) if c)
    what = head.replace("_", " ")
    if len(found) < 2:
        raise ValueError(
            f"labels of the recordings must have at least two {what}s, got {', '.join(map(repr, found)) or 'none'}: "
            "add recordings of another class"
        )
    if head == "context":
        return found
    if unknown := sorted(set(found) - set(CARRYING_MODES)):
        raise ValueError(
            f"carrying modes must be among {CARRYING_MODES}, got {unknown}: rename them in the labels, or leave their "
            "names empty to train without these windows"
        )
    return CARRYING_MODES


def _held_out_units(windows: LabelledWindows, sequence: TextArray, head: Head) -> tuple[TextArray, str]:
    """Return the held-out unit of each window (W,), and its kind: "person", or "recording" for one person alone.

    `sequence` (W,) has the number of the recording of each window before a slash.
    """
    if len(np.unique(windows.person[windows.label(head) != ""])) > 1:
        return windows.person, "person"
    numbers = [int(s.partition("/")[0]) + 1 for s in sequence]
    names = [f"{name} (recording {number})" for name, number in zip(windows.recording, numbers, strict=True)]
    return np.array(names), "recording"


def _check_units(label: TextArray, unit: TextArray, what: str) -> None:
    """Raise ValueError unless there are two people or recordings, and two classes remain without each in turn.

    `label` (W,) is the class of each window, empty if unknown. `unit` (W,) and `what` are from `_held_out_units`.
    """
    units, others = np.unique(unit[label != ""]), {"person": "people"}.get(what, "recordings")
    if len(units) < 2:
        raise ValueError(
            "recordings must be of at least two people, or at least two of one person, because each is held out in "
            f"turn, got one with labels, {str(units[0])!r}: add a recording, best of another person and with each class"
        )
    for name in units:
        left = np.unique(label[(label != "") & (unit != name)])
        if len(left) < 2:
            raise ValueError(
                f"{str(name)!r} cannot be held out, because the other {others} have only windows of {str(left[0])!r}: "
                f"label each class for at least two {others}"
            )


@dataclass(frozen=True, eq=False)
class _StepLabels:
    """True contexts of the detected steps, for recordings in which the context changes."""

    label: IntArray  # (K,) index into the labels, `UNKNOWN` outside every label
    person: TextArray  # (K,) person of each step
    sequence: TextArray  # (K,) recording and stretch without gaps of each step, such as "3/0"
    recordings: tuple[int, ...]  # indices of the recordings in which the context changes


def _step_labels(
    recordings: Sequence[Recording], labelled: _Labelled, labels: tuple[str, ...], progress: Callable[[float], None]
) -> _StepLabels:
    """Return the true contexts of all steps that the default recipe detects in recordings with changes of context.

    Recordings with a single context are skipped.
    """
    rows: list[tuple[int, str, str]] = []
    numbers = np.array([int(s.partition("/")[0]) for s in labelled.sequence])
    used: list[int] = []
    for number, recording in enumerate(recordings):
        own = np.flatnonzero(numbers == number)
        if len(own) and len(set(labelled.windows.context[own]) - {""}) > 1:
            used.append(number)
            person = str(labelled.windows.person[own[0]])
            for stretch, (steps, _) in enumerate(stretches(default(recording.subject).sensing, recording)):
                of_step = contexts_at(recording, np.array([step.time_s for step in steps]), labels)
                rows += [(int(label), person, f"{number}/{stretch}") for label in of_step]
        progress(_WINDOWS_SHARE + _STEPS_SHARE * (number + 1) / len(recordings))
    label, person, sequence = (np.array([row[i] for row in rows]) for i in range(3))
    return _StepLabels(label.astype(np.int64), person.astype(np.str_), sequence.astype(np.str_), tuple(used))


@dataclass(frozen=True, kw_only=True)
class FittingPlan(TrainingPlan):
    """Plan of a model fitted on recordings of any data."""

    own_labels: tuple[str, ...]  # labels of the recordings
    n_recordings: int  # number of recordings
    step_labels: _StepLabels | None  # contexts of the steps, or None if no transitions are estimated
    at_middle: TextArray  # (W,) context at the middle of each window
    sequence: TextArray  # (W,) recording and stretch of each window
    unit: TextArray  # (W,) person of each window, or its recording if all are of one person
    held_out_unit: str  # "person" or "recording": the kind of `unit`

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the recordings."""
        return self.own_labels

    def training_windows(self, windows: LabelledWindows) -> LabelledWindows:
        """Return the windows that have a label of the kind that the model learns (context or carrying mode)."""
        return windows.part(windows.label(self.head) != "")

    def familiar_groups(self, windows: LabelledWindows) -> TextArray:
        """Return the class of each window (W,), because few own features leave wide gaps between the classes."""
        return windows.label(self.head)

    def held_out(self, windows: LabelledWindows) -> dict[str, BoolArray]:
        """Return masks (W,) of the windows that are held out together, by the names of the people or recordings.

        Each person is a group, or each recording of one person. More than ten are divided into ten groups of about the
        same size.
        """
        units = np.unique(self.unit)
        n = min(len(units), MAX_PARTS)
        return {", ".join(map(str, units[k::n])): np.isin(self.unit, units[k::n]) for k in range(n)}

    def final_model(
        self, model: ContextModel, windows: LabelledWindows, left_out: Mapping[str, HeldOut]
    ) -> ContextModel:
        """Return the model, calibrated on held-out windows, with its card, transitions and exponents."""
        left, label = in_window_order(left_out.values()), windows.label(self.head)
        scored = np.zeros(len(label), dtype=bool)
        for group in left_out.values():
            others = np.unique(label[~group.rows])
            scored |= group.rows & (label != "") & np.isin(label, others)
        prob, y, unit = left.prob[scored], label[scored], self.unit[scored]
        temperature, slip = temperature_and_slip(prob, y, model)
        usual, limit = np.maximum(np.quantile(left.distance[scored], [0.9, 0.99]), 1e-6).tolist()
        found = self._evidence(
            calibrated_prob(left.prob, model, temperature, slip), left.distance, limit, model, windows
        )
        held_out = cross_calibrated(prob, y, unit, model)
        is_person, n_units = self.held_out_unit == "person", len(np.unique(unit))
        scores = {
            "people": how_many(n_units, "person", "people") if is_person else f"{n_units} recordings of one person",
            **score(y, held_out, self.labels),
            f"worst_{self.held_out_unit}_accuracy": worst_person_accuracy(y, held_out, unit, self.labels),
        }
        used = self.training_windows(windows)
        card: dict[str, Any] = {
            **self.card(used, scores, {}),
            "placements": sorted({str(mode) for mode in used.carrying_mode} - {""}),
            "n_recordings": self.n_recordings,
            "gyroscope": self.has_gyroscope,
            "temperature": round(temperature, 4),
            "slip": round(slip, 6),
        }
        estimated: dict[str, Any] = {}
        if found is not None:
            card |= {
                "transition_prob": found.of_matrix,
                "exponents": found.of_exponents,
                "n_changes": found.n_changes,
                "transitions_log_loss": {key: round(value, 4) for key, value in found.log_loss.items()},
            }
            estimated["transition_prob"] = found.transition_prob if found.of_matrix == "estimated" else None
            if found.of_exponents == "estimated":
                estimated["evidence_exponent"] = found.evidence_exponent
                estimated["prior_exponent"] = found.prior_exponent
        known = with_familiarity(model, used, limit, group=self.familiar_groups(used), usual=usual)
        return replace(
            known, temperature=temperature, slip=slip, card=card, needs_gyroscope=self.has_gyroscope, **estimated
        )

    def _evidence(
        self, prob: FloatArray, distance: FloatArray, limit: float, model: ContextModel, windows: LabelledWindows
    ) -> EvidenceEstimate | None:
        """Return the transitions and exponents estimated from the labels, or None for carrying modes."""
        steps = self.step_labels
        if steps is None:
            return None
        meanings = dict(zip(DEFAULT_CONTEXTS.names, DEFAULT_CONTEXTS.contexts, strict=True))
        prior = context_transitions([meanings.get(c, Context(c)) for c in self.labels])
        rows = np.isin([int(s.partition("/")[0]) for s in self.sequence], steps.recordings)
        if not rows.any():
            return estimate_evidence(None, default().model, prior)
        unknown = unknown_share(distance, limit, 2.0)[:, None]
        seen = ((1 - unknown) * prob + unknown * model.training_prior)[rows]
        index = {c: i for i, c in enumerate(self.labels)}
        truth = np.array([index.get(str(c), UNKNOWN) for c in self.at_middle[rows]])
        prior_rows = np.tile(model.training_prior, (len(seen), 1))
        windows_in_order = LabelledProbabilities(seen, prior_rows, truth, windows.person[rows], self.sequence[rows])
        sequences = LabelledSequences(
            steps.label, steps.person, steps.sequence, windows_in_order, len(steps.recordings)
        )
        return estimate_evidence(sequences, default().model, prior)
