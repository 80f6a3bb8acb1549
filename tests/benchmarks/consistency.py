# ruff: noqa: N806 - the letters of the equations
"""Covariance of the filter against its errors, on simulated and on real walks.

usage: python -m tests.benchmarks.consistency [simulated] [demo] [real] [--seeds 100] [--most 12]
           [--data ../shared/data]

simulated: walks of mixed contexts, as `Step`s, `WindowContext`s and `PositionFix`es, are drawn from what the default
recipe's tracker assumes: contexts by its transitions, lengths by each mode's fit, the person's scale and the heading's
drift by `MotionNoise`. The classifier is a linear one on Gaussian features, so that its probabilities are calibrated.
NEES is of the position (2 degrees of freedom) and of the whole state (4), ten times in a walk of 300 steps, NIS of a
fix of 3 m every 60 steps. The bounds are those of a chi-square mean over the walks; that of the NIS is over all
fixes. Rows below "the filter's own model" leave it, by what their names say.

demo: the demonstration walk with 100 seeds, each with another person, phone and building, by the default recipe. The
frame of the track begins at the start with the first heading, which is true north of the simulation. Aligned, the truth
is rotated and shifted onto the first 20 % of the track, which then do not count. The lower rows leave out one source of
the differences between walks. They are online tracks of a third of the seeds.

real: NEES and log score (minus the log density of the true position, in nats per position; lower is better) of walks
that no number of the covariance was chosen on, apart from humolire and ms_indoor. Without fixes the truth is rotated
and shifted onto the first 20 % of the track, as in `placements`. With fixes, every third waypoint is a fix, or the
continuous reference every 20 s, with the standard deviation of the reference. The positions between are held out, from
the second fix on, and are not aligned. Walks over several storeys are left out. A set of twice `--most` walks or
more is thinned to about `--most`, evenly spread over its list.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.evaluate import mean_bounds
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import reckoned_position
from pdr_filter.filter.step_length.models import length_and_jacobian
from pdr_filter.simulate import walk as demo_walks
from pdr_filter.values import (
    CONTEXTS,
    FloatArray,
    IntArray,
    PositionFix,
    Step,
    WindowContext,
    interpolated_rows,
)
from tests.benchmarks.common import MOST, Tables, run, say
from tests.benchmarks.placements import REFERENCE_STD_M, Walk, errors_and_cov, walks
from tests.benchmarks.smoothed_places import is_on_one_storey
from tests.helpers import a_step as made_step

EVEN_PRIOR = np.full(len(CONTEXTS), 1 / len(CONTEXTS))
# Features of the simulated classifier: a unit vector for each context, this long, in unit noise. Of even contexts it
# classifies 87 % of the windows correctly; the shipped model gets 86 to 97 % of people left out.
SEPARATION = 2.5
# Standard deviations of references; a surveyed point of ipin2023 is pressed within half a step.
STD_M = REFERENCE_STD_M | {"ipin2023": 0.5}
Estimate = Callable[[pdr.Recording, pdr.Config, list[PositionFix]], pdr.Track]
LATENCY_S = 0.7  # from a contact to its step, where windows overlap


def own_model(context: str | None = None) -> PedestrianModel:
    """The default recipe's model with evidence that means what it says; of one known context if one is named.

    Evidence is not tempered, the prior divided out whole, and a detected step says nothing: windows of the simulated
    classifier do not overlap, and steps are drawn in every context alike.
    """
    model = replace(
        pdr.recipes.default().model,
        evidence_exponent=1.0,
        prior_exponent=1.0,
        evidence_floor=1e-12,
        step_log_odds_stationary=0.0,
    )
    if context is None:
        return model
    return replace(model, modes=tuple(m for m in model.modes if m.context == context), transition_prob=np.ones((1, 1)))


@dataclass(frozen=True)
class DrawnWalk:
    """Steps, what the classifier said, and the truth after each step."""

    steps: list[Step]
    windows: list[WindowContext]
    state: FloatArray  # (K, 4) of the filter's states
    modes: FloatArray  # (K,)


def a_step(
    k: int, time_s: float, rng: np.random.Generator, frequency_hz: float, heading_rad: float, latency_s: float = 0.0
) -> Step:
    """A step with the features that the default's models need."""
    amplitude = 2.5 * np.exp(0.1 * rng.normal())
    return replace(
        made_step(time_s, heading_rad=heading_rad, duration_s=1 / frequency_hz),
        detected_time_s=time_s + latency_s,
        vertical_amplitude_mps2=amplitude,
        usual_amplitude_mps2=2.5,
        from_rest=k == 0,
    )


