"""What Tian et al. 2016 prints, and what the printed numbers say against each other."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from pdr_filter.evaluate.distance import percent_error
from pdr_filter.recipes.tian2016.recipe import tian_fit
from pdr_filter.values import FloatArray

PAPER = (
    'Q. Tian, Z. Salcic, K. I.-K. Wang, Y. Pan, "A Multi-Mode Dead Reckoning System for Pedestrian Tracking Using '
    'Smartphones", IEEE Sensors Journal, 2016, doi:10.1109/JSEN.2015.2510364.'
)

# --- What is printed -------------------------------------------------------------------------------------------------

# The machine's modes and our names of them.
MODES = {"HOLDING": "texting", "SWING": "swinging", "POCKET": "pocket"}
# Table VI, per cent: columns the true mode, rows the one found; then transitions missed, and false ones.
TABLE_VI = np.array([[96.88, 5.26, 3.57], [0.0, 89.48, 3.57], [3.12, 5.26, 92.86]])
MISSED, FALSE = 7.55, 1.89
N_TRANSITIONS, N_PEOPLE = 106, 17
# Table VII, m: minimum, maximum, median, standard deviation of the distances estimated over 28 m.
TABLE_VII = {
    "eq. (2), static": (22.19, 36.31, 26.92, 3.58),
    "eq. (3), Weinberg": (22.70, 33.59, 28.04, 2.69),
    "eq. (4), Kim": (22.64, 32.04, 28.39, 2.73),
    "eq. (9), k h sqrt(f)": (24.56, 32.27, 27.96, 2.30),
}
CORRIDOR_M = 28.0
PATH_M = 96.33


@dataclass(frozen=True)
class Printed:
    """A column of Table VIII or IX."""

    name: str
    n_true: int
    n_found: int
    percent: float  # of the steps
    distance_m: float
    max_heading_deg: float
    median_heading_deg: float
    position_m: float
    height_m: float = 1.73
    gender: str = "M"


TABLE_VIII = (
    Printed("HOLDING", 131, 131, 100.0, 96.37, 14.23, 1.96, 0.75),
    Printed("SWING", 128, 127, 99.22, 94.76, 14.8, 4.63, 1.33),
    Printed("POCKET", 128, 126, 98.44, 93.31, 10.58, 3.16, 0.71),
)
TABLE_IX = (
    Printed("S1", 140, 139, 99.3, 96.70, 17.0, 3.41, 1.34, 1.65, "F"),
    Printed("S2", 140, 141, 100.71, 95.07, 15.98, 5.00, 2.00, 1.60, "M"),
    Printed("S3", 140, 137, 97.9, 91.43, 13.52, 3.58, 0.83, 1.59, "F"),
    Printed("S4", 130, 124, 95.4, 92.86, 11.22, 2.97, 1.01, 1.74, "M"),
    Printed("S5, jeans", 133, 127, 95.5, 96.03, 9.91, 1.94, 0.30, 1.73, "M"),
    Printed("S5, casual trousers", 128, 125, 97.66, 93.33, 6.43, 0.94, 0.84, 1.73, "M"),
)
# Averages that the text gives, per cent.
DISTANCE_SINGLE, STEPS_MULTI, DISTANCE_MULTI, POSITION_MULTI = 98.43, 97.75, 97.83, 98.91
_WALK_S = 90.0


def printed_checks() -> tuple[str, ...]:
    """What the paper's printed figures say against each other, one sentence or two each."""
    n_of = np.array(_denominators())
    right = np.rint(np.diagonal(TABLE_VI) / 100 * n_of).astype(int)
    missed, wrong = round(N_TRANSITIONS * MISSED / 100), round(N_TRANSITIONS * FALSE / 100)
    largest = max(abs(100 * p.n_found / p.n_true - p.percent) for p in (*TABLE_VIII, *TABLE_IX))
    single, multi = (np.array([p.distance_m for p in t]) for t in (TABLE_VIII, TABLE_IX))
    shares = np.array([100 * p.n_found / p.n_true for p in TABLE_IX])
    position = 100 - 100 * np.mean([p.position_m for p in TABLE_IX]) / PATH_M
    first = TABLE_VIII[0]
    # of eq. 9 with equal steps: f = (L / (k h))^2
    k_h = float(tian_fit(first.height_m, first.gender).theta[0]) * first.height_m
    frequency_hz = (first.distance_m / first.n_found / k_h) ** 2
    return (
        f"Table VI is of {n_of[0]}, {n_of[1]} and {n_of[2]} transitions: the only numbers whose shares print so within "
        f"0.01 and that add up to {n_of.sum()}, which is {N_TRANSITIONS} less the {missed} missed ones. {right[0]}, "
        f"{right[1]} and {right[2]} of them are right: {100 * right.sum() / n_of.sum():.1f} % of those seen and "
        f"{100 * right.sum() / N_TRANSITIONS:.1f} % of all. False triggers: {wrong}.",
        f"Shares of steps in Tables VIII and IX follow from the counts within {largest:.2f} points.",
        f"The accuracy of the distance in Table VIII, printed {DISTANCE_SINGLE} %, is that of the total, "
        f"{_of_total(single):.2f} %; the mean over the walks is {_mean_accuracy(single):.2f} %. In Table IX, printed "
        f"{DISTANCE_MULTI} %, of the total {_of_total(multi):.2f} %, over the walks {_mean_accuracy(multi):.2f} %.",
        f"The accuracy of the steps in Table IX, printed {STEPS_MULTI} %, is the mean of the shares, "
        f"{shares.mean():.2f} %, in which the surplus of S2 makes up for steps missed by others; the mean of the "
        f"absolute errors leaves {100 - np.abs(shares - 100).mean():.2f} %.",
        f"The position accuracy, printed {POSITION_MULTI} %, is 100 % less the mean position error of Table IX in per "
        f"cent of the path: {position:.2f} %. It is no error of the end.",
        f"{first.n_found} steps of {first.distance_m / first.n_found:.3f} m by a man of {first.height_m} m need "
        f"{frequency_hz:.2f} steps a second in eq. (9), that is {first.n_found / frequency_hz:.0f} s of walking; the "
        f"text has about {_WALK_S:.0f} s.",
    )


def _denominators() -> tuple[int, ...]:
    """Numbers of transitions into each mode that have the shares of Table VI and together are those not missed."""
    n_seen = N_TRANSITIONS - round(N_TRANSITIONS * MISSED / 100)
    (found,) = (ns for ns in product(*(_possible(column) for column in TABLE_VI.T)) if sum(ns) == n_seen)
    return found


def _possible(percent: FloatArray) -> list[int]:
    """Numbers of which all these shares are whole ones, to the last printed digit or one beside it."""
    # 0.011: two printed figures are rounded so that the column adds up to 100
    return [n for n in range(1, N_TRANSITIONS) if np.abs(100 * np.rint(percent / 100 * n) / n - percent).max() < 0.011]


def _of_total(distance_m: FloatArray) -> float:
    return 100 - abs(100 * distance_m.mean() / PATH_M - 100)


def _mean_accuracy(distance_m: FloatArray) -> float:
    return 100 - float(np.abs(percent_error(distance_m, PATH_M)).mean())
