"""Vectors in the sensor frame as three plain numbers: for one of them NumPy takes five times as long."""

from __future__ import annotations

import math

Vector = tuple[float, float, float]


def dot(a: Vector, b: Vector) -> float:
    """Inner product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product."""
    (x, y, z), (u, v, w) = a, b
    return (y * w - z * v, z * u - x * w, x * v - y * u)


def combined(p: float, a: Vector, q: float, b: Vector) -> Vector:
    """The sum of p a and q b."""
    return (p * a[0] + q * b[0], p * a[1] + q * b[1], p * a[2] + q * b[2])


def unit(a: Vector) -> Vector:
    """The vector with length 1."""
    x, y, z = a
    length = math.sqrt(x * x + y * y + z * z)
    return (x / length, y / length, z / length)


def across(axis: Vector, up: Vector) -> Vector:
    """Unit vector: the part of an axis across up."""
    return unit(combined(1.0, axis, -dot(axis, up), up))