def root(cov: FloatArray) -> FloatArray:
    """A with A A' = cov, which may be singular."""
    values, vectors = np.linalg.eigh(cov)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def simulated_walk(
    model: PedestrianModel, n_steps: int, rng: np.random.Generator, *, redrawn: bool = False, overlapping: bool = False
) -> DrawnWalk:
    """A walk of the model.

    Parameters
    ----------
    redrawn
        The parameters of each length model are drawn at every step, not once a person, as the filter has it.
    overlapping
        Windows of 2 s end every second, so that neighbours share half of their noise; else every second step has one
        of its own.
    """
    noise, modes = model.noise, model.modes
    offset = noise.initial_heading_offset_std_rad * rng.normal()
    scale = noise.log_scale_std * rng.normal()
    fits = [m.step_length for m in modes]
    roots = [root(f.theta_cov) for f in fits]
    off = [r @ rng.normal(size=len(r)) for r in roots]
    into = np.cumsum(model.transition_prob, axis=1)
    mode = int(np.searchsorted(np.cumsum(model.long_run_mode_prob), rng.random()))
    cadence_hz, heading_rad, time_s = rng.uniform(1.7, 2.1), 0.0, 0.0
    position_m = np.zeros(2)
    steps, states, chosen = [], [], []
    for k in range(n_steps):
        mode = min(int(np.searchsorted(into[mode], rng.random(), side="right")), len(modes) - 1)
        heading_rad += 0.03 * rng.normal() + (rng.choice([-1, 1]) * np.pi / 2 if rng.random() < 0.05 else 0.0)
        frequency_hz = cadence_hz * (1 + 0.04 * rng.normal())
        time_s += 1 / frequency_hz
        step = a_step(k, time_s, rng, frequency_hz, heading_rad, LATENCY_S if overlapping else 0.0)
        steps.append(step)
        chosen.append(mode)
        fit = fits[mode]
        if redrawn:
            off[mode] = roots[mode] @ rng.normal(size=len(fit.theta))
        length_m, jacobian = length_and_jacobian(fit.model, step, fit.theta)
        length_m = max(float(length_m), 0.0) + float(jacobian @ off[mode]) + fit.residual_std_m * rng.normal()
        psi = heading_rad + offset + modes[mode].heading_offset_rad + modes[mode].heading_std_rad * rng.normal()
        position_m = position_m + length_m * np.exp(scale) * np.array([np.sin(psi), np.cos(psi)])
        offset += noise.heading_drift.random_walk_rad_per_sqrt_s * np.sqrt(step.duration_s) * rng.normal()
        scale = noise.log_scale_memory * scale + np.sqrt(noise.log_scale_drift_var) * rng.normal()
        states.append([*position_m, offset, scale])
    contexts = np.array([CONTEXTS.index(modes[m].context) for m in chosen])
    windows = said_of(contexts, np.array([s.time_s for s in steps]), rng, overlapping)
    return DrawnWalk(steps, windows, np.array(states), np.array(chosen))


def said_of(contexts: IntArray, time_s: FloatArray, rng: np.random.Generator, overlapping: bool) -> list[WindowContext]:
    """What a calibrated classifier says: p ~ prior exp(s z_c), z ~ N(s e_c, I), s the separation."""
    if overlapping:
        ends_s = np.arange(2.0, time_s[-1] + 1.0)
        shared = rng.normal(size=(len(ends_s) + 1, len(CONTEXTS)))
        features = (shared[1:] + shared[:-1]) / np.sqrt(2)
        contexts = contexts[np.minimum(np.searchsorted(time_s, ends_s - 1.0), len(time_s) - 1)]
    else:
        ends_s, contexts = time_s[::2], contexts[::2]
        features = rng.normal(size=(len(ends_s), len(CONTEXTS)))
    features[np.arange(len(contexts)), contexts] += SEPARATION
    prob = np.exp(SEPARATION * (features - features.max(axis=1, keepdims=True)))
    prob /= prob.sum(axis=1, keepdims=True)
    return [WindowContext(float(t), p, EVEN_PRIOR) for t, p in zip(ends_s, prob, strict=True)]


