"""Estimate transitions and tempering from labelled recordings in which people change their context.

Each recording goes through the front end of the default recipe with a context model that has not seen the person: its
steps are counted for the transitions, and its windows choose the exponents. What the data do not show stays the
default, and the file says so and why.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.classifiers.transition_files import Transitions
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
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
from pdr_filter.offline.training.context_training import DEFAULT_MODEL
from pdr_filter.offline.training.cross_validation import (
    Progress,
    TextArray,
    provenance,
    read_recording,
    silent,
    source_of,
)
from pdr_filter.recipes import default, with_context_model
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.sensing.front_end import Gap, Sensing
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, FloatArray, IntArray, Step
from pdr_filter.values.recording import Recording

MIN_CHANGES = 10  # with n changes a rate is known to 1 / sqrt(n) of itself: with ten to a third
# A choice for other people must have been good for some of them: so many also for the calibration of the models.
MIN_PEOPLE = 4
MAX_PARTS = 10  # held-out figures are of at most so many parts of the people: the time grows with them
# Models are trained again without a third of the people each.
N_FOLDS = 3
HALF_WINDOW_S = 1.0
STEPS_PER_WINDOW = 2  # a window a second, and 1.6 to 2 steps a second
# The context model of people who must not have been in its training.
ModelWithout = Callable[[Sequence[str]], ContextModel]


@dataclass(frozen=True, eq=False)
class LabelledSequences:
    """Steps and windows of recordings in which people change their context."""

    step_label: IntArray  # (K,) true context of each step, `UNKNOWN` outside every label
    step_person: TextArray  # (K,)
    step_sequence: TextArray  # (K,) stretch without gaps
    windows: LabelledProbabilities  # their label is the true context at their middle
    n_recordings: int

    def counts(self, without: Sequence[str] = ()) -> FloatArray:
        """Steps from context i to context j, (C, C), of all people but some."""
        use = ~np.isin(self.step_person, without)
        return count_transitions(self.step_label[use], self.step_sequence[use], self.windows.prob.shape[1])


def train_evidence(
    changing: Mapping[Path, str], out_dir: Path, model_without: ModelWithout, progress: Progress = silent
) -> dict[str, Any]:
    """Card of the transitions and exponents, which are written to `out_dir` as `transitions.json`.

    `changing` are recordings in which people change their context, and whose they are (`changing_recordings`);
    `model_without` takes people and gives the default's context model as it is without them in its training.
    """
    found = estimate(labelled_sequences(changing, model_without, progress), default().model)
    found.save(out_dir)
    return found.card


def changing_recordings(paths: Sequence[Path]) -> dict[Path, str]:
    """Recordings with gyroscope and more than one known context in their labels, and the person of each.

    Without gyroscope another model speaks, and tempering is that of the default's.
    """
    found: dict[Path, str] = {}
    for path in dict.fromkeys(path.resolve() for path in paths):
        recording = read_recording(path)
        labels = recording.truth.labels
        known = set() if labels is None else {str(c) for c in labels["context"]} & set(CONTEXTS)
        if recording.gyroscope is not None and len(known) > 1:
            found[path] = source_of(recording)[1]
    return found


def shipped_model_without(people: Sequence[str]) -> ContextModel:
    """The shipped model, for people who were not in its training; ValueError that names those who may have been."""
    model = load_model(DEFAULT_MODEL)
    seen = sorted(person for person in people if person.split("/")[0] in model.card["data"])
    if seen:
        raise ValueError(
            f"the shipped model {DEFAULT_MODEL!r} was trained on the data sets of {', '.join(seen)}; "
            "train the models again without them: python -m pdr_filter.offline.training.train_all"
        )
    return model


def labelled_sequences(
    changing: Mapping[Path, str], model_without: ModelWithout, progress: Progress = silent
) -> LabelledSequences | None:
    """Steps and windows of recordings, from models that have not seen the people; None if there are no windows."""
    steps: list[tuple[int, str, str]] = []
    windows: list[tuple[FloatArray, FloatArray, int, str, str]] = []
    people = sorted(set(changing.values()))
    n_done = 0
    for fold in (people[k::N_FOLDS] for k in range(min(N_FOLDS, len(people)))):
        model = model_without(fold)
        for path in (path for path, person in changing.items() if person in fold):
            recording, person = read_recording(path), changing[path]
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
    """Steps and windows of a recording between its gaps; a step follows no step from before a gap."""
    steps: list[Step] = []
    windows: list[WindowContext] = []
    for event in run_sensing(sensing, recording)[1]:
        if isinstance(event, Gap):
            yield steps, windows
            steps, windows = [], []
        elif isinstance(event, Step):
            steps.append(event)
        else:
            windows.append(event)
    yield steps, windows


def contexts_at(recording: Recording, time_s: FloatArray, contexts: tuple[str, ...] = CONTEXTS) -> IntArray:
    """True contexts (N,) at times (N,): an index into `contexts`, `UNKNOWN` outside every label and of other names."""
    result = np.full(len(time_s), UNKNOWN, dtype=np.int64)
    labels = recording.truth.labels
    for label in () if labels is None else labels:
        if label["context"] in contexts:
            result[(time_s >= label["start_s"]) & (time_s < label["end_s"])] = contexts.index(str(label["context"]))
    return result


class EvidenceModel(Protocol):
    """Transition matrix (C, C) between contexts and use of a window's probabilities, as of a `PedestrianModel`."""

    @property
    def transition_prob(self) -> FloatArray:
        """From context i to context j between two steps; rows sum to one."""
        ...

    @property
    def evidence_exponent(self) -> float:
        """Exponent of the probabilities."""
        ...

    @property
    def prior_exponent(self) -> float:
        """Exponent of the classifier's prior."""
        ...

    @property
    def evidence_floor(self) -> float:
        """Least probability of a window."""
        ...


