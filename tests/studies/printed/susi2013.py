"""What Susi et al. 2013 prints, and what the printed numbers say against each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# --- what is printed ------------------------------------------------------------------------------------------------

ACTIVITIES = ("swinging", "texting/phoning/bag", "irregular")
PAPER_MODES_PERCENT = np.array([[95, 2, 3], [1, 98, 3], [6, 0, 94]])  # Table 1, rows the activity
PAPER_OCCURRENCE_PERCENT = (42, 53, 5)
# Table 2: occurrence, Pdet, Pfa, Pmd in per cent.
PAPER_STEPS_PERCENT: Mapping[str, tuple[int, int, int, int]] = {
    "swinging": (42, 99, 1, 1),
    "texting": (25, 100, 0, 0),
    "phoning": (20, 99, 0, 1),
    "bag": (8, 97, 1, 3),
}
PAPER_CONTROLLED_PERCENT = {"texting": (100, 0, 0), "swinging": (0, 98, 2)}  # Table 3: texting, swinging, irregular
SUBJECTS = ("M1", "M2", "M3", "M4", "M5", "W1", "W2", "W3", "W4", "W5")
PAPER_MOTION_PERCENT = (100, 100, 99, 100, 100, 98, 100, 98, 100, 100)  # Table 4
PAPER_DETECTED_PERCENT = (99, 100, 100, 99, 100, 97, 100, 99, 98, 100)
PAPER_MEANS_PERCENT = (99.6, 99.2)


def paper_notes() -> tuple[str, ...]:
    """What Tables 1 to 4 say against each other, worked out from the printed numbers."""
    rows = PAPER_MODES_PERCENT.sum(axis=1)
    odd = [f"{activity} {total} %" for activity, total in zip(ACTIVITIES, rows, strict=True) if total != 100]
    right = np.diagonal(PAPER_MODES_PERCENT)
    weighted = float(right @ np.array(PAPER_OCCURRENCE_PERCENT)) / 100.0
    occurrence = [row[0] for row in PAPER_STEPS_PERCENT.values()]
    low = [f"{name} {row[1]} %" for name, row in PAPER_STEPS_PERCENT.items() if row[1] <= 98]
    motion, steps = float(np.mean(PAPER_MOTION_PERCENT)), float(np.mean(PAPER_DETECTED_PERCENT))
    both = 0.5 * sum(PAPER_CONTROLLED_PERCENT[m][i] for i, m in enumerate(("texting", "swinging")))
    lost = 0.06 * 600.0
    return (
        f"Rows of Table 1 that do not add up to 100 %: {', '.join(odd) or 'none'}. With the printed occurrence its "
        f"diagonal is {weighted:.1f} % of all windows.",
        "Table 2: Pdet + Pmd is 100 % in "
        f"{sum(d + m == 100 for _, d, _, m in PAPER_STEPS_PERCENT.values())} of {len(PAPER_STEPS_PERCENT)} modes, and "
        f"its occurrences add up to {sum(occurrence)} %, which is Table 1 without irregular motion "
        f"({100 - PAPER_OCCURRENCE_PERCENT[2]} %). The text says higher than 98 % for every mode: not "
        f"{', '.join(low)}.",
        f"Table 4: the mean of the printed rows is {motion:.1f} % of modes (printed: {PAPER_MEANS_PERCENT[0]}) and "
        f"{steps:.1f} % of steps (printed: {PAPER_MEANS_PERCENT[1]}). The same walks have {both:.0f} % in Table 3, "
        "whose two modes are equally long.",
        f"Section 8.1.1: 6 % of a walk of 10 minutes are {lost:.0f} s, {2 * lost:.0f} steps at two a second "
        f"({lost:.0f} cycles, as printed) and {1.2 * lost:.1f} m of {1.2 * 600:.0f} m: 6.0 % of the distance, not 7.2 "
        "%.",
        'The ten people of section 8.2 are "five women and five women"; Table 4 has five men and five women.',
    )