@dataclass(frozen=True)
class Errors:
    """Normalised errors squared of walks."""

    position: FloatArray  # (N, T)
    position_linear: FloatArray  # (N, T) without the consider covariance
    state: FloatArray  # (N, T)
    fixes: FloatArray  # (N, F) normalised innovations squared
    right: FloatArray  # (N,) share of steps whose most probable mode is the true one
    rejected: int


def normalised(error: FloatArray, cov: FloatArray) -> float:
    return float(error @ np.linalg.solve(cov, error))


def filtered_errors(
    model: PedestrianModel,
    walk: DrawnWalk,
    rng: np.random.Generator,
    check_every: int,
    fix_every: int,
    fix_std_m: float,
    late_s: float = 0.0,
) -> tuple[list[tuple[float, float, float]], list[float], float, int]:
    """NEES (position, without shared errors, state) at the checks, NIS of fixes, share of right modes, rejections.

    A check comes before the fix of its step. A late fix is of a time before, and its NIS is left out.
    """
    tracker = ImmTracker(model)
    state, found, nis, right, rejected = tracker.init(), [], [], 0, 0
    windows = list(walk.windows)
    times = np.array([s.time_s for s in walk.steps])
    for k, step in enumerate(walk.steps):
        while windows and windows[0].time_s <= step.detected_time_s:
            state, _ = tracker.on_window(state, windows.pop(0))
        state, updates = tracker.on_step(state, step)
        known = state.pedestrian
        right += int(updates[-1].mode_prob.argmax() == walk.modes[k])
        if (k + 1) % check_every == 0:
            x, P = known.estimates.combined
            error = walk.state[k] - x
            seen = P.copy()
            seen[:2, :2] = reckoned_position(known)[1]
            found.append(
                (normalised(error[:2], seen[:2, :2]), normalised(error[:2], P[:2, :2]), normalised(error, seen))
            )
        if fix_every and (k + 1) % fix_every == 0:
            of_s = step.time_s - late_s
            truth_m = np.array([np.interp(of_s, times, walk.state[:, i]) for i in (0, 1)])
            fix = PositionFix(of_s, truth_m + fix_std_m * rng.normal(size=2), fix_std_m**2 * np.eye(2), step.time_s)
            position_m, cov_m2 = reckoned_position(known)
            if late_s == 0:
                nis.append(normalised(fix.position_m - position_m, cov_m2 + fix.cov_m2))
            state, outcome, _ = tracker.on_fix(state, fix)
            rejected += outcome == "rejected"
    return found, nis, right / len(walk.steps), rejected


def errors_of_walks(
    drawn_from: PedestrianModel,
    model: PedestrianModel,
    n_walks: int,
    n_steps: int,
    *,
    seed: int = 1,
    check_every: int = 30,
    fix_every: int = 60,
    fix_std_m: float = 3.0,
    late_s: float = 0.0,
    redrawn: bool = False,
    overlapping: bool = False,
) -> Errors:
    """Errors of the IMM of a model on walks drawn from another (or the same) one."""
    nees, nis, right, rejected = [], [], [], 0
    for n in range(n_walks):
        rng = np.random.default_rng([seed, n])
        walk = simulated_walk(drawn_from, n_steps, rng, redrawn=redrawn, overlapping=overlapping)
        found, of_fixes, share, lost = filtered_errors(model, walk, rng, check_every, fix_every, fix_std_m, late_s)
        nees.append(found)
        nis.append(of_fixes)
        right.append(share)
        rejected += lost
    a = np.array(nees)
    return Errors(a[..., 0], a[..., 1], a[..., 2], np.array(nis), np.array(right), rejected)


