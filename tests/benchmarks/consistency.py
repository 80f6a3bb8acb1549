# ruff: noqa: N806 - the letters of the equations
"""Is the filter's covariance the size of its errors: on walks drawn from its own model and on real walks.

usage: python -m tests.benchmarks.consistency [simulated] [real] [--data ../shared/data]

simulated: walks of mixed contexts, as `Step`s, `WindowContext`s and `PositionFix`es, drawn from what the default
recipe's tracker assumes: contexts by its transitions, lengths by each mode's fit, the person's scale and the heading's
drift by `MotionNoise`. The classifier is a linear one on Gaussian features, so that its probabilities are calibrated.
NEES is of the position (2 degrees of freedom) and of the whole state (4), ten times in a walk of 300 steps, NIS of a
fix of 3 m every 60 steps. The bounds are those of a chi-square mean over the walks; that of the NIS is over all
fixes. Rows below "the filter's own model" leave it, by what their names say.

real: the share of places in the 50 % and 95 % ellipses of the default recipe: waypoints of humolire, ms_indoor and
ipin21, and the reference of oxiod and tyrex every 5 s (without the trolley); and the mean of these five phones.
Alone: the truth is turned and moved into the track's frame by the places of the first 20 % of the path, which then do
not count; that gives the direction better than the filter can know it. With fixes: the filter gets those places as
fixes in the frame of the building, of which it knows neither origin nor north, and nothing is turned. What places are
uncertain by along each axis, 0.7 m (humolire), 1 m (ms_indoor, ipin21), 0.3 m (oxiod, tyrex), is the standard deviation
of the fixes and is added to the ellipses.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.stats import chi2

import pdr_filter as pdr
from pdr_filter import evaluate
from pdr_filter.filter.chain.imm_tracker import ImmState, ImmTracker
from pdr_filter.filter.chain.weighted_tracker import WeightedState, WeightedTracker
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.pedestrian.pedestrian_state import reckoned_position
from pdr_filter.filter.step_length.models import length_and_jacobian
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray, PositionFix, Step, WindowContext
from tests.benchmarks.common import Tables, recordings, run
from tests.helpers import a_step as made_step

EVEN_PRIOR = np.full(len(CONTEXTS), 1 / len(CONTEXTS))
# Features of the simulated classifier: a unit vector for each context, this long, in unit noise. Of even contexts it
# classifies 87 % of the windows correctly; the shipped model gets 86 to 97 % of people left out.
SEPARATION = 2.5
# Files of a site, which has one phone, and how good its places are along each axis: humolire's are ticks on a floor
# passed within a step, those of ms_indoor and ipin21 are "good to a metre or so".
PLACES = (
    ("humolire", "*.zip", 0.7),
    ("ms_indoor", "*.zip", 1.0),
    ("oxiod", "*_[hp]*.zip", 0.3),
    ("tyrex", "*dist_[bfpst]*.zip", 0.3),
    ("ipin21", "*.zip", 1.0),
    ("oxiod", "*running*.zip", 0.3),
    ("tyrex", "*dist_running*.zip", 0.3),
)
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
class Walk:
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
) -> Walk:
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
    return Walk(steps, windows, np.array(states), np.array(chosen))


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
    walk: Walk,
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


def bounds(dof: int, n: int, prob: float = 0.95) -> tuple[float, float]:
    """Of the mean of n chi-square numbers, with this probability."""
    low, high = chi2.ppf([(1 - prob) / 2, (1 + prob) / 2], dof * n) / n
    return float(low), float(high)


def line(name: str, errors: Errors) -> list[str]:
    """One row of the table: mean, checks inside the bounds, for each of the errors."""
    n, cells = len(errors.position), []
    for values, dof in ((errors.position, 2), (errors.position_linear, 2), (errors.state, 4)):
        low, high = bounds(dof, n)
        mean = values.mean(axis=0)
        inside = int(((mean >= low) & (mean <= high)).sum())
        cells.append(f"{mean.mean():.2f} ({mean.min():.2f} to {mean.max():.2f}), {inside}")
    nis = "-"
    if errors.fixes.size:
        # of a mixture the NIS has the mean of the chi-square, and longer tails
        low, high = bounds(2, errors.fixes.size)
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
    low2, high2 = bounds(2, n_walks)
    low4, high4 = bounds(4, n_walks)
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
    columns = ["", "NEES position", "without shared errors", "NEES state", "NIS (bounds)", "fixes rejected"]
    found = [
        line(name, errors_of_walks(drawn_from, used, n_walks, 300, **changed))
        for name, drawn_from, used, changed in rows
    ]
    tables.write("consistency_simulated", [*columns, "right modes"], found, about)


# --- real walks -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Places:
    """Where a person was."""

    time_s: FloatArray  # (W,)
    position_m: FloatArray  # (W, 2)
    first: BoolArray  # (W,) in the first 20 % of the path, two at least

    @property
    def fixes(self) -> list[tuple[float, FloatArray]]:
        """Times and positions of the first ones."""
        return list(zip(np.maximum(self.time_s, 0.0)[self.first], self.position_m[self.first], strict=True))


def places_of(recording: pdr.Recording) -> Places | None:
    """Waypoints, or a reference every 5 s; None if there are not three."""
    truth = recording.truth.position if recording.truth.waypoints is None else recording.truth.waypoints
    if truth is None:
        return None
    time_s, position_m = np.asarray(truth.time_s), np.column_stack([truth.east_m, truth.north_m])
    if truth is recording.truth.position:
        every = np.unique(np.searchsorted(time_s, np.arange(time_s[0], time_s[-1], 5.0)))
        time_s, position_m = time_s[every], position_m[every]
    if len(time_s) < 3:
        return None
    first = evaluate.first_of_path(position_m)
    first[:2] = True
    return Places(time_s, position_m, first)


def at(track: pdr.Track, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (T, 2) and covariances (T, 2, 2) at any times."""
    time_s = np.concatenate([[min(times_s[0], track.time_s[0]) - 1e-3], track.time_s])
    position_m = np.vstack([[0.0, 0.0], track.position_m])
    cov_m2 = np.concatenate([np.zeros((1, 2, 2)), track.position_cov_m2]).reshape(-1, 4)
    found = [np.column_stack([np.interp(times_s, time_s, c) for c in v.T]) for v in (position_m, cov_m2)]
    return found[0], found[1].reshape(-1, 2, 2)


