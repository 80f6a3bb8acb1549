"""Transition probabilities between contexts, and the weight of a window, from labelled sequences of windows.

The probabilities of changing from one context to another between two steps are counts with a Dirichlet prior. The two
exponents of the evidence (`weighting.context_log_evidence`) are those with the lowest log loss on held-out people.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdr_filter.offline.training.cross_validation import TextArray
from pdr_filter.values import BoolArray, FloatArray, IntArray, check_array, check_transition_prob, read_only
from pdr_filter.values.mixtures import reweighted_prob

UNKNOWN = -1  # label of an unknown context, which counts neither as staying nor as changing
# Candidates for the exponents. A step of a tenth is fine enough: next to the optimum, the log loss changes in the third
# decimal.
EXPONENTS = read_only(np.linspace(0.0, 1.5, 16))
PRIOR_STEPS = 100.0  # weight of the prior of a row of transitions in steps: about a minute of walking


@dataclass(frozen=True, eq=False)
class LabelledProbabilities:
    """Predicted probabilities of windows in order, for people who were not in training, with the true contexts."""

    prob: FloatArray  # (W, C) predicted probabilities
    # (W, C) class probabilities in the training data of the classifier, which may differ between folds
    training_prior: FloatArray
    label: IntArray  # (W,) true context, `UNKNOWN` if there is none
    person: TextArray  # (W,) person of each window
    sequence: TextArray  # (W,) sequence of each window. Windows of one sequence are consecutive in time.

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
        """True for the first window of each sequence, shape (W,)."""
        return sequence_starts(self.sequence)


def sequence_starts(sequence: TextArray) -> BoolArray:
    """Return True for the first row of each sequence, (W,). Raise ValueError if a sequence is not contiguous."""
    starts = np.ones(len(sequence), dtype=bool)
    starts[1:] = sequence[1:] != sequence[:-1]
    if starts.sum() > len(np.unique(sequence)):
        raise ValueError("the windows of a sequence must be contiguous: sort the rows by sequence and time")
    return starts


def count_transitions(
    label: IntArray, sequence: TextArray, n_contexts: int, steps: FloatArray | None = None
) -> FloatArray:
    """Count the transitions between contexts in labelled sequences, in steps.

    Parameters
    ----------
    label : array (W,) of int
        Context of each row, a step or a window, in order of time. `UNKNOWN` (-1) breaks a sequence.
    sequence : array (W,)
        Sequence of each row. There is no transition between different sequences.
    n_contexts : int
        Number of contexts C.
    steps : array (W,), optional
        Number of steps in each row, for windows. The default is one.

    Returns
    -------
    array (C, C)
        n_ij, the number of changes from context i to context j. The diagonal n_ii is the number of steps in i minus the
        changes out of it.

    Raises
    ------
    ValueError
        If lengths differ, labels are out of range, or a sequence is not contiguous.

    Notes
    -----
    n_ij / sum_j n_ij is the probability of a change at a step. The last row of a sequence has no successor. A window
    has at most one change. Windows of 2 steps are equivalent to steps up to first order in the probability of a change.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.offline.training.context_sequences import count_transitions
    >>> count_transitions(np.array([0, 0, 1, 1, 1]), np.array(["a"] * 5), n_contexts=2)
    array([[1., 1.],
           [0., 2.]])
    """
    _check_labels(label, n_contexts)
    steps = np.ones(len(label)) if steps is None else steps
    if len(sequence) != len(label) or len(steps) != len(label):
        raise ValueError(
            f"label, sequence and steps must have the same length, got {len(label)}, {len(sequence)}, {len(steps)}"
        )
    check_array("steps", steps, "0 or more")
    follows = ~sequence_starts(sequence)[1:] & (label[1:] != UNKNOWN) & (label[:-1] != UNKNOWN)
    before, after, made = label[:-1][follows], label[1:][follows], steps[:-1][follows]
    changed = before != after
    counts = np.zeros((n_contexts, n_contexts))
    np.add.at(counts, (before[changed], after[changed]), 1.0)
    spent = np.bincount(before, weights=made, minlength=n_contexts)
    # there can be more changes than steps, because standing has no steps: the context is then left at the first step
    counts[np.diag_indices(n_contexts)] = np.maximum(spent - counts.sum(axis=1), 0.0)
    return counts


def estimate_transitions(counts: FloatArray, prior: FloatArray, prior_steps: float = PRIOR_STEPS) -> FloatArray:
    """Estimate a transition matrix from counts of transitions and a prior.

    Parameters
    ----------
    counts : array (C, C)
        Counts from `count_transitions`. They must come from recordings in which the context can change. Recordings cut
        into one context each would show that it never changes.
    prior : array (C, C)
        Prior transition matrix, such as `recipes.context_transitions()`.
    prior_steps : float, default 100.0
        Weight of the prior, as a number of steps per row.

    Returns
    -------
    array (C, C)
        Transition matrix. Rows are the previous context, and sum to one.

    Raises
    ------
    ValueError
        If shapes differ, counts are negative, `prior` is not a transition matrix, or `prior_steps` is not positive.

    Notes
    -----
    p_ij = (n_ij + s q_ij) / (sum_j n_ij + s), with the prior q and its weight s. This is the posterior mean of each row
    under a Dirichlet prior with parameters s q_i. A context without data keeps its row of the prior. A transition that
    the prior excludes is possible if it was observed.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.offline.training.context_sequences import estimate_transitions
    >>> estimate_transitions(np.array([[80.0, 20.0], [0.0, 0.0]]), np.array([[0.9, 0.1], [0.1, 0.9]]))
    array([[0.85, 0.15],
           [0.1 , 0.9 ]])
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
    """Exponents of the evidence and their log losses."""

    evidence_exponent: float  # exponent of the probabilities
    prior_exponent: float  # exponent of the classifier's prior
    # mean over people of the log loss with these exponents, which were chosen on the same people (in-sample)
    log_loss: float
    # mean log loss of each person with the exponents chosen on all other people. NaN for one person.
    held_out_log_loss: float