def line(name: str, errors: Errors) -> list[str]:
    """One row of the table: mean, checks inside the bounds, for each of the errors."""
    n, cells = len(errors.position), []
    for values, dof in ((errors.position, 2), (errors.position_linear, 2), (errors.state, 4)):
        low, high = mean_bounds(dof, n)
        mean = values.mean(axis=0)
        inside = int(((mean >= low) & (mean <= high)).sum())
        cells.append(f"{mean.mean():.2f} ({mean.min():.2f} to {mean.max():.2f}), {inside}")
    nis = "-"
    if errors.fixes.size:
        # the NIS of a mixture has the mean of the chi-square distribution, and longer tails
        low, high = mean_bounds(2, errors.fixes.size)
        sampled = 1.96 * errors.fixes.mean(axis=1).std(ddof=1) / np.sqrt(n)
        nis = f"{errors.fixes.mean():.2f} ± {sampled:.2f} ({low:.2f} to {high:.2f})"
    return [name, *cells, nis, str(errors.rejected), f"{errors.right.mean():.2f}"]


def simulated(tables: Tables, arguments: argparse.Namespace) -> None:
    """Row by row further from the model."""
    exact, shipped = own_model(), pdr.recipes.default().model
    tempered = replace(exact, evidence_exponent=0.5, evidence_floor=shipped.evidence_floor)
    walking = own_model("walking")
    detected = np.where([m.context == "stationary" for m in exact.modes], np.exp(shipped.step_log_odds_stationary), 1.0)
    of_detected = exact.transition_prob * detected
    rare = replace(exact, transition_prob=of_detected / of_detected.sum(axis=1, keepdims=True))
    alike = replace(exact, noise=replace(exact.noise, log_scale_std=0.01))
    n_walks = 200
    low2, high2 = mean_bounds(2, n_walks)
    low4, high4 = mean_bounds(4, n_walks)
    about = (
        f"{n_walks} walks of 300 steps, ten checks each: mean (lowest to highest check), checks inside their 95 % "
        f"bounds, which are {low2:.2f} to {high2:.2f} (position) and {low4:.2f} to {high4:.2f} (state)."
    )
    rows = (
        ("walking alone, known", walking, walking, {}),
        ("the same without fixes", walking, walking, {"fix_every": 0}),
        ("mixed contexts, the filter's own model", exact, exact, {}),
        ("no fixes", exact, exact, {"fix_every": 0}),
        ("no fixes, and all people of one scale", alike, alike, {"fix_every": 0}),
        ("fixes 3 s late", exact, exact, {"late_s": 3.0}),
        ("parameters drawn with every step", exact, exact, {"redrawn": True}),
        ("overlapping windows, not tempered", exact, exact, {"overlapping": True}),
        ("overlapping windows, tempered", exact, tempered, {"overlapping": True}),
        ("all shipped settings", exact, shipped, {"overlapping": True}),
        ("all shipped settings, false steps as rare as it takes them", rare, shipped, {"overlapping": True}),
    )
    columns = " | NEES position | without shared errors | NEES state | NIS (bounds) | fixes rejected | right modes"
    found = [
        line(name, errors_of_walks(drawn_from, used, n_walks, 300, **changed))
        for name, drawn_from, used, changed in rows
    ]
    tables.write("consistency_simulated", columns, found, about)


# --- the demonstration walk -------------------------------------------------------------------------------------------


def typical_person(seed: int) -> pdr.simulate.Gait:
    """The typical person with the height of a random one."""
    return pdr.simulate.Gait(height_m=RANDOM_PERSON(seed).height_m)


def exact_gyroscope(seed: int) -> pdr.simulate.SensorErrors:
    """The typical phone without bias and scale error of the gyroscope."""
    errors = pdr.simulate.SensorErrors()
    return replace(errors, gyroscope=replace(errors.gyroscope, bias_std=0.0, bias_walk=0.0, scale_std=0.0))