def place_errors(track: pdr.Track, truth: Places, std_m: float) -> FloatArray:
    """Squared errors over the ellipses, (W,), of the places after the first 20 %."""
    estimate, cov = at(track, truth.time_s)
    error = truth.position_m - estimate
    nees = np.einsum("ka,kab,kb->k", error, np.linalg.inv(cov + std_m**2 * np.eye(2)), error)
    return nees[~truth.first]


def real(tables: Tables, arguments: argparse.Namespace) -> None:
    """Coverage by site: of the track alone, and of one that got the first places as fixes in the building's frame."""
    levels, rows, of_phones = chi2.ppf([0.5, 0.95], 2), [], {"no": [], "yes": []}
    for site, pattern, std_m in PLACES:
        alone, with_fixes = [], []
        for recording in recordings(arguments.data, site, pattern):
            truth = places_of(recording)
            config = pdr.recipes.for_recording("default", recording)
            track = pdr.track(recording, config)
            if truth is None or truth.first.all() or track.n_steps < 10 or recording.gyroscope is None:
                continue
            estimate, _ = at(track, truth.time_s)
            turned = replace(truth, position_m=evaluate.fitted(truth.position_m, estimate, truth.first))
            alone.append(place_errors(track, turned, std_m))
            fixes = [PositionFix(float(t), p, std_m**2 * np.eye(2)) for t, p in truth.fixes]
            with_fixes.append(place_errors(pdr.track(recording, config.in_world_frame(), fixes=fixes), truth, std_m))
        for name, found in (("no", alone), ("yes", with_fixes)):
            nees = np.concatenate(found)
            half, most = (100 * np.mean(nees <= level) for level in levels)
            shares = [f"{half:.0f} %", f"{most:.0f} %"]
            label = site + (" running" if "running" in pattern else "")
            rows.append([label, name, len(found), nees.size, *shares, f"{nees.mean():.2f}, {np.median(nees):.2f}"])
            if label == site:
                of_phones[name].append((half, most, nees.mean()))
    for name, of_each in of_phones.items():
        half, most, mean = np.mean(of_each, axis=0)
        rows.append([f"{len(of_each)} phones alike", name, "", "", f"{half:.0f} %", f"{most:.0f} %", f"{mean:.2f}, -"])
    columns = ["site", "first 20 % as fixes", "walks", "places", "in 50 %", "in 95 %"]
    tables.write("consistency_real", [*columns, "squared error over predicted: mean, median"], rows)


