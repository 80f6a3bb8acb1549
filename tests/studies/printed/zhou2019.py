"""What Zhou et al. 2019 prints, and what the printed numbers say against each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# --- what is printed ------------------------------------------------------------------------------------------------

PERSONS = ("PA", "PB", "PC", "PD")
WALKED_M, RUN_M = 1200.0, 800.0  # Table 3
# True, detected, over-counted, missed, wrong, success in per cent; rows are `PERSONS`.
PAPER_STEPS: Mapping[str, Mapping[str, tuple[tuple[float, ...], ...]]] = {
    "Levi and Judd": {
        "walking": (
            (891, 887, 6, 10, 16, 98.2),
            (747, 741, 0, 6, 6, 99.2),
            (877, 881, 10, 6, 16, 98.2),
            (870, 870, 4, 4, 8, 99.1),
        ),
        "running": (
            (384, 380, 0, 4, 4, 99.0),
            (349, 338, 0, 11, 11, 96.8),
            (470, 460, 0, 10, 10, 97.9),
            (401, 393, 0, 8, 8, 98.0),
        ),
    },
    "BCTFD": {
        "walking": (
            (891, 891, 0, 0, 0, 100.0),
            (747, 747, 0, 0, 0, 100.0),
            (877, 878, 1, 0, 1, 99.8),
            (870, 871, 1, 0, 1, 99.8),
        ),
        "running": (
            (384, 384, 0, 0, 0, 100.0),
            (349, 350, 1, 0, 1, 99.7),
            (470, 474, 4, 0, 4, 99.1),
            (401, 404, 3, 0, 3, 99.2),
        ),
    },
}
PAPER_AVERAGE = {"walking": (98.5, 99.1), "running": (97.1, 98.5)}  # Table 6: Levi and Judd, BCTFD
# Table 7, m: columns M1 to M7, rows `PERSONS`.
PAPER_ERROR_M: Mapping[str, tuple[tuple[float, ...], ...]] = {
    "walking": (
        (53.44, 49.78, 22.61, 52.82, 44.41, 38.46, 20.07),
        (86.17, 53.46, 15.76, 117.6, 64.14, 157.06, 14.06),
        (44.44, 26.36, 27.29, 19.81, 41.82, 28.39, 30.74),
        (35.59, 85.46, 31.82, 56.42, 16.35, 62.81, 16.21),
    ),
    "running": (
        (55.87, 35.54, 34.17, 37.79, 57.56, 31.11, 20.46),
        (72.52, 70.14, 70.73, 43.29, 64.83, 49.75, 19.7),
        (53.72, 51.15, 51.15, 50.91, 53.22, 50.05, 46.95),
        (124.63, 128.34, 80.53, 65.86, 122.89, 55.73, 50.44),
    ),
}
PAPER_ERROR_PERCENT = {  # Table 8, M1 to M7
    "walking": (6.01, 5.08, 3.63, 6.33, 5.07, 6.47, 3.31),
    "running": (12.1, 9.9, 11.1, 8.32, 12.56, 7.83, 6.32),
}
HEIGHT_CLASSES = (42, 85, 58, 20)  # persons, section VI


def paper_notes() -> tuple[str, ...]:
    """What Tables 4 to 8 say against each other, worked out from the printed numbers."""
    notes: list[str] = []
    printed = [row for behaviours in PAPER_STEPS.values() for rows in behaviours.values() for row in rows]
    equal = sum(n + over - less == found and over + less == wrong for n, found, over, less, wrong, _ in printed)
    notes.append(
        "Tables 4 and 5: detected = true + over-counted - missed, and wrong = over-counted + missed, in "
        f"{equal} of {len(printed)} rows."
    )
    off = [
        f"{100 * (1 - wrong / true):.2f} printed as {success}"
        for true, _, _, _, wrong, success in printed
        if abs(100 * (1 - wrong / true) - success) > 0.05 + 1e-9
    ]
    notes.append(f"Success rates that are cut off and not rounded: {'; '.join(off) or 'none'}.")
    four = {
        behaviour: np.mean(PAPER_ERROR_M[behaviour], axis=0) / distance_m * 100.0
        for behaviour, distance_m in (("walking", WALKED_M), ("running", RUN_M))
    }
    notes.append(
        f"The four persons of Table 7 are better than the 205 of Table 8: M7 has {four['walking'][6]:.2f} % of 1200 m "
        f"and {four['running'][6]:.2f} % of 800 m for the four, {PAPER_ERROR_PERCENT['walking'][6]} and "
        f"{PAPER_ERROR_PERCENT['running'][6]} % for all. Likewise success: {_mean_success('BCTFD', 'walking'):.1f} and "
        f"{_mean_success('BCTFD', 'running'):.1f} % for the four in Table 5, {PAPER_AVERAGE['walking'][1]} and "
        f"{PAPER_AVERAGE['running'][1]} % in Table 6."
    )
    notes.append(
        "M6 and the running half of M7 are one formula (eq. 12 and 14), yet Table 8 has "
        f"{PAPER_ERROR_PERCENT['running'][5]} and {PAPER_ERROR_PERCENT['running'][6]} % for runners: M6 must have had "
        "one parameter for walking and running together. Ours has, and so have M1 to M5."
    )
    strides_m = [WALKED_M / row[0] for row in PAPER_STEPS["BCTFD"]["walking"]]
    notes.append(
        f"1200 m in the walkers' true counts are {min(strides_m):.2f} to {max(strides_m):.2f} m each: what is counted "
        "is strides of the instrumented foot, not steps."
    )
    notes.append(
        f"The height classes have {sum(HEIGHT_CLASSES)} persons together, as stated; 160 cm is in none of them."
    )
    return tuple(notes)


def _mean_success(method: str, behaviour: str) -> float:
    return float(np.mean([100 * (1 - row[4] / row[0]) for row in PAPER_STEPS[method][behaviour]]))