@dataclass(frozen=True, eq=False)
class EvidenceEstimate:
    """Transitions and exponents, those of a default where labels show too little."""

    transition_prob: FloatArray  # (C, C)
    evidence_exponent: float
    prior_exponent: float
    counts: FloatArray  # (C, C)
    of_matrix: str  # "estimated", or "default: " and why
    of_exponents: str
    log_loss: dict[str, float]  # from `held_out_log_loss`; empty if no exponents could be chosen

    @property
    def n_changes(self) -> int:
        """Number of changes of context from one step to the next."""
        return int(self.counts.sum() - np.trace(self.counts))


def estimate_evidence(sequences: LabelledSequences | None, default: EvidenceModel) -> EvidenceEstimate:
    """Return transitions and exponents that the sequences show, and those of the default where they show too little.

    The matrix is estimated from `MIN_CHANGES` changes of context on; the exponents are chosen if there are also
    `MIN_PEOPLE` people, and if such a choice lowers the log loss of people who had no part in it.
    """
    counts = np.zeros_like(default.transition_prob) if sequences is None else sequences.counts()
    n_changes = int(counts.sum() - np.trace(counts))
    transition_prob = default.transition_prob
    evidence_exponent, prior_exponent = default.evidence_exponent, default.prior_exponent
    losses: dict[str, float] = {}
    of_matrix = of_exponents = (
        f"default: {n_changes} changes of context from one step to the next in the labels, needed are {MIN_CHANGES}"
    )
    if sequences is not None and n_changes >= MIN_CHANGES:
        transition_prob, of_matrix = estimate_transitions(counts, default.transition_prob), "estimated"
        n_people = len(np.unique(sequences.windows.person[sequences.windows.label != UNKNOWN]))
        of_exponents = f"default: {n_people} people (subject.id in meta.json), needed are {MIN_PEOPLE}"
        if n_people >= MIN_PEOPLE:
            losses = held_out_log_loss(sequences, default)
            of_exponents = "default: exponents chosen on some people do not lower the log loss of others"
            if losses["held_out"] < losses["held_out_default_exponents"]:
                between = np.linalg.matrix_power(transition_prob, STEPS_PER_WINDOW)
                chosen = fit_tempering(sequences.windows, between, default.evidence_floor)
                evidence_exponent, prior_exponent = chosen.evidence_exponent, chosen.prior_exponent
                of_exponents = "estimated"
    return EvidenceEstimate(transition_prob, evidence_exponent, prior_exponent, counts, of_matrix, of_exponents, losses)


def estimate(sequences: LabelledSequences | None, default: PedestrianModel) -> Transitions:
    """Return what `estimate_evidence` finds, with a card."""
    found = estimate_evidence(sequences, default)
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


def held_out_log_loss(sequences: LabelledSequences, default: EvidenceModel) -> dict[str, float]:
    """Log loss of filtered windows, mean over people, by whose matrix and exponents are used.

    `default`: both the default's. `held_out`: both from all other people (or the other `MAX_PARTS` parts of many).
    `held_out_default_exponents`: the matrix alone from them.
    """
    windows, floor = sequences.windows, default.evidence_floor
    by_evidence, by_prior = exponent_pairs()
    exponents = np.append(by_evidence, default.evidence_exponent), np.append(by_prior, default.prior_exponent)

    def log_loss(transition_prob: FloatArray) -> tuple[tuple[str, ...], FloatArray]:
        between = np.linalg.matrix_power(transition_prob, STEPS_PER_WINDOW)
        return log_loss_by_person(windows, between, *exponents, floor)

    people, of_default = log_loss(default.transition_prob)
    matrix_only, both = np.empty(len(people)), np.empty(len(people))
    n_parts = min(len(people), MAX_PARTS)
    for k in range(n_parts):
        left_out = np.arange(len(people)) % n_parts == k
        counts = sequences.counts(without=[person for person, out in zip(people, left_out, strict=True) if out])
        loss = log_loss(estimate_transitions(counts, default.transition_prob))[1]
        chosen = loss[:, ~left_out].mean(axis=1).argmin()
        matrix_only[left_out], both[left_out] = loss[-1, left_out], loss[chosen, left_out]
    return {
        "default": float(of_default[-1].mean()),
        "held_out_default_exponents": float(matrix_only.mean()),
        "held_out": float(both.mean()),
    }
