"""Fixed-interval smoother of the interacting multiple model: the oracle of the smoother where the problem is linear.

C.-J. Kim, "Dynamic linear models with Markov-switching", Journal of Econometrics 60 (1994), section 3. With one mode it
is the Rauch-Tung-Striebel smoother, with modes that move alike the forward-backward algorithm of a hidden Markov model;
with both an approximation, because the filter is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdr_filter.values import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ModeEstimates:
    """Mean, covariance and probability of each mode at one time."""

    mean: FloatArray  # (M, n)
    cov: FloatArray  # (M, n, n)
    mode_prob: FloatArray  # (M,)


@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """Transition from one time to the next, linearised: x = a_i + F_i (x_before - b_i) + noise of Q_i in mode i."""

    transition_prob: FloatArray  # (M, M) from mode j to mode i
    origin: FloatArray  # (M, n) b_i, about which mode i was linearised
    predicted: FloatArray  # (M, n) a_i, where that leads
    F: FloatArray  # (M, n, n)
    Q: FloatArray  # (M, n, n)


def smooth_imm(filtered: Sequence[ModeEstimates], transitions: Sequence[Transition]) -> list[ModeEstimates]:
    """Smoothed estimates, one for each filtered one; the last is the filtered one itself.

    w_ji = p_s(i) mu_j pi_ji / sum_j mu_j pi_ji (Kim's eq. 2.20, with the pair's likelihood already in mu);
    G_ji = P_j F_i' (F_i P_j F_i' + Q_i)^-1;  x_ji = x_j + G_ji (x_s,i - a_i - F_i (x_j - b_i));
    P_ji = P_j + G_ji (P_s,i - F_i P_j F_i' - Q_i) G_ji'; then p_s(j) = sum_i w_ji and moments merged over i.

    `filtered` are K estimates with all evidence up to their time, `transitions` those from each to the next.
    """
    if len(transitions) != len(filtered) - 1:
        raise ValueError(f"{len(filtered)} estimates need {len(filtered) - 1} transitions, got {len(transitions)}")
    smoothed = [filtered[-1]]
    for estimate, transition in zip(reversed(filtered[:-1]), reversed(transitions), strict=True):
        smoothed.append(_back(estimate, transition, smoothed[-1]))
    return smoothed[::-1]


def _back(now: ModeEstimates, to_next: Transition, later: ModeEstimates) -> ModeEstimates:
    """Smoothed estimate at one time from the smoothed one of the next."""
    F, Q = to_next.F[None], to_next.Q[None]  # (1, i, n, n)
    P = now.cov[:, None]  # (j, 1, n, n)
    predicted = to_next.predicted + np.einsum("iab,jib->jia", to_next.F, now.mean[:, None] - to_next.origin)
    PF = P @ F.swapaxes(-1, -2)
    predicted_cov = F @ PF + Q
    # A stationary mode at the start has no noise in some directions: what is known there needs no correction.
    G = PF @ np.linalg.pinv(predicted_cov, hermitian=True)
    x = now.mean[:, None] + np.einsum("jiab,jib->jia", G, later.mean - predicted)
    cov = P + G @ (later.cov - predicted_cov) @ G.swapaxes(-1, -2)

    joint = now.mode_prob[:, None] * to_next.transition_prob  # (j, i)
    reached = joint.sum(axis=0)
    pair = later.mode_prob * np.divide(joint, reached, where=reached > 0, out=np.zeros_like(joint))
    prob = pair.sum(axis=1)
    possible = prob > 0
    weights = np.divide(pair, prob[:, None], where=possible[:, None], out=np.zeros_like(pair))
    mean = np.einsum("ji,jia->ja", weights, x)
    spread = x - mean[:, None]
    merged = np.einsum("ji,jiab->jab", weights, cov + spread[..., :, None] * spread[..., None, :])
    # A mode that is impossible in hindsight keeps what the filter said of it: nothing depends on it.
    mean = np.where(possible[:, None], mean, now.mean)
    merged = np.where(possible[:, None, None], 0.5 * (merged + merged.swapaxes(-1, -2)), now.cov)
    return ModeEstimates(mean, merged, prob / prob.sum())
