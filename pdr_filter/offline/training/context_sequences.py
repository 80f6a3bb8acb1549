"""How contexts follow each other, and how much a window counts: estimated from labelled sequences of windows.

The probabilities of changing from one context to another between two steps are counts with a prior; the two exponents
of the evidence (`weighting.context_log_evidence`) those with the lowest log loss on people left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.offline.training.cross_validation import TextArray
from pdr_filter.values import BoolArray, FloatArray, IntArray, check_array, check_transition_prob, read_only
from pdr_filter.values.mixtures import reweighted

UNKNOWN = -1  # a context that is not known: it is neither stayed in nor left
# A tenth is finer than the log loss is known: next to the optimum it changes in the third decimal.
EXPONENTS = read_only(np.linspace(0.0, 1.5, 16))
PRIOR_STEPS = 100.0  # steps that the prior of a row of transitions counts as: as many as a minute of walking


@dataclass(frozen=True, eq=False)
class LabelledProbabilities:
    """What a classifier said of windows in a row, of people whom it had not seen, and what was true."""

    prob: FloatArray  # (W, C)
    training_prior: FloatArray  # (W, C) of the classifier that gave them; one for each fold
    label: IntArray  # (W,) true context, `UNKNOWN` where there is none
    person: TextArray  # (W,)
    sequence: TextArray  # (W,) whose windows follow each other in time

    def __post_init__(self) -> None:
        if self.prob.ndim != 2 or self.prob.shape != self.training_prior.shape or not len(self.prob):
            raise ValueError(
                f"prob and training_prior must both be (W, C) with W > 0, got {self.prob.shape} and "
                f"{self.training_prior.shape}"
            )
        for name in ("label", "person", "sequence"):
            if len(getattr(self, name)) != len(self.prob):
                raise ValueError(f"{name} must have {len(self.prob)} rows as prob, got {len(getattr(self, name))}")
        _check_labels(self.label, self.prob.shape[1])
        check_array("prob", self.prob, "0 or more")

    @property
    def starts(self) -> BoolArray:
        """Whether a window is the first of its sequence, (W,)."""
        return sequence_starts(self.sequence)


def sequence_starts(sequence: TextArray) -> BoolArray:
    """Whether a row is the first of its sequence, (W,). ValueError if a sequence is in two pieces."""
    starts = np.ones(len(sequence), dtype=bool)
    starts[1:] = sequence[1:] != sequence[:-1]
    if starts.sum() > len(np.unique(sequence)):
        raise ValueError("the windows of a sequence must follow each other: sort by sequence and time")
    return starts


def count_transitions(
    label: IntArray, sequence: TextArray, n_contexts: int, steps: FloatArray | None = None
) -> FloatArray:
    """Times that context i was followed by context j, (C, C), in steps.

    n_ij is the number of changes from i to j; n_ii the steps made in i less the changes out of it, so that
    n_ij / sum_j n_ij is the probability of a change at a step. The last row of a sequence is followed by nothing.

    `label` (W,) are contexts of rows in a row, steps or windows; `UNKNOWN` breaks a sequence, and rows of different
    `sequence` (W,) do not follow each other. `steps` (W,) are those in each row, for windows; one each if not given. A
    window has one change at most: windows of 2 steps are as steps to first order in the probability of a change.
    """
    _check_labels(label, n_contexts)
    steps = np.ones(len(label)) if steps is None else steps
    if len(sequence) != len(label) or len(steps) != len(label):
        raise ValueError(f"label, sequence and steps differ in length: {len(label)}, {len(sequence)}, {len(steps)}")
    check_array("steps", steps, "0 or more")
    follows = ~sequence_starts(sequence)[1:] & (label[1:] != UNKNOWN) & (label[:-1] != UNKNOWN)
    before, after, made = label[:-1][follows], label[1:][follows], steps[:-1][follows]
    changed = before != after
    counts = np.zeros((n_contexts, n_contexts))
    np.add.at(counts, (before[changed], after[changed]), 1.0)
    spent = np.bincount(before, weights=made, minlength=n_contexts)
    # more changes than steps (standing has none): the context is left at the first
    counts[np.diag_indices(n_contexts)] = np.maximum(spent - counts.sum(axis=1), 0.0)
    return counts


def estimate_transitions(counts: FloatArray, prior: FloatArray, prior_steps: float = PRIOR_STEPS) -> FloatArray:
    """Transition matrix (C, C), rows from: p_ij = (n_ij + s q_ij) / (sum_j n_ij + s).

    The mean of the posterior of each row, the prior of which is Dirichlet with parameters s q_i. A context without
    data keeps its row of the prior q; a transition that q says is impossible is possible if it was seen. The counts
    must be of recordings in which people could change: those cut into one context each say that nobody ever does.

    `counts` (C, C) are those of `count_transitions`, `prior` (C, C) is q, a transition matrix
    (`recipes.context_transitions()`), and `prior_steps` s, above zero, how many steps it counts as.
    """
    if counts.shape != prior.shape or counts.ndim != 2 or counts.shape[0] != counts.shape[1]:
        raise ValueError(f"counts and prior must both be (C, C), got {counts.shape} and {prior.shape}")
    check_array("counts", counts, "0 or more")
    check_transition_prob(prior, len(prior), "prior")
    check_array("prior_steps", prior_steps, "positive")
    posterior = counts + prior_steps * prior
    return posterior / posterior.sum(axis=1, keepdims=True)


@dataclass(frozen=True, slots=True)
class Tempering:
    """Exponents of the evidence, and how good they are."""

    evidence_exponent: float
    prior_exponent: float
    log_loss: float  # of these exponents, mean over people; the exponents were chosen on them
    held_out_log_loss: float  # of each person with the exponents chosen on all others; NaN of one person


def filter_windows(
    windows: LabelledProbabilities,
    transition_prob: FloatArray,
    evidence_exponent: FloatArray | float,
    prior_exponent: FloatArray | float,
    floor: float,
) -> FloatArray:
    """Context probabilities (W, ..., C) after each window, for exponents (...); all alike before each sequence's first.

    p_k ~ (sum_j p_j t_jk) exp(e_k) with the log evidence e of `weighting.context_log_evidence`: the mode probabilities
    of the filter if all steps came with the windows. `transition_prob` is that between windows: of steps, its power.
    """
    n_contexts = windows.prob.shape[1]
    check_transition_prob(transition_prob, n_contexts)
    if not 0 < floor < 1:
        raise ValueError(f"floor must be between 0 and 1, got {floor}")
    log_prob = np.log(np.maximum(windows.prob, floor))
    log_prior = np.log(np.where(windows.training_prior > 0, windows.training_prior, 1.0 / n_contexts))
    by_evidence, by_prior = (np.asarray(exponent)[..., None] for exponent in (evidence_exponent, prior_exponent))
    starts = windows.starts
    even = np.full((*by_evidence.shape[:-1], n_contexts), 1.0 / n_contexts)
    result, p = np.empty((len(log_prob), *even.shape)), even
    for k in range(len(log_prob)):
        predicted = (even if starts[k] else p) @ transition_prob
        log_evidence = by_evidence * (log_prob[k] - by_prior * log_prior[k])
        p = result[k] = reweighted(predicted, log_evidence)
    return result


def log_loss_by_person(
    windows: LabelledProbabilities,
    transition_prob: FloatArray,
    evidence_exponent: FloatArray,
    prior_exponent: FloatArray,
    floor: float,
) -> tuple[tuple[str, ...], FloatArray]:
    """People, and the log loss (G, P) of each for G pairs of exponents: minus log probability of what was true."""
    result = filter_windows(windows, transition_prob, evidence_exponent, prior_exponent, floor)
    known = windows.label != UNKNOWN
    loss = -np.log(np.maximum(result[known, :, windows.label[known]], 1e-300))
    person = windows.person[known]
    people = np.unique(person)
    return tuple(str(p) for p in people), np.stack([loss[person == p].mean(axis=0) for p in people], axis=1)


def exponent_pairs() -> tuple[FloatArray, FloatArray]:
    """All pairs (G,) of exponents of evidence and prior to choose from."""
    of_evidence, of_prior = np.meshgrid(EXPONENTS, EXPONENTS, indexing="ij")
    return of_evidence.ravel(), of_prior.ravel()


def fit_tempering(windows: LabelledProbabilities, transition_prob: FloatArray, floor: float = 0.01) -> Tempering:
    """The exponents with the lowest log loss of filtered windows, every person counting alike.

    The probabilities must be of people whom the classifier has not seen, in sequences with changes of context.
    `transition_prob` (C, C) is that between windows, `floor` that of the probabilities as in `PedestrianModel`.
    """
    if not (windows.label != UNKNOWN).any():
        raise ValueError("no window has a known context")
    of_evidence, of_prior = exponent_pairs()
    people, loss = log_loss_by_person(windows, transition_prob, of_evidence, of_prior, floor)
    best = int(loss.mean(axis=1).argmin())
    held_out = np.nan
    if len(people) > 1:
        chosen = ((loss.sum(axis=1, keepdims=True) - loss) / (len(people) - 1)).argmin(axis=0)
        held_out = float(loss[chosen, np.arange(len(people))].mean())
    return Tempering(float(of_evidence[best]), float(of_prior[best]), float(loss[best].mean()), held_out)


def _check_labels(label: IntArray, n_contexts: int) -> None:
    if len(label) and not (label.min() >= UNKNOWN and label.max() < n_contexts):
        raise ValueError(f"labels must be from {UNKNOWN} to {n_contexts - 1}, got {label.min()} to {label.max()}")
