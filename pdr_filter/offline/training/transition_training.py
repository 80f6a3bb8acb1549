"""Estimation of transitions and exponents from labelled recordings in which the context changes.

Each recording is processed by the front end of the default recipe with a context model that was not trained on the
person. The transitions are counted over its steps, and the exponents are chosen on its windows. If the data are not
sufficient, the default values are kept, and the file states the reason.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.transition_files import Transitions
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.offline.training.context_sequences import (
    PRIOR_STEPS,
    UNKNOWN,
    LabelledProbabilities,
    count_transitions,
    estimate_transitions,
    exponent_pairs,
    fit_tempering,
    log_loss_by_person,
)
from pdr_filter.offline.training.cross_validation import Progress, TextArray, provenance, silent, source_of
from pdr_filter.recipes import default, with_context_model
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, FloatArray, IntArray, Step, WindowContext
from pdr_filter.values.events import Gap
from pdr_filter.values.recording import Recording

DEFAULT_MODEL = "context"  # model of the default recipe, for which transitions and exponents are estimated
MIN_CHANGES = 10  # n changes give a rate with a relative error of 1 / sqrt(n): with ten, a third
# Smallest number of people for a choice of exponents, which must be good for people who had no part in it. The
# calibration of the models needs as many.
MIN_PEOPLE = 4
MAX_PARTS = 10  # largest number of parts of the people that are held out, because the time grows with it
# Number of folds: models are trained again without a third of the people each.
N_FOLDS = 3
HALF_WINDOW_S = 1.0
STEPS_PER_WINDOW = 2  # one window and 1.6 to 2 steps per second
# Function that returns the context model trained without the given people.
ModelWithout = Callable[[Sequence[str]], ContextModel]
# Function that reads the recording of a file, such as `pdr_filter.read`.
Reader = Callable[[Path], Recording]


@dataclass(frozen=True, eq=False)
class LabelledSequences:
    """Steps and windows of recordings in which the context changes."""

    step_label: IntArray  # (K,) true context of each step, `UNKNOWN` outside every label
    step_person: TextArray  # (K,) person of each step
    step_sequence: TextArray  # (K,) stretch without gaps of each step
    windows: LabelledProbabilities  # windows, with the true context at their middle
    n_recordings: int  # number of recordings

    def counts(self, without: Sequence[str] = ()) -> FloatArray:
        """Return the counted transitions (C, C) between steps, of all people except those in `without`."""
        use = ~np.isin(self.step_person, without)
        return count_transitions(self.step_label[use], self.step_sequence[use], self.windows.prob.shape[1])


def train_evidence(
    changing: Mapping[Path, str],
    read: Reader,
    out_dir: Path,
    model_without: ModelWithout,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Estimate transitions and exponents, save them to `out_dir` as `transitions.json`, and return their card.

    `changing` maps recordings in which the context changes to their persons (`changing_recordings`). `model_without`
    returns the default's context model trained without the given people.
    """
    found = estimate(labelled_sequences(changing, read, model_without, progress), default().model)
    found.save(out_dir)
    return found.card


def changing_recordings(paths: Sequence[Path], read: Reader) -> dict[Path, str]:
    """Return the recordings with a gyroscope and more than one known context in their labels, with their persons.

    Recordings without a gyroscope use another model, but the exponents are for the default's model.
    """
    found: dict[Path, str] = {}
    for path in dict.fromkeys(path.resolve() for path in paths):
        recording = read(path)
        labels = recording.truth.labels
        known = set() if labels is None else {str(c) for c in labels["context"]} & set(CONTEXTS)
        if recording.gyroscope is not None and len(known) > 1:
            found[path] = source_of(recording)[1]
    return found


def shipped_model_without(people: Sequence[str]) -> ContextModel:
    """Return the shipped model, if it was not trained on the given people.

    Otherwise raise ValueError with their names.
    """
    model = load_model(DEFAULT_MODEL)
    seen = sorted(person for person in people if person.split("/")[0] in model.card["data"])
    if seen:
        raise ValueError(
            f"the shipped model {DEFAULT_MODEL!r} was trained on the data sets of {', '.join(seen)}, who must be held "
            "out; train the models again without them, in a clone: make models"
        )
    return model