# --- a day ----------------------------------------------------------------------------------------------------------


def day(
    n_steps: int, day_s: float, seed: int = 0, fix_every_s: float = 600.0
) -> Iterator[Step | WindowContext | PositionFix]:
    """Bouts of about 100 steps with rest between, a window every second, and a good fix now and then.

    The person is where the fixes say: steps lead in a circle, so that a fix may always be near the start.
    """
    rng = np.random.default_rng(seed)
    step_s, bout = 0.52, 100
    rest_s = max(day_s / (n_steps / bout) - bout * step_s, 5.0)
    sure = {c: np.where(np.arange(len(CONTEXTS)) == i, 0.9, 0.02) for i, c in enumerate(CONTEXTS)}
    clock_s, window_s, fix_s, made = 0.0, 1.0, fix_every_s, 0

    def until(end_s: float, context: str) -> Iterator[WindowContext]:
        nonlocal window_s
        while window_s <= end_s:
            yield WindowContext(window_s, sure[context], EVEN_PRIOR)
            window_s += 1.0

    while made < n_steps:
        context = str(rng.choice(["walking", "walking", "walking", "upstairs", "downstairs", "running"]))
        for k in range(min(bout, n_steps - made)):
            clock_s += step_s
            yield from until(clock_s, context)
            # twice around in a bout: the bout ends where it began
            yield a_step(k, clock_s, rng, 1 / step_s, 4 * np.pi * k / bout)
            made += 1
        if clock_s >= fix_s:
            yield PositionFix(clock_s, rng.normal(scale=3.0, size=2), 100.0 * np.eye(2))
            fix_s = clock_s + fix_every_s
        clock_s += rest_s
        yield from until(clock_s, "stationary")


Tracker = ImmTracker | WeightedTracker
State = ImmState | WeightedState


def sizes(state: State) -> tuple[int, int, int, int]:
    """Numbers in all arrays of the state, windows, rows of the trail, waiting steps."""
    estimates, trail = state.pedestrian.estimates, state.pedestrian.steps.trail
    of_pedestrian = trail.size + sum(getattr(estimates, f.name).size for f in fields(estimates))
    of_windows = sum(w.prob.size + w.training_prior.size + w.carrying_prob.size for w in state.windows)
    waiting = state.pending if isinstance(state, WeightedState) else ()
    return of_pedestrian + of_windows, len(state.windows), len(trail), len(waiting)


def run_day(tracker: Tracker, n_steps: int, day_s: float) -> tuple[State, list[tuple[int, int, int, int]], int]:
    """The state at the end, the sizes at every twentieth step, and the number of rejected fixes."""
    state, found, rejected = tracker.init(), [], 0
    for event in day(n_steps, day_s):
        if isinstance(event, PositionFix):
            state, outcome, _ = tracker.on_fix(state, event)
            rejected += outcome == "rejected"
        elif isinstance(event, WindowContext):
            state, _ = tracker.on_window(state, event)
        else:
            state, _ = tracker.on_step(state, event)
            if state.pedestrian.steps.n_final % 20 == 0:
                found.append(sizes(state))
    return state, found, rejected


if __name__ == "__main__":
    run(__doc__, simulated, real)