RANDOM_PERSON, RANDOM_PHONE = pdr.simulate.Gait.random, pdr.simulate.SensorErrors.random
POPULATIONS = {
    "all": (RANDOM_PERSON, RANDOM_PHONE, demo_walks.LEG_STD_RAD),
    "typical people of random height": (typical_person, RANDOM_PHONE, demo_walks.LEG_STD_RAD),
    "gyroscopes without bias and scale error": (RANDOM_PERSON, exact_gyroscope, demo_walks.LEG_STD_RAD),
    "legs along the corridors": (RANDOM_PERSON, RANDOM_PHONE, 0.0),
    "none of the three": (typical_person, exact_gyroscope, 0.0),
}


def demo_errors(recording: pdr.Recording, track: pdr.Track) -> list[FloatArray]:
    """NEES (K,) in the frame of the track, and after alignment NEES (N,), squared errors and variances of positions."""
    truth = recording.truth.position
    assert truth is not None
    true_m = interpolated_rows(track.time_s, truth.time_s, np.column_stack([truth.east_m, truth.north_m]))
    first = evaluate.first_of_path(true_m)
    aligned_m = track.position_m - evaluate.fitted(true_m, track.position_m, first)
    cov_m2 = track.position_cov_m2
    return [
        evaluate.nees(track.position_m - true_m, cov_m2),
        evaluate.nees(aligned_m, cov_m2)[~first],
        (aligned_m**2).sum(axis=1)[~first],
        np.trace(cov_m2, axis1=1, axis2=2)[~first],
    ]


