"""Fit k0 + k1 f + k2 sigma^2 of walking to legs of known displacement: where the default's numbers come from.

usage: .venv/bin/python tests/benchmarks/fit_step_length.py [--data ../shared/data]

A leg is a stretch between two landmarks (humolire: truth_segments, straight legs; ms_indoor: consecutive waypoints more
than 4 m apart). Its predicted displacement is the length of the sum of its step vectors, so that a curved leg is not
taken for a long one. Prints the fit to both sites, and for each site the error of the fit to the other.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

import pdr_filter as pdr
from pdr_filter.step_length import FrequencyVarianceStepLength
from pdr_filter.types import Step

FloatArray = NDArray[np.float64]
MODEL = FrequencyVarianceStepLength(max_variance=8.0)
# k1: a person who walks one step a second faster makes steps about 0.3 m longer (walk ratio 0.006 m per step a minute);
# k2: no effect of the variance beyond that is expected. k0 is free within reason.
PRIOR_MEAN = np.array([0.2, 0.3, 0.0])
PRIOR_STD = np.array([0.3, 0.05, 0.003])
LEG_STD = 0.10  # of a leg's displacement, relative


@dataclass(frozen=True)
class Leg:
    """Regressors and headings of the steps between two landmarks, and how far these are apart."""

    site: str
    walk: str
    distance_m: float
    regressors: FloatArray  # (n, 3), scaled by the part of the step that is inside
    heading_rad: FloatArray  # (n,)

    def displacement_m(self, theta: FloatArray) -> float:
        """Length of the sum of the step vectors."""
        length = self.regressors @ theta
        return float(np.hypot((length * np.sin(self.heading_rad)).sum(), (length * np.cos(self.heading_rad)).sum()))


def legs_of(path: Path) -> list[Leg]:
    """Legs of one recording with at least four steps."""
    recording = pdr.read(path)
    site = str(recording.meta["dataset"])
    table = pdr.detect_steps(recording)
    steps = [Step(**{name: row[name] for name in table.dtype.names}) for row in table]
    legs: list[Leg] = []
    for start_s, end_s, distance_m in stretches(recording, site):
        inside = np.array(
            [
                np.clip((min(s.time_s, end_s) - max(s.time_s - s.duration_s, start_s)) / s.duration_s, 0, 1)
                for s in steps
            ]
        )
        used = np.flatnonzero(inside > 0)
        if inside.sum() < 4:
            continue
        regressors = np.array([MODEL.regressors(steps[i]) * inside[i] for i in used])
        heading = np.array([steps[i].device_heading_rad for i in used])
        legs.append(Leg(site, recording.name, distance_m, regressors, heading))
    return legs


def stretches(recording: pdr.Recording, site: str) -> list[tuple[float, float, float]]:
    """Start, end and length of the stretches between landmarks."""
    if site == "humolire":
        segments = recording.truth.segments
        return [(float(s["start_s"]), float(s["end_s"]), float(s["distance_m"])) for s in segments]
    points = recording.truth.waypoints
    distance = np.hypot(np.diff(points.east_m), np.diff(points.north_m))
    pairs = zip(points.time_s[:-1], points.time_s[1:], distance, strict=True)
    return [(float(a), float(b), float(d)) for a, b, d in pairs if d > 4.0]


def fit(legs: list[Leg]) -> tuple[FloatArray, FloatArray]:
    """Theta (3,) and its covariance (3, 3); sites weigh alike, outlying legs little (soft L1)."""
    count = {site: sum(leg.site == site for leg in legs) for site in {leg.site for leg in legs}}
    weight = np.array([1.0 / (LEG_STD * np.sqrt(count[leg.site] / 50)) for leg in legs])

    def residuals(theta: FloatArray) -> FloatArray:
        relative = np.array([leg.displacement_m(theta) / leg.distance_m - 1 for leg in legs])
        return np.concatenate([weight * relative, (theta - PRIOR_MEAN) / PRIOR_STD])

    result = least_squares(residuals, PRIOR_MEAN, loss="soft_l1")
    return result.x, np.linalg.inv(result.jac.T @ result.jac)


def report(theta: FloatArray, legs: list[Leg]) -> str:
    """Errors of walks (sum over their legs) and of legs, in per cent."""
    sums: dict[str, list[float]] = defaultdict(lambda: [0.0, 0.0])
    for leg in legs:
        sums[leg.walk][0] += leg.displacement_m(theta)
        sums[leg.walk][1] += leg.distance_m
    walk = np.array([100 * (p / d - 1) for p, d in sums.values()])
    one = np.array([100 * (leg.displacement_m(theta) / leg.distance_m - 1) for leg in legs])
    return (
        f"{len(walk)} walks: bias {walk.mean():+.1f} %, spread {walk.std():.1f} %, "
        f"RMS {np.sqrt((walk**2).mean()):.1f} %; "
        f"{len(one)} legs: median {np.median(one):+.1f} %, MAD {np.median(np.abs(one - np.median(one))):.1f} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[3] / "shared" / "data")
    data = parser.parse_args().data
    legs = {
        site: [leg for p in sorted((data / site).glob("*.zip")) for leg in legs_of(p)]
        for site in ("humolire", "ms_indoor")
    }
    theta, cov = fit(legs["humolire"] + legs["ms_indoor"])
    print(f"both sites: theta {theta.round(4).tolist()}, covariance {cov.tolist()}")
    for site, own in legs.items():
        print(f"  in sample, {site}: {report(theta, own)}")
    for site, own in legs.items():
        other = next(s for s in legs if s != site)
        theta_other, _ = fit(legs[other])
        print(f"fitted on {other} {theta_other.round(4).tolist()}, scored on {site}: {report(theta_other, own)}")


if __name__ == "__main__":
    main()
