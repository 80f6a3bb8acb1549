"""Vectors in the sensor frame as tuples of three floats, because NumPy takes five times as long for a single vector."""

from __future__ import annotations

import math

Vector = tuple[float, float, float]


def dot(a: Vector, b: Vector) -> float:
    """Return the inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Return the cross product of two vectors."""
    (x, y, z), (u, v, w) = a, b
    return (y * w - z * v, z * u - x * w, x * v - y * u)


def linear_sum(p: float, a: Vector, q: float, b: Vector) -> Vector:
    """Return the linear combination p a + q b of two vectors a and b with factors p and q."""
    return (p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2])


def unit(a: Vector) -> Vector:
    """Return the vector scaled to length 1."""
    x, y, z = a
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


def across(axis: Vector, up: Vector) -> Vector:
    """Return the unit vector of the part of an axis that is perpendicular to up."""
    return unit(linear_sum(1.0, axis, -dot(axis, up), up))
