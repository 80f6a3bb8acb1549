"""Least-squares rotation and shift between two sets of points."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray


def rigid_fit(a_m: FloatArray, b_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation R and shift t so that a R^T + t is closest to b in the least-squares sense.

    The transformation has no scale and no reflection.

    Parameters
    ----------
    a_m, b_m : ndarray, shape (N, 2)
        Points to transform, and target points, m.

    Returns
    -------
    tuple of ndarray, shape (2, 2) and (2,)
        Rotation matrix R, and shift t, m.

    Notes
    -----
    From the SVD of sum (a_i - a)(b_i - b)^T (Kabsch, Acta Cryst. A32, 1976). The last singular vector is negated if the
    result would be a reflection (Umeyama, IEEE Trans. Pattern Anal. Mach. Intell. 13, 1991, eq. 40 and 41 with c = 1).

    Examples
    --------
    >>> import numpy as np
    >>> from pdr_filter.values.rigid_fit import rigid_fit
    >>> a_m = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]])
    >>> quarter_turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    >>> rotation, shift = rigid_fit(a_m, a_m @ quarter_turn.T + [3.0, 4.0])
    >>> bool(np.allclose(rotation, quarter_turn)), shift.round(6).tolist()
    (True, [3.0, 4.0])
    """
    a, b = a_m.mean(axis=0), b_m.mean(axis=0)
    u, _, vt = np.linalg.svd((a_m - a).T @ (b_m - b))
    rotation = (u @ np.diag([1, np.sign(np.linalg.det(u @ vt))]) @ vt).T
    return rotation, b - rotation @ a