def demo(tables: Tables, arguments: argparse.Namespace) -> None:
    """NEES of the demonstration walk over people, phones and buildings."""
    rows = list[list[object]]()
    for name, (person, phone, leg_std_rad) in POPULATIONS.items():
        found: dict[str, list[list[FloatArray]]] = {"online": [], "smoothed": []}
        with (
            patch.object(pdr.simulate.Gait, "random", person),
            patch.object(pdr.simulate.SensorErrors, "random", phone),
            patch.object(demo_walks, "LEG_STD_RAD", leg_std_rad),
        ):
            for seed in range(arguments.seeds if name == "all" else arguments.seeds // 3):
                recording = pdr.simulate.demo_walk(seed)
                found["online"].append(demo_errors(recording, pdr.track(recording)))
                if name == "all":
                    found["smoothed"].append(demo_errors(recording, pdr.smooth(recording).track))
        for estimate, errors in found.items():
            if not errors:
                continue
            own, aligned, square_m2, var_m2 = zip(*errors, strict=True)
            cells = [mean_and_median([nees[-1] for nees in own])]
            for of_walks in (own, aligned):
                outside = np.mean([np.mean(nees > MOST) for nees in of_walks])
                cells += [mean_and_median([nees.mean() for nees in of_walks]), f"{100 * outside:.0f} %"]
            cells += [f"{np.sqrt(np.mean([m2.mean() for m2 in of])):.1f}" for of in (square_m2, var_m2)]
            rows.append([name, estimate, len(errors), *cells])
            say(" | ".join(map(str, rows[-1])))
    columns = "walks differ by | estimate | walks | NEES of the end | NEES | outside 95 % | NEES, aligned | "
    columns += "outside 95 %, aligned | error, aligned m | stated m"
    tables.write("consistency_demo", columns, rows, "NEES: mean ± its standard error (median), over walks.")


def mean_and_median(values: list[float]) -> str:
    """Mean with its standard error, and median."""
    a = np.array(values)
    return f"{a.mean():.2f} ± {a.std(ddof=1) / np.sqrt(len(a)):.2f} ({np.median(a):.2f})"


# --- real walks -------------------------------------------------------------------------------------------------------


def real_walks(data: Path, most: int) -> Iterator[Walk]:
    """Walks on foot on one storey, and only some of a large set."""
    for site in STD_M:
        found = [
            walk
            for walk in walks(data, (site,))
            if "trolley" not in walk.group
            and len(walk.time_s) > 3
            and (walk.recording.truth.waypoints is None or is_on_one_storey(walk.recording.truth.waypoints))
        ]
        yield from found[:: max(1, len(found) // most)]


def held_out(walk: Walk, estimate: Estimate) -> tuple[FloatArray, FloatArray] | None:
    """Errors (N, 2) and covariances (N, 2, 2) of the positions of a walk between fixes. None for too few fixes."""
    std_m = STD_M[walk.group.split()[0]]
    when_s, true_m = walk.time_s, walk.position_m
    if len(when_s) > 300:  # a continuous reference
        when_s = np.arange(when_s[0], when_s[-1], 2.0)
        true_m = interpolated_rows(when_s, walk.time_s, true_m)
    given = np.arange(len(when_s)) % (10 if len(walk.time_s) > 300 else 3) == 0
    cov_m2 = std_m**2 * np.eye(2)
    fixes = [PositionFix(float(t), p, cov_m2) for t, p in zip(when_s[given], true_m[given], strict=True)]
    if len(fixes) < 3:
        return None
    track = estimate(walk.recording, pdr.recipes.for_recording("default", walk.recording).in_world_frame(), fixes)
    use = ~given & (when_s > fixes[1].time_s) & (when_s >= track.time_s[0]) & (when_s <= track.time_s[-1])
    at_m = evaluate.positions_at(track.time_s, track.position_m, when_s[use])
    nearest = np.clip(np.searchsorted(track.time_s, when_s[use]), 0, track.n_steps - 1)
    return at_m - true_m[use], track.position_cov_m2[nearest] + cov_m2


def without_fixes(walk: Walk, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 2) and covariances (N, 2, 2) of the positions after the first 20 % of the path, without fixes."""
    _, error_m, cov_m2, first = errors_and_cov(
        walk, estimate(walk.recording, pdr.recipes.for_recording("default", walk.recording), []), STD_M
    )
    return error_m[~first], cov_m2[~first]


def online(recording: pdr.Recording, config: pdr.Config, fixes: list[PositionFix]) -> pdr.Track:
    return pdr.track(recording, config, fixes=fixes, gnss="off")


def smoothed(recording: pdr.Recording, config: pdr.Config, fixes: list[PositionFix]) -> pdr.Track:
    return pdr.smooth(recording, config, fixes=fixes, gnss="off").track


def log_scores(error_m: FloatArray, cov_m2: FloatArray) -> FloatArray:
    """Minus the logarithms of the normal densities of errors."""
    return 0.5 * (evaluate.nees(error_m, cov_m2) + np.log(np.linalg.det(2 * np.pi * cov_m2)))


def real(tables: Tables, arguments: argparse.Namespace) -> None:
    """NEES and log scores of real walks, online and smoothed, without and with fixes."""
    found: dict[tuple[str, str, str], list[tuple[FloatArray, FloatArray]]] = {}
    for walk in real_walks(arguments.data, arguments.most):
        site = walk.group.split()[0]
        if pdr.track(walk.recording, gnss="off").n_steps < 10:
            continue
        for estimate in (online, smoothed):
            found.setdefault((site, "none", estimate.__name__), []).append(without_fixes(walk, estimate))
            if (errors := held_out(walk, estimate)) is not None:
                found.setdefault((site, "some", estimate.__name__), []).append(errors)
    rows = list[list[object]]()
    for key, errors in sorted(found.items()):
        error_m, cov_m2 = (np.concatenate(parts) for parts in zip(*errors, strict=True))
        nees = evaluate.nees(error_m, cov_m2)
        of_walks = [evaluate.nees(*one).mean() for one in errors if len(one[0])]
        rms_m = np.sqrt([(error_m**2).sum(axis=1).mean(), np.trace(cov_m2, axis1=1, axis2=2).mean()])
        scores = f"{nees.mean():.2f}", f"{np.median(of_walks):.2f}", f"{100 * np.mean(nees > MOST):.0f} %"
        log_score = f"{log_scores(error_m, cov_m2).mean():.2f}"
        rows.append([*key, len(errors), len(nees), *scores, log_score, f"{rms_m[0]:.1f}", f"{rms_m[1]:.1f}"])
    columns = "set | fixes | estimate | walks | positions | mean NEES | median of walks | outside 95 % | log score | "
    columns += "error m | stated m"
    tables.write("consistency_real", columns, rows)


if __name__ == "__main__":
    run(__doc__, simulated, demo, real, seeds=100, most=12)