def labelled_sequences(
    changing: Mapping[Path, str], read: Reader, model_without: ModelWithout, progress: Progress = silent
) -> LabelledSequences | None:
    """Return steps and windows of recordings, classified by models trained without their persons.

    None if there are no windows.
    """
    steps: list[tuple[int, str, str]] = []
    windows: list[tuple[FloatArray, FloatArray, int, str, str]] = []
    people = sorted(set(changing.values()))
    n_done = 0
    for fold in (people[k::N_FOLDS] for k in range(min(N_FOLDS, len(people)))):
        model = model_without(fold)
        for path in (path for path, person in changing.items() if person in fold):
            recording, person = read(path), changing[path]
            sensing = with_context_model(default(recording.subject), model).sensing
            for number, (found_steps, found_windows) in enumerate(stretches(sensing, recording)):
                sequence = f"{n_done}/{number}"
                of_step = contexts_at(recording, np.array([step.time_s for step in found_steps]))
                steps += [(int(label), person, sequence) for label in of_step]
                middle_s = np.array([window.time_s - HALF_WINDOW_S for window in found_windows])
                for window, label in zip(found_windows, contexts_at(recording, middle_s), strict=True):
                    windows.append((window.prob, window.training_prior, int(label), person, sequence))
            n_done += 1
            progress(f"transitions: {path.stem}", n_done / len(changing))
    if not windows:
        return None
    step_label, step_person, step_sequence = (np.array([step[i] for step in steps]) for i in range(3))
    return LabelledSequences(
        step_label.astype(np.int64),
        step_person.astype(np.str_),
        step_sequence.astype(np.str_),
        LabelledProbabilities(*(np.array(column) for column in zip(*windows, strict=True))),
        len(changing),
    )


def stretches(sensing: Sensing, recording: Recording) -> Iterator[tuple[list[Step], list[WindowContext]]]:
    """Yield the steps and windows of a recording between its gaps. Steps are never counted across a gap."""
    steps: list[Step] = []
    windows: list[WindowContext] = []
    for event in run_sensing(sensing, recording)[1]:
        if isinstance(event, Gap):
            yield steps, windows
            steps, windows = [], []
        elif isinstance(event, Step):
            steps.append(event)
        elif isinstance(event, WindowContext):
            windows.append(event)
    yield steps, windows


def contexts_at(recording: Recording, time_s: FloatArray, contexts: tuple[str, ...] = CONTEXTS) -> IntArray:
    """Return the true contexts (N,) at times (N,), as indices into `contexts`.

    `UNKNOWN` marks times outside every label and labels with other names.
    """
    result = np.full(len(time_s), UNKNOWN, dtype=np.int64)
    labels = recording.truth.labels
    for label in () if labels is None else labels:
        if label["context"] in contexts:
            result[(time_s >= label["start_s"]) & (time_s < label["end_s"])] = contexts.index(str(label["context"]))
    return result


@dataclass(frozen=True, eq=False)
class EvidenceEstimate:
    """Estimated transitions and exponents, or default values if the labels are not sufficient."""

    transition_prob: FloatArray  # (C, C) transition matrix between two steps
    evidence_exponent: float  # exponent of the probabilities
    prior_exponent: float  # exponent of the classifier's prior
    counts: FloatArray  # (C, C) counted transitions
    of_matrix: str  # "estimated", or "default: " and the reason
    of_exponents: str  # "estimated", or "default: " and the reason
    log_loss: dict[str, float]  # result of `held_out_log_loss`. Empty if no exponents could be chosen.

    @property
    def n_changes(self) -> int:
        """Number of changes of context between two steps."""
        return int(self.counts.sum() - np.trace(self.counts))


