"""Points turned and moved onto others."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray


def rigid_fit(a_m: FloatArray, b_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation R (2, 2) and shift t (2,) so that a R^T + t fits b best, both (N, 2); no scale, no mirror.

    Least squares by the SVD of sum (a_i - a)(b_i - b)^T, the last singular vector turned round where it would mirror
    (Kabsch, Acta Cryst. A32, 1976; Umeyama 1991, eq. 40 and 41 with c = 1).
    """
    a, b = a_m.mean(axis=0), b_m.mean(axis=0)
    u, _, vt = np.linalg.svd((a_m - a).T @ (b_m - b))
    rotation = (u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return rotation, b - rotation @ a