def filter_windows(
    windows: LabelledProbabilities,
    transition_prob: FloatArray,
    evidence_exponent: FloatArray | float,
    prior_exponent: FloatArray | float,
    floor: float,
) -> FloatArray:
    """Return the filtered context probabilities (W, ..., C) after each window, for exponents of shape (...).

    The probability p_k of context k is proportional to (sum_j p_j t_jk) exp(e_k), with the probabilities p_j before the
    window, the transition probabilities t_jk, and the log evidence e of `weighting.context_log_evidence`. These are the
    mode probabilities of the filter if all steps came together with the windows. All contexts are equally probable
    before each sequence. `transition_prob` applies between two windows: it is a power of the matrix between two steps.
    """
    n_contexts = windows.prob.shape[1]
    check_transition_prob(transition_prob, n_contexts)
    if not 0 < floor < 1:
        raise ValueError(f"floor, the least probability of a context, must be between 0 and 1, got {floor}")
    log_prob = np.log(np.maximum(windows.prob, floor))
    log_prior = np.log(np.where(windows.training_prior > 0, windows.training_prior, 1.0 / n_contexts))
    by_evidence, by_prior = (np.asarray(exponent)[..., None] for exponent in (evidence_exponent, prior_exponent))
    starts = windows.starts
    even = np.full((*by_evidence.shape[:-1], n_contexts), 1.0 / n_contexts)
    result, p = np.empty((len(log_prob), *even.shape)), even
    for k in range(len(log_prob)):
        predicted = (even if starts[k] else p) @ transition_prob
        log_evidence = by_evidence * (log_prob[k] - by_prior * log_prior[k])
        p = result[k] = reweighted_prob(predicted, log_evidence)
    return result


def log_loss_by_person(
    windows: LabelledProbabilities,
    transition_prob: FloatArray,
    evidence_exponent: FloatArray,
    prior_exponent: FloatArray,
    floor: float,
) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of P people, and the mean log loss (G, P) of each person for each of G pairs of exponents.

    It is the log loss of the filtered probabilities (`filter_windows`) in windows with a known context.
    """
    result = filter_windows(windows, transition_prob, evidence_exponent, prior_exponent, floor)
    known = windows.label != UNKNOWN
    loss = -np.log(np.maximum(result[known, :, windows.label[known]], 1e-300))
    person = windows.person[known]
    people = np.unique(person)
    return tuple(str(p) for p in people), np.stack([loss[person == p].mean(axis=0) for p in people], axis=1)


def exponent_pairs() -> tuple[FloatArray, FloatArray]:
    """Return all candidate pairs (G,) of the exponents of evidence and prior."""
    of_evidence, of_prior = np.meshgrid(EXPONENTS, EXPONENTS, indexing="ij")
    return of_evidence.ravel(), of_prior.ravel()


def fit_tempering(windows: LabelledProbabilities, transition_prob: FloatArray, floor: float = 0.01) -> Tempering:
    """Choose the exponents of the evidence with the lowest log loss of filtered windows.

    All people have the same weight.

    Parameters
    ----------
    windows : LabelledProbabilities
        Predicted probabilities of people who were not in training, in sequences with changes of context.
    transition_prob : array (C, C)
        Transition matrix between two windows.
    floor : float, default 0.01
        Smallest probability of a window, as in `PedestrianModel`.

    Returns
    -------
    Tempering
        Exponents with their in-sample and held-out log loss.

    Raises
    ------
    ValueError
        If no window has a known context, or `floor` is not between 0 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.offline.training.context_sequences import LabelledProbabilities, fit_tempering
    >>> truth = np.repeat([0, 1, 0, 1], 10)
    >>> prob = np.where(truth[:, None] == [0, 1], 0.8, 0.2)
    >>> sequence = np.full(40, "anna/1")
    >>> windows = LabelledProbabilities(prob, np.full((40, 2), 0.5), truth, np.full(40, "anna"), sequence)
    >>> fitted = fit_tempering(windows, np.array([[0.9, 0.1], [0.1, 0.9]]))
    >>> fitted.evidence_exponent, round(fitted.log_loss, 2)
    (1.5, 0.08)
    """
    if not (windows.label != UNKNOWN).any():
        raise ValueError("no window has a known context: give windows with labels of the contexts")
    of_evidence, of_prior = exponent_pairs()
    people, loss = log_loss_by_person(windows, transition_prob, of_evidence, of_prior, floor)
    best = int(loss.mean(axis=1).argmin())
    held_out = np.nan
    if len(people) > 1:
        chosen = ((loss.sum(axis=1, keepdims=True) - loss) / (len(people) - 1)).argmin(axis=0)
        held_out = float(loss[chosen, np.arange(len(people))].mean())
    return Tempering(float(of_evidence[best]), float(of_prior[best]), float(loss[best].mean()), held_out)


def _check_labels(label: IntArray, n_contexts: int) -> None:
    """Raise ValueError if a label is out of range."""
    if len(label) and not (label.min() >= UNKNOWN and label.max() < n_contexts):
        raise ValueError(f"labels must be from {UNKNOWN} to {n_contexts - 1}, got {label.min()} to {label.max()}")
