"""What Guo et al. 2018 prints, and what the printed numbers say against each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pdr_filter.evaluate.classification import accuracy, kappa
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.values import FloatArray, IntArray

# --- what is printed ------------------------------------------------------------------------------------------------

POSES = ("texting", "swinging", "pocket", "calling")  # order of Tables 3, 5 and 8
SIDED = ("T", "S(L)", "S(R)", "P(L)", "P(R)", "C(L)", "C(R)")  # Table 4
POSE_OF_SIDED = (0, 1, 1, 2, 2, 3, 3)
PAPER_CONFUSION = np.array([[1219, 2, 8, 0], [2, 1031, 5, 1], [3, 3, 1018, 16], [4, 5, 2, 1101]])
PAPER_SIDED = np.array(
    [
        [1219, 0, 2, 0, 8, 0, 0],
        [0, 58, 0, 0, 0, 0, 0],
        [2, 0, 973, 2, 3, 1, 0],
        [0, 0, 0, 208, 16, 2, 4],
        [3, 0, 3, 10, 784, 2, 8],
        [2, 0, 1, 0, 1, 119, 3],
        [2, 2, 2, 0, 1, 0, 979],
    ]
)
PAPER_SCORES = {"accuracy %": 98.85, "kappa %": 98.46, "mean precision %": 98.833, "mean recall %": 98.828}
PAPER_SIDED_SCORES = {"accuracy %": 98.19, "kappa %": 97.70}
# Table 5: true and estimated steps of S1 to S12, by pose.
PAPER_STEPS: Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
    "texting": (
        (128, 113, 118, 103, 119, 126, 126, 106, 116, 102, 110, 121),
        (128, 115, 119, 103, 118, 126, 125, 108, 116, 103, 110, 120),
    ),
    "swinging": (
        (124, 112, 116, 102, 111, 121, 117, 101, 108, 103, 103, 114),
        (123, 112, 115, 101, 112, 117, 116, 115, 109, 107, 106, 108),
    ),
    "pocket": (
        (121, 112, 117, 100, 109, 123, 126, 106, 107, 102, 106, 109),
        (124, 112, 115, 102, 103, 117, 127, 106, 109, 104, 108, 113),
    ),
    "calling": (
        (125, 114, 115, 102, 121, 122, 122, 104, 111, 103, 108, 116),
        (126, 115, 115, 103, 117, 123, 119, 105, 112, 104, 108, 113),
    ),
}
PAPER_COUNTED_PERCENT = {"texting": 99.78, "swinging": 99.32, "pocket": 99.85, "calling": 99.78}
# Table 7: absolute error in per cent and deviation in m of 80 m, by pose in this order, and the average error.
TABLE_7 = ("texting", "calling", "pocket", "swinging")
MODELS = ("static", "Weinberg", "Tian", "Kim", "Chen")
PAPER_ERROR_PERCENT = {
    "static": (11.42, 19.26, 14.54, 30.82),
    "Weinberg": (11.49, 9.36, 11.15, 14.68),
    "Tian": (12.60, 9.89, 9.89, 10.24),
    "Kim": (19.26, 11.42, 10.69, 17.05),
    "Chen": (3.14, 3.66, 4.81, 6.99),
}
PAPER_STD_M = {
    "static": (5.11, 7.12, 11.72, 16.09),
    "Weinberg": (5.62, 5.34, 6.74, 11.87),
    "Tian": (5.57, 5.35, 7.50, 8.07),
    "Kim": (7.12, 5.11, 6.59, 17.52),
    "Chen": (2.91, 3.40, 5.07, 9.18),
}
PAPER_AVERAGE_PERCENT = {"static": 19.01, "Weinberg": 11.67, "Tian": 10.66, "Kim": 14.61, "Chen": 4.65}
# Table 8, m/s: truth of S1 to S12 (of texting; the other columns have 1.17 for S7) and estimates by column.
PAPER_TRUE_MPS = (1.12, 1.34, 1.24, 1.43, 1.32, 1.21, 1.16, 1.48, 1.36, 1.37, 1.49, 1.31)
_TRUE_OF_S7_MPS = 1.17
PAPER_SPEED_MPS: Mapping[str, tuple[float, ...]] = {
    "texting": (1.14, 1.38, 1.21, 1.40, 1.41, 1.30, 1.17, 1.42, 1.38, 1.35, 1.55, 1.33),
    "swinging": (1.15, 1.32, 1.18, 1.40, 1.44, 1.18, 1.10, 1.44, 1.32, 1.33, 1.55, 1.27),
    "pocket": (1.16, 1.36, 1.23, 1.38, 1.27, 1.29, 1.28, 1.52, 1.18, 1.25, 1.53, 1.29),
    "calling": (1.18, 1.24, 1.26, 1.38, 1.38, 1.27, 1.11, 1.59, 1.38, 1.88, 1.52, 1.26),
}
STATISTICS = ("mean", "std", "variance", "max", "95th", "median", "min")
PAPER_SPEED_ERROR_MPS = {  # Table 9
    "texting": (0.042, 0.028, 0.001, 0.090, 0.089, 0.031, 0.006),
    "calling": (0.048, 0.028, 0.001, 0.122, 0.068, 0.039, 0.022),
    "pocket": (0.063, 0.051, 0.003, 0.176, 0.126, 0.046, 0.013),
    "swinging": (0.094, 0.133, 0.018, 0.507, 0.110, 0.058, 0.015),
    "average": (0.061, 0.074, 0.005, 0.507, 0.121, 0.043, 0.006),
}


def errors_of_table_8() -> dict[str, FloatArray]:
    """Absolute errors of the printed speeds (12,) by column of Table 8, m/s."""
    true = np.array(PAPER_TRUE_MPS)
    of_others = np.where(np.arange(len(true)) == 6, _TRUE_OF_S7_MPS, true)
    return {
        pose: np.abs(np.array(found) - (true if pose == "texting" else of_others))
        for pose, found in PAPER_SPEED_MPS.items()
    }


def merged_sides() -> IntArray:
    """Table 4 with left and right together, (4, 4)."""
    pose = np.array(POSE_OF_SIDED)
    merged = np.zeros((4, 4), dtype=np.int64)
    np.add.at(merged, (pose[:, None], pose[None, :]), PAPER_SIDED)
    return merged


def static_bound_percent() -> float:
    """Largest error that the static model can have while swinging, given that of texting and the counts of Table 5.

    Its distance is k h n: |k h n_S / d - 1| <= |k h n_T / d - 1| + (k h n_T / d) |n_S / n_T - 1|, on average over the
    people, with k h n_T / d <= 1 + |k h n_T / d - 1|; the products are bounded by the largest ratio of counts.
    """
    texting, swinging = (np.array(PAPER_STEPS[pose][1]) for pose in ("texting", "swinging"))
    error = PAPER_ERROR_PERCENT["static"][0] / 100.0
    change = np.abs(swinging / texting - 1.0)
    return 100.0 * float(error + change.mean() + error * change.max())


def paper_notes() -> tuple[str, ...]:
    """What Tables 3 to 9 say against each other, worked out from the printed numbers."""
    walk_by_walk = {
        pose: float(np.abs(count_error_percent(np.array(n), np.array(true))).mean())
        for pose, (true, n) in PAPER_STEPS.items()
    }
    of_table_8 = {pose: float(e.mean()) for pose, e in errors_of_table_8().items()}
    same = np.array_equal(merged_sides(), PAPER_CONFUSION)
    return (
        f"Table 3 gives its accuracy and kappa: {100 * accuracy(PAPER_CONFUSION):.2f} and "
        f"{100 * kappa(PAPER_CONFUSION):.2f} %; Table 4 {100 * accuracy(PAPER_SIDED):.2f} and "
        f"{100 * kappa(PAPER_SIDED):.2f} %, as printed in it. The text gives the numbers of Table 3 for Table 4.",
        f"Table 4 with left and right together is Table 3 {'to the last window' if same else 'nearly'}: one forest of "
        'seven classes was tested once (the caption of Table 3 says "seven categories").',
        "Step accuracy of 99.68 % is of totals over people, where errors cancel. Walk by walk Table 5 gives mean "
        f"absolute errors of {', '.join(f'{v:.2f} % ({pose})' for pose, v in walk_by_walk.items())}.",
        "Table 9 gives 0.048 m/s for calling and 0.094 m/s for swinging; the columns of Table 8 give "
        f"{of_table_8['calling']:.3f} and {of_table_8['swinging']:.3f}: exchanged in one of the two. The largest "
        "error, 0.507, is S10 with 1.88 m/s under calling in Table 8. The other columns agree "
        f"({of_table_8['texting']:.3f} and {of_table_8['pocket']:.3f}).",
        f"The mean over all of Table 8 is {np.mean(list(of_table_8.values())):.4f} m/s (printed: 0.061).",
        "Table 7: error and deviation of Kim's model for texting and calling (19.26 %, 7.12 m; 11.42 %, 5.11 m) are "
        "those of the static model for calling and texting, to the last digit: one of the two pairs is a copy.",
        "The static model depends on the count of steps alone. With the counts of Table 5 and 11.42 % for texting it "
        f"can have at most {static_bound_percent():.1f} % for swinging on the same way; Table 7 has 30.82 %.",
        "Each average of Table 7 is the mean of its four poses. The introduction counts 61 men and 38 women, section "
        "3.1 63 and 38.",
    )
