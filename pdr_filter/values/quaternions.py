"""Conversion of unit quaternions (w, x, y, z) to rotation matrices."""

from __future__ import annotations

import numpy as np

from pdr_filter.values.arrays import FloatArray


def rotation_matrix(quat: FloatArray) -> FloatArray:
    """Return the rotation matrices R (..., 3, 3) of unit quaternions (..., 4): a sensor vector v is R v in the world.

    >>> rotation_matrix(np.array([0.5**0.5, 0.0, 0.0, 0.5**0.5])).round(9) @ [1.0, 0.0, 0.0]  # a quarter to the left
    array([0., 1., 0.])
    """
    w, x, y, z = np.moveaxis(quat, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
