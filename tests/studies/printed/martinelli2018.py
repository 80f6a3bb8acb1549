"""What Martinelli et al. 2018 prints, and what the printed numbers say against each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdr_filter.evaluate.distance import distance_scores

if TYPE_CHECKING:
    pass

PAPER = (
    'A. Martinelli, H. Gao, P. D. Groves, S. Morosi, "Probabilistic Context-Aware Step Length Estimation for '
    'Pedestrian Dead Reckoning", IEEE Sensors Journal 18(4), pp. 1600-1611, 2018.'
)

# --- What is printed -------------------------------------------------------------------------------------------------

# Table III, per cent, rows and columns in the order of `CONTEXTS` (the paper has sideways third).
TABLE_III = np.array(
    [
        [93.7, 0.9, 0.5, 0.0, 4.9, 0.0],
        [0.0, 85.2, 9.0, 1.0, 4.8, 0.0],
        [0.0, 9.8, 82.5, 4.3, 3.4, 0.0],
        [0.0, 1.0, 3.0, 95.2, 0.8, 0.0],
        [0.0, 6.0, 2.2, 1.8, 90.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 100.0],
    ]
)
ACCURACY = 91.1
# Table IV: %RMSE with HC and WC of subjects 1-5, 6-10, 11-15, and of all.
TABLE_IV = {"hc": (4.5, 6.2, 11.5, 7.9), "wc": (5.7, 5.9, 3.6, 5.2)}
# Table V: %error of subjects 1 to 15.
TABLE_V = {
    "hc": (0.6, -3.3, -5.7, -3.0, -6.9, -7.8, -3.6, -6.0, -4.5, -7.5, -13.6, -13.5, -7.8, -7.5, -13.1),
    "wc": (5.1, 1.2, 4.5, -3.3, -10.3, -9.0, 0.0, -7.5, -0.3, -6.0, -3.0, -3.9, 1.8, 1.2, -6.1),
}
# Table VI: length in m, %error with HC and with WC.
TABLE_VI = {
    "walking": (209.9, -8.5, -5.1),
    "upstairs": (20.6, 6.2, 3.4),
    "downstairs": (30.5, -5.5, -4.2),
    "sideways": (20.0, -5.9, -2.5),
    "running": (50.0, -4.8, -3.3),
}
PATH_M = 331.0
# Of single stairs, up and down (section VI.A).
_STAIR_M = (0.29, 0.43)
THRESHOLD = 0.8
SUBGROUPS = tuple(f"subgroup {i} (paper: subjects {n})" for i, n in ((1, "1-5"), (2, "6-10"), (3, "11-15")))


def printed_checks() -> tuple[str, ...]:
    """What the paper's printed figures say against each other, one sentence or two each."""
    table_v = {k: np.array(v) for k, v in TABLE_V.items()}
    found_iv = {k: [distance_scores(part).rmse_percent for part in (*np.split(v, 3), v)] for k, v in table_v.items()}
    largest = max(abs(f - p) for k in found_iv for f, p in zip(found_iv[k], TABLE_IV[k], strict=True))
    length_m, *of_context = np.array(list(TABLE_VI.values())).T
    by_context = {k: float(length_m @ e / length_m.sum()) for k, e in zip(("hc", "wc"), of_context, strict=True)}
    mean = {k: float(v.mean()) for k, v in table_v.items()}
    stairs = [TABLE_VI[c][0] / m for c, m in zip(("upstairs", "downstairs"), _STAIR_M, strict=True)]
    return (
        f"Table V gives Table IV: %RMSE {found_iv['hc'][3]:.2f} (HC) and {found_iv['wc'][3]:.2f} (WC) for the printed "
        f"{TABLE_IV['hc'][3]} and {TABLE_IV['wc'][3]}; the subgroups agree within {largest:.2f}.",
        f"The errors of Table V are biased: mean {mean['hc']:.2f} (HC) and {mean['wc']:.2f} % (WC), spread "
        f"{table_v['hc'].std():.2f} and {table_v['wc'].std():.2f} %. WC's lower %RMSE is its smaller bias; its "
        "spread is the larger one.",
        f"Table VI against Table V: the errors of the contexts, weighted with their lengths, give "
        f"{by_context['hc']:.2f} % (HC) and {by_context['wc']:.2f} % (WC) of the whole path, the mean of Table V is "
        f"{mean['hc']:.2f} and {mean['wc']:.2f} %. That agrees for HC and not for WC.",
        f"The lengths of Table VI add up to {length_m.sum():.1f} m, the length of the path. Its stairs are "
        f"{stairs[0]:.1f} steps of {_STAIR_M[0]} m up and {stairs[1]:.1f} of {_STAIR_M[1]} m down: the same 71.",
        f"The diagonal of Table III has the mean {np.diagonal(TABLE_III).mean():.1f} %, which is the accuracy printed "
        f"({ACCURACY} %), as it must be with as many movements of each context.",
        'The text on the threshold has "true" for HC at 1: the second highest over the highest probability is below 1 '
        "but where the two are equal, and then Algorithm 2 weights.",
    )
