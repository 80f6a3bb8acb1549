"""Where the stated variance of positions comes from, next to the errors.

usage: python -m tests.benchmarks.error_budget [--data ../shared/data]

Each walk is tracked with all sources, and once for each source as if that one were known, with a thousandth of its
standard deviation. The share of a source is the decrease of the stated variance, summed over the walks of a group, in
the middle of the way and at its end. Sources that act together, as a bias does through the second order, are counted
in each of them, so that shares do not add up to 100 %. Errors are root mean squares after alignment on the first
20 % of the path. No fixes and no locations.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import pdr_filter as pdr
from pdr_filter.filter.pedestrian import pedestrian_state
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.values import HeadingDrift
from tests.benchmarks.common import Tables, run
from tests.benchmarks.placements import REFERENCE_STD_M, Walk, errors_and_cov, walks

SITES = tuple(REFERENCE_STD_M)
KNOWN = 1e-3
Change = Callable[[pdr.Config], pdr.Config]


def heading_of(config: pdr.Config) -> WalkingHeading:
    heading = config.sensing.heading
    assert isinstance(heading, WalkingHeading)
    return heading


def with_heading(**changes: Any) -> Change:
    return lambda config: config.with_heading(replace(heading_of(config), **changes))


def with_corridors(config: pdr.Config, **changes: float) -> pdr.Config:
    return with_heading(corridors=replace(heading_of(config).corridors, **changes))(config)


def with_noise(config: pdr.Config, **changes: Any) -> pdr.Config:
    return config.with_model(noise=replace(config.model.noise, **changes))


def known_bias(config: pdr.Config) -> pdr.Config:
    attitude = config.sensing.attitude
    bias = attitude.bias
    stds = tuple(KNOWN * s * (1 + i) for i, s in enumerate(bias.prior_std_radps))
    bias = replace(bias, prior_std_radps=stds, walk_radps_per_sqrt_s=KNOWN * bias.walk_radps_per_sqrt_s)
    return replace(config, sensing=replace(config.sensing, attitude=replace(attitude, bias=bias)))


def known_drift(config: pdr.Config) -> pdr.Config:
    drift = HeadingDrift(KNOWN * config.model.noise.heading_drift.random_walk_rad_per_sqrt_s)
    heading = replace(heading_of(config), drift=drift)
    model = replace(config.model, noise=replace(config.model.noise, heading_drift=drift))
    tracker = replace(config.tracker, model=model)
    return replace(config, sensing=replace(config.sensing, heading=heading), tracker=tracker)


def known_steps(config: pdr.Config) -> pdr.Config:
    modes = tuple(
        replace(
            mode,
            heading_std_rad=KNOWN * mode.heading_std_rad,
            extra_noise_m=KNOWN * mode.extra_noise_m,
            step_length=replace(mode.step_length, residual_std_m=KNOWN * mode.step_length.residual_std_m),
        )
        for mode in config.model.modes
    )
    return config.with_model(modes=modes)


def known_parameters(config: pdr.Config) -> pdr.Config:
    modes = tuple(
        replace(m, step_length=replace(m.step_length, theta_cov=KNOWN**2 * m.step_length.theta_cov))
        for m in config.model.modes
    )
    return config.with_model(modes=modes)


SOURCES: dict[str, Change] = {
    "gyroscope bias": known_bias,
    "drift": known_drift,
    "gyroscope scale": lambda c: with_corridors(c, scale_std=KNOWN * heading_of(c).corridors.scale_std),
    "first direction": lambda c: with_noise(c, initial_heading_offset_std_rad=KNOWN),
    "walking direction": with_heading(systematic_std_rad=KNOWN, held_systematic_std_rad=KNOWN),
    "steps": known_steps,
    "scale of the person": lambda c: with_noise(c, log_scale_std=KNOWN * c.model.noise.log_scale_std),
    "parameters of lengths": known_parameters,
}
SECOND_ORDER = "second order"


def no_second_order(heading_var_rad2: float, log_scale_var: float) -> tuple[float, float]:
    """What `second_order_errors` would be for a linear model."""
    return 0.0, 0.0


def stated(walk: Walk, config: pdr.Config) -> tuple[np.ndarray, np.ndarray]:
    """Stated variances in m2, and squared errors, in the middle and at the end of a walk."""
    _, error_m, cov, _ = errors_and_cov(walk, pdr.track(walk.recording, config, gnss="off"))
    at = [len(cov) // 2, -1]
    variance_m2 = np.trace(cov[at], axis1=1, axis2=2) - 2 * REFERENCE_STD_M[walk.group.split()[0]] ** 2
    return variance_m2, (error_m[at] ** 2).sum(axis=1)


def budget(tables: Tables, arguments: argparse.Namespace) -> None:
    """Shares of the sources in the stated variance."""
    found: dict[str, list[np.ndarray]] = {}
    second_order_errors = pedestrian_state.second_order_errors
    for i, walk in enumerate(walks(arguments.data, SITES)):
        if i % arguments.every or "trolley" in walk.group:
            continue
        config = pdr.recipes.default(walk.recording.subject)
        if pdr.track(walk.recording, config, gnss="off").n_steps < 10:
            continue
        all_m2, square_m2 = stated(walk, config)
        each = [stated(walk, change(config))[0] for change in SOURCES.values()]
        pedestrian_state.second_order_errors = no_second_order
        each.append(stated(walk, config)[0])
        pedestrian_state.second_order_errors = second_order_errors
        found.setdefault(walk.group, []).append(np.array([square_m2, all_m2, *(all_m2 - m2 for m2 in each)]))
    lines = []
    for group, of in sorted(found.items()):
        mean = np.mean(of, axis=0)
        for where, (square_m2, all_m2, *less_m2) in zip(("middle", "end"), mean.T, strict=True):
            rms = f"{square_m2**0.5:.1f} | {all_m2**0.5:.1f}"
            lines.append([group, len(of), where, *rms.split(" | "), *(f"{100 * m2 / all_m2:.0f}" for m2 in less_m2)])
    columns = ["walks of", "n", "at", "error, m", "stated, m", *(f"{name}, %" for name in (*SOURCES, SECOND_ORDER))]
    tables.write("error_budget", columns, lines)


if __name__ == "__main__":
    run(__doc__, budget, every=1)