def estimate_evidence(
    sequences: LabelledSequences | None, default: PedestrianModel, prior: FloatArray
) -> EvidenceEstimate:
    """Return the transitions and exponents estimated from sequences, or the default ones.

    The default transitions (C, C) are `prior`, and the default exponents those of a model. The matrix is estimated from
    at least `MIN_CHANGES` changes of context. The exponents are chosen if there are also at least `MIN_PEOPLE` people,
    and if such a choice lowers the log loss of people who had no part in it.
    """
    counts = np.zeros_like(prior) if sequences is None else sequences.counts()
    n_changes = int(counts.sum() - np.trace(counts))
    transition_prob, evidence_exponent, prior_exponent = prior, default.evidence_exponent, default.prior_exponent
    losses: dict[str, float] = {}
    of_matrix = of_exponents = (
        f"default: {n_changes} changes of context from one step to the next in the labels, but {MIN_CHANGES} are needed"
    )
    if sequences is not None and n_changes >= MIN_CHANGES:
        transition_prob, of_matrix = estimate_transitions(counts, prior), "estimated"
        n_people = len(np.unique(sequences.windows.person[sequences.windows.label != UNKNOWN]))
        of_exponents = f"default: {n_people} people (subject.id in meta.json), but {MIN_PEOPLE} are needed"
        if n_people >= MIN_PEOPLE:
            losses = held_out_log_loss(sequences, default, prior)
            of_exponents = "default: exponents chosen on some people do not lower the log loss of others"
            if losses["held_out"] < losses["held_out_default_exponents"]:
                between = np.linalg.matrix_power(transition_prob, STEPS_PER_WINDOW)
                chosen = fit_tempering(sequences.windows, between, default.evidence_floor)
                evidence_exponent, prior_exponent = chosen.evidence_exponent, chosen.prior_exponent
                of_exponents = "estimated"
    return EvidenceEstimate(transition_prob, evidence_exponent, prior_exponent, counts, of_matrix, of_exponents, losses)


def estimate(sequences: LabelledSequences | None, default: PedestrianModel) -> Transitions:
    """Return the estimate of `estimate_evidence` as `Transitions` with a card, which describes its data and scores."""
    found = estimate_evidence(sequences, default, default.transition_prob)
    people = [] if sequences is None else [str(person) for person in np.unique(sequences.windows.person)]
    card = {
        "name": "transitions",
        "file": "transitions.json",
        "description": "How contexts follow each other from step to step, and how much a window counts.",
        "transition_prob": found.of_matrix,
        "exponents": found.of_exponents,
        "model": DEFAULT_MODEL,
        "data": sorted({person.split("/")[0] for person in people}),
        "n_people": len(people),
        "n_recordings": 0 if sequences is None else sequences.n_recordings,
        "n_windows": 0 if sequences is None else int((sequences.windows.label != UNKNOWN).sum()),
        "n_steps": int(found.counts.sum()),
        "n_changes": found.n_changes,
        "prior_steps": PRIOR_STEPS,
        "log_loss": {name: round(value, 4) for name, value in found.log_loss.items()},
        **provenance("pdr-filter train --sequences FOLDER --out models"),
    }
    return Transitions(found.transition_prob, found.evidence_exponent, found.prior_exponent, found.counts, card)


def held_out_log_loss(sequences: LabelledSequences, default: PedestrianModel, prior: FloatArray) -> dict[str, float]:
    """Return the log loss of filtered windows, as a mean over people, for three choices of matrix and exponents.

    "default" uses the transitions `prior` and the default exponents. "held_out" estimates both from all other people
    (or from the other `MAX_PARTS` parts of many people). "held_out_default_exponents" estimates only the matrix from
    them.
    """
    windows, floor = sequences.windows, default.evidence_floor
    by_evidence, by_prior = exponent_pairs()
    exponents = np.append(by_evidence, default.evidence_exponent), np.append(by_prior, default.prior_exponent)

    def log_loss(transition_prob: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
        between = np.linalg.matrix_power(transition_prob, STEPS_PER_WINDOW)
        return log_loss_by_person(windows, between, *exponents, floor)

    people, of_default = log_loss(prior)
    matrix_only, both = np.empty(len(people)), np.empty(len(people))
    n_parts = min(len(people), MAX_PARTS)
    for k in range(n_parts):
        left_out = np.arange(len(people)) % n_parts == k
        counts = sequences.counts(without=[person for person, out in zip(people, left_out, strict=True) if out])
        loss = log_loss(estimate_transitions(counts, prior))[1]
        chosen = loss[:, ~left_out].mean(axis=1).argmin()
        matrix_only[left_out], both[left_out] = loss[-1, left_out], loss[chosen, left_out]
    return {
        "default": float(of_default[-1].mean()),
        "held_out_default_exponents": float(matrix_only.mean()),
        "held_out": float(both.mean()),
    }
