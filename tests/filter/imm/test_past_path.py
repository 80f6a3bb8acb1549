# ruff: noqa: N803, N806 - the letters of the equations are the readable form
"""Past steps related to the present state, compared with the joint Gaussian of all states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pdr_filter.filter.pedestrian.alignment import Alignment
from pdr_filter.filter.pedestrian.past_path import MAX_STEPS, PastPath, WalkedStep
from pdr_filter.values import FloatArray

# Standard deviation of heading offsets, so small that arcs are straight as in a linear smoother.
SCALE = np.array([1.0, 1.0, 1e-3, 0.05])


def random_cov(rng: np.random.Generator, size: float) -> FloatArray:
    root = size * rng.normal(size=(4, 4)) * SCALE[:, None]
    return root @ root.T


def motion(rng: np.random.Generator) -> FloatArray:
    F = np.eye(4)
    F[:2, 2] = rng.normal(size=2) / SCALE[2]
    F[:2, 3] = rng.normal(size=2)
    return F


def a_step(
    time_s: float, mean: FloatArray, cov: FloatArray, F: FloatArray, after: FloatArray, after_cov: FloatArray
) -> WalkedStep:
    """Return a step of one filter without a measurement."""
    before = mean[None], cov[None]
    return WalkedStep(time_s, after, np.ones(1), *before, cov[None], *before, after[None], after_cov[None], F[None])


class Joint:
    """Joint Gaussian of all states of a linear system."""

    def __init__(self, cov: FloatArray) -> None:
        self.mean, self.cov = np.zeros(4), cov

    def predict(self, F: FloatArray, Q: FloatArray, d: FloatArray) -> None:
        last = self.cov[-4:]
        self.mean = np.append(self.mean, F @ self.mean[-4:] + d)
        self.cov = np.block([[self.cov, last.T @ F.T], [F @ last, F @ last[:, -4:] @ F.T + Q]])

    def update(self, z: FloatArray, var: float) -> None:
        H = np.eye(2, 4) @ np.eye(4, len(self.mean), len(self.mean) - 4)
        K = self.cov @ H.T @ np.linalg.inv(H @ self.cov @ H.T + var * np.eye(2))
        self.mean, self.cov = self.mean + K @ (z - H @ self.mean), self.cov - K @ H @ self.cov


def walked(n: int, measured_at: tuple[int, ...]) -> tuple[PastPath, Joint]:
    rng = np.random.default_rng(3)
    joint, path = Joint(random_cov(rng, 0.3)), PastPath()
    for k in range(n):
        F, Q, d = motion(rng), random_cov(rng, 0.1), np.array([0.3, 0.6, 0.0, 0.0])
        x, P = joint.mean[-4:], joint.cov[-4:, -4:]
        joint.predict(F, Q, d)
        before = joint.mean[-4:]
        step = a_step(float(k), x, P, F, before, joint.cov[-4:, -4:])
        if k in measured_at:
            joint.update(joint.mean[-4:-2] + rng.normal(size=2), 0.5)
        if k % 2:  # a fix after the step
            path = path.with_event(step).after_correction(joint.mean[-4:] - before, 1.0)
        else:  # evidence that belongs to the step
            path = path.with_event(replace(step, updated_mean=joint.mean[-4:]))
    return path, joint


@pytest.mark.parametrize("n", [40, 150])
def test_past_steps_are_those_of_the_joint_gaussian(n: int) -> None:
    """The steps are within one block, or cover three blocks."""
    path, joint = walked(n, (20, 39, 100, 149))
    time_s, position_m, cov_m2 = path.positions(joint.cov[-4:, -4:], np.zeros((2, 2)), joint.mean[-4:-2])
    np.testing.assert_array_equal(time_s, np.arange(n))
    expected = joint.mean.reshape(-1, 4)[1:]
    np.testing.assert_allclose(position_m.T, expected[:, :2], atol=5e-3)
    own = np.array([joint.cov[4 * k : 4 * k + 2, 4 * k : 4 * k + 2] for k in range(1, n + 1)])
    np.testing.assert_allclose(cov_m2[[0, 1, 1, 2]].T.reshape(-1, 2, 2), own, rtol=5e-3, atol=0.02)


def test_an_alignment_rotates_past_and_present_with_a_shared_error() -> None:
    path, joint = walked(100, (50,))
    alignment = Alignment(2.0, 0.01, np.array([1.0, 2.0]), np.array([30.0, 40.0]), 4.0, 100)
    P, present_m = joint.cov[-4:, -4:], alignment.positions(joint.mean[-4:-2])
    T = np.eye(4)
    T[:2, :2] = alignment.rotation
    lever = present_m - alignment.world_centre_m
    g, shift = np.array([lever[1], -lever[0], 1.0, 0.0]), np.diag([4.0, 4.0, 0.0, 0.0])
    after = T @ P @ T.T + 0.01 * np.outer(g, g) + shift
    before_m = path.positions(P, np.zeros((2, 2)), joint.mean[-4:-2])[1]
    moved = path.with_alignment(alignment, P, after, present_m)
    _, position_m, cov_m2 = moved.positions(after, np.zeros((2, 2)), present_m)
    np.testing.assert_allclose(position_m.T, alignment.positions(before_m.T), atol=1e-9)
    first = alignment.positions(joint.mean[4:6])
    east_m, north_m = first - alignment.world_centre_m
    own = alignment.rotation @ joint.cov[4:6, 4:6] @ alignment.rotation.T
    expected = own + 0.01 * np.outer([north_m, -east_m], [north_m, -east_m]) + 4.0 * np.eye(2)
    np.testing.assert_allclose(cov_m2[:, 0], [expected[0, 0], expected[0, 1], expected[1, 1]], rtol=1e-3, atol=1e-3)
    # correction of the present state in proportion to its covariance with one component
    cross = alignment.rotation @ joint.cov[4:6, -4:] @ T.T + 0.01 * np.outer([north_m, -east_m], g) + shift[:2]
    corrected = moved.after_correction(after[:, 0] / after[0, 0], 1.0)
    by_m = corrected.positions(after, np.zeros((2, 2)), present_m)[1][:, 0] - position_m[:, 0]
    np.testing.assert_allclose(by_m, cross[:, 0] / after[0, 0], rtol=0.05, atol=1e-3)


def test_a_corrected_heading_moves_the_past_along_an_arc() -> None:
    """The heading of a step of 10 m to the north is corrected by a quarter turn at its end."""
    P, origin, end = np.diag([1e-6, 1e-6, 1.0, 1e-6]), np.zeros(4), np.array([0.0, 10.0, 0.0, 0.0])
    path = PastPath().with_event(a_step(0.0, origin, P, np.eye(4), origin, P))
    F = np.eye(4)
    F[0, 2] = 10.0
    path = path.with_event(a_step(1.0, origin, P, F, end, F @ P @ F.T))
    # the end is fixed, and the start moves along a quarter of a circle about it
    path = path.after_correction(np.array([0.0, 0.0, np.pi / 2, 0.0]), 1.0)
    _, position_m, _ = path.positions(P, np.zeros((2, 2)), np.zeros(2))
    np.testing.assert_allclose(position_m.T, [[-10.0, 10.0], [0.0, 10.0]], atol=0.15)


def test_a_detached_path_is_not_corrected() -> None:
    path, joint = walked(100, ())
    P = joint.cov[-4:, -4:]
    fixed = path.without_past(P, 99.0, joint.mean[-4:-2])
    before = path.positions(P, np.zeros((2, 2)), np.zeros(2))
    alignment = Alignment(1.0, 0.1, np.zeros(2), np.zeros(2), 1.0, 0)
    moved = fixed.after_correction(np.ones(4), 1.0).with_alignment(alignment, P, P, np.zeros(2))
    after = moved.positions(P, np.zeros((2, 2)), np.zeros(2))
    for a, b in zip(before, after, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_a_late_fix_scales_the_errors_of_all_steps_before_it() -> None:
    path, joint = walked(50, ())
    P = joint.cov[-4:, -4:]
    before = path.positions(P, np.zeros((2, 2)), np.zeros(2))[2]
    scaled = path.after_correction(np.zeros(4), 3.0)
    for later in (scaled, scaled.related_to_present()):
        after = later.positions(3.0 * P, np.zeros((2, 2)), np.zeros(2))[2]
        np.testing.assert_allclose(after, 3.0 * before, rtol=1e-7)


def test_memory_is_bounded_and_the_past_is_thinned_evenly() -> None:
    path, P = PastPath(), np.eye(4)
    for k in range(3 * MAX_STEPS // 2):
        place = np.array([0.0, float(k), 0.0, 0.0])
        path = path.with_event(a_step(float(k), place, P, np.eye(4), place, 1.001 * P))
    time_s, position_m, _ = path.positions(P, np.zeros((2, 2)), np.zeros(2))
    assert len(time_s) <= MAX_STEPS + 64
    assert len(time_s) > 0.6 * MAX_STEPS
    assert time_s[0] == 0.0
    assert time_s[-1] == 3 * MAX_STEPS // 2 - 1
    assert set(np.diff(time_s)[-2000:]) == {1.0}
    assert np.diff(time_s).max() <= 16.0
    np.testing.assert_allclose(position_m[1], time_s)
