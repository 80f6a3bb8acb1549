"""What calibration is worth on real walks, whether its intervals hold, and what it costs: docs/benchmarks.md.

usage: python -m tests.benchmarks.calibration [noise] [halves] [measure] [coverage] [speed] [--data ../shared/data]

noise     made-up people whose steps are 22 % longer than the prior says: the noise that is found in five layouts with 0
          to 20 % wrong segments, and the step of a further person
halves    parameters from half of each person's segments, error on the other half: against no calibration, one scale for
          everybody, and the population; and humolire by walks (legs and totals)
measure   fitted and scored by displacement against summed lengths
coverage  500 simulated calibrations: how often 95 % intervals have the truth; people with little data
speed     15 people x 6 contexts x 33 segments; 10^3 to 10^6 segments, time and memory
"""

from __future__ import annotations

import resource
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import pdr_filter as pdr
from pdr_filter.filter.step_length.models import KimStepLength, WeinbergStepLength
from pdr_filter.offline.calibration.estimation import Hierarchy, ParameterEstimate, estimate_parameters
from pdr_filter.offline.calibration.model_forms import RECORDING_STD, hierarchy_of, solve_sums
from pdr_filter.offline.calibration.priors import DEFAULT_PRIORS, StepLengthPrior, eq12_priors, weak_prior
from pdr_filter.offline.calibration.segments import Segment, SegmentSums, integrate, segments_of
from pdr_filter.offline.robust_loss import LOSSES
from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, bias_spread_rms, options, recordings

FloatArray = NDArray[np.float64]
N_SPLITS = 20


# --- real walks -----------------------------------------------------------------------------------------------------


def walks(data: Path, site: str) -> list[tuple[Recording, Track]]:
    """Recordings of a site with their tracks."""
    return [(r, pdr.track(r)) for r in recordings(data, site)]


def cut(found: list[tuple[Recording, Track]], measure: str = "displacement") -> list[Segment]:
    """All segments; each recording of ms_indoor, whose surveyors have no names, is of a person of its own."""
    return [s for r, t in found for s in segments_of(r, t, measure=measure, subject=r.name)[0]]


def lengths(sums: SegmentSums, theta: FloatArray) -> FloatArray:
    """Predicted lengths (N,) for theta (P,) or (N, P)."""
    vector = np.einsum("ndp,np->nd", sums.regressors, np.broadcast_to(theta, (len(sums), theta.shape[-1])))
    return np.hypot(*(vector + sums.offset_m).T)


def percent(predicted: FloatArray, true: FloatArray) -> str:
    """Bias, spread, RMS of relative errors in %."""
    return bias_spread_rms(100 * (predicted / true - 1))


def fitted(sums: SegmentSums, priors: dict[str, StepLengthPrior]) -> ParameterEstimate:
    models = {name: p.model for name, p in priors.items()}
    return solve_sums(sums, hierarchy_of(priors), models)


def with_model(**chosen: StepLengthPrior) -> dict[str, StepLengthPrior]:
    return {**DEFAULT_PRIORS, **chosen}


MODELS = {
    "bounce (default)": with_model(),
    "k0 + k1 f + k2 var (eq. 12)": eq12_priors(),
    "Weinberg": with_model(walking=weak_prior(WeinbergStepLength())),
    "Kim": with_model(walking=weak_prior(KimStepLength())),
}


def halves(tables: Tables, sites: dict[str, list[Segment]]) -> None:
    """Half of each person's segments against the other half."""
    segments = [s for site in sites.values() for s in site]
    place = np.array([name for name, own in sites.items() for _ in own])
    rows = []
    for name, priors in MODELS.items():
        models = {n: p.model for n, p in priors.items()}
        sums = integrate(segments, models, {n: p.mean for n, p in priors.items()})
        start = np.concatenate([p.mean for p in priors.values()])
        uncalibrated = lengths(sums, start)
        kept: dict[str, list[tuple[FloatArray, ...]]] = {site: [] for site in sites}
        totals: dict[str, list[tuple[FloatArray, ...]]] = {site: [] for site in sites}
        rng = np.random.default_rng(1)
        enough = np.bincount(sums.subject)[sums.subject] > 1
        for _ in range(N_SPLITS):
            training = np.zeros(len(sums), dtype=bool)
            for person in range(len(sums.subjects)):
                own = rng.permutation(np.flatnonzero(sums.subject == person))
                training[own[: len(own) // 2]] = True
            found = fitted(sums.rows(training), priors)
            scale = np.median(sums.distance_m[training] / uncalibrated[training])
            by = (uncalibrated, scale * uncalibrated, lengths(sums, found.population))
            by += (lengths(sums, found.people[sums.subject]),)
            for site, results in kept.items():
                test = ~training & enough & (place == site)
                results.append((sums.distance_m[test], *(b[test] for b in by)))
                each = [np.bincount(sums.recording[test], b[test]) for b in (sums.distance_m, *by)]
                totals[site].append(tuple(e[each[0] > 0] for e in each))
        for site in sites:
            people = len({s.subject for s in sites[site]})
            for what, results in (("segments", kept[site]), ("totals of walks", totals[site])):
                true, *predicted = (np.concatenate([r[k] for r in results]) for k in range(5))
                cells = [percent(p, true) for p in predicted]
                rows.append([name, f"{site}, {what}", f"{people}, {len(sites[site])}", *cells])
    columns = ["model", "site", "people, segments", "no calibration", "one scale for all", "population", "own k"]
    about = f"{N_SPLITS} random halves of the segments of each person; bias, spread, RMS in % of those not used."
    tables.write("calibration_halves", columns, rows, about)


def half_of_the_walks(tables: Tables, segments: list[Segment], others: list[Segment]) -> None:
    """humolire: parameters from four of nine walks, legs and totals of the other five; all 126 choices."""
    both = [*segments, *others]
    rows = []
    here = np.arange(len(both)) < len(segments)
    picked: dict[tuple[int, ...], tuple[float, FloatArray]] = {}
    for name, priors in MODELS.items():
        models = {n: p.model for n, p in priors.items()}
        sums = integrate(both, models, {n: p.mean for n, p in priors.items()})
        uncalibrated = lengths(sums, np.concatenate([p.mean for p in priors.values()]))
        own_walks = np.unique(sums.recording[here])
        person = sums.subject[0]
        errors: list[list[FloatArray]] = [[], [], [], []]
        for chosen in combinations(own_walks.tolist(), 4):
            training = here & np.isin(sums.recording, chosen)
            alone = fitted(sums.rows(training), priors)
            joint = fitted(sums.rows(training | ~here), priors).people[person]
            scale = sums.distance_m[training].sum() / uncalibrated[training].sum()
            own = lengths(sums, alone.people[person])
            by = (uncalibrated, scale * uncalibrated, own, lengths(sums, joint))
            for k, predicted in enumerate(by):
                errors[k].append(of_others(sums, here & ~training, predicted))
            left_out = float(np.square(alone.left_out_m / sums.distance_m[training] - 1).mean())
            if chosen not in picked or left_out < picked[chosen][0]:
                picked[chosen] = left_out, errors[2][-1]
        cells = [" / ".join(f"{100 * v:.2f}" for v in np.sqrt(np.mean(e, axis=0))) for e in errors]
        rows.append([name, *cells])
    best = np.sqrt(np.mean([e for _, e in picked.values()], axis=0))
    cells = ["", "", f"{100 * best[0]:.2f} / {100 * best[1]:.2f}", ""]
    rows.append(["what predicts left-out segments best", *cells])
    columns = ["model", "no calibration", "one scale", "own k", "own k, with the walks of ms_indoor"]
    about = (
        "humolire, k from 4 of the 9 walks, all 126 choices: RMS % of the legs / of the totals of the other 5 walks."
    )
    tables.write("calibration_walks", columns, rows, about)


def of_others(sums: SegmentSums, test: NDArray[np.bool_], predicted: FloatArray) -> FloatArray:
    """Mean square of the relative errors of legs and of totals of walks, (2,)."""
    legs = predicted[test] / sums.distance_m[test] - 1
    true, total = (np.bincount(sums.recording[test], v[test]) for v in (sums.distance_m, predicted))
    return np.array([np.square(legs).mean(), np.square(total[true > 0] / true[true > 0] - 1).mean()])


def one_corridor(tables: Tables, sites: dict[str, list[Segment]]) -> None:
    """A person with one segment: the rest of the person's segments, against the population."""
    segments = [s for site in sites.values() for s in site]
    priors = with_model()
    sums = integrate(segments, {n: p.model for n, p in priors.items()}, {n: p.mean for n, p in priors.items()})
    rng = np.random.default_rng(2)
    counts = np.bincount(sums.subject)
    errors: dict[str, list[float]] = {"no calibration": [], "population": [], "own k": [], "the one segment alone": []}
    uncalibrated = lengths(sums, np.concatenate([p.mean for p in priors.values()]))
    for person in np.flatnonzero(counts > 3):
        for first in rng.permutation(np.flatnonzero(sums.subject == person))[:5]:
            training = (sums.subject != person) | (np.arange(len(sums)) == first)
            test = (sums.subject == person) & ~training
            found = fitted(sums.rows(training), priors)
            population = lengths(sums, found.population)
            alone = population * sums.distance_m[first] / population[first]
            total = sums.distance_m[test].sum()
            for name, predicted in zip(
                errors, (uncalibrated, population, lengths(sums, found.people[person]), alone), strict=True
            ):
                errors[name].append(100 * (predicted[test].sum() / total - 1))
    rows = [[name, len(values), bias_spread_rms(values)] for name, values in errors.items()]
    columns = ["k from", "cases", "total of the person's other segments: bias, spread, RMS %"]
    tables.write("calibration_one_segment", columns, rows)


def measures(tables: Tables, found: dict[str, list[tuple[Recording, Track]]]) -> None:
    """Displacement against summed lengths, each segment left out; humolire also between all its waypoints."""
    corners = [
        (replace(r, truth=replace(r.truth, segments=None)), t) for r, t in found["humolire"]
    ]  # also legs that go round a corner
    lines = []
    rows = {"humolire, straight legs": found["humolire"], "humolire, all waypoints": corners}
    rows["ms_indoor, waypoints"] = found["ms_indoor"]
    for name, own in rows.items():
        cells: list[tuple[float, float]] = []
        for measure in ("displacement", "length"):
            segments = cut(own, measure)
            sums = integrate(
                segments,
                {n: p.model for n, p in DEFAULT_PRIORS.items()},
                {n: p.mean for n, p in DEFAULT_PRIORS.items()},
            )
            e = fitted(sums, dict(DEFAULT_PRIORS))
            k = e.people[:, 0 + 3].mean()  # walking comes after the three held parameters of standing
            error = e.left_out_m / sums.distance_m - 1
            cells.append((k, 100 * np.sqrt((error**2).mean())))
        (k1, r1), (k2, r2) = cells
        lines.append([name, len(segments), f"{k1:.4f}", f"{k2:.4f}", f"{r1:.1f}", f"{r2:.1f}"])
    columns = ["segments", "n", "k: displacement", "k: lengths", "RMS %: displacement", "RMS %: lengths"]
    tables.write("calibration_measures", columns, lines, "Each segment left out.")


# --- simulated ------------------------------------------------------------------------------------------------------


def simulated(
    rng: np.random.Generator, n_people: int, per_person: int, outliers: float = 0.0, contexts: int = 1
) -> tuple[SegmentSums, Hierarchy, FloatArray, FloatArray]:
    """Sums of eq. 12 for people drawn from the prior; with the prior, the population's and the people's truth."""
    mean = np.tile([0.42, 0.18, 0.004], contexts)
    std = np.tile([0.1, 0.05, 0.005], contexts)
    between = np.tile([0.04, 0.0, 0.0], contexts)
    prior = Hierarchy(mean, std, between, np.full(len(CONTEXTS), 0.08), 0.02)
    population = rng.normal(mean, std)
    people = population + rng.normal(size=(n_people, 3 * contexts)) * between
    n = n_people * per_person * contexts
    person = np.repeat(np.arange(n_people), per_person * contexts)
    context = np.tile(np.arange(contexts), n_people * per_person)
    recording = np.arange(n) // max(per_person * contexts // 3, 1)
    n_steps = rng.integers(12, 20, n).astype(float)
    each = np.stack([np.ones(n), rng.normal(1.9, 0.15, n), rng.normal(4.0, 0.8, n)], axis=1) * n_steps[:, None]
    regressors = np.zeros((n, 2, 3 * contexts))
    for c in range(contexts):
        regressors[context == c, 0, 3 * c : 3 * c + 3] = each[context == c]
    scale = 1 + rng.normal(0, 0.02, recording.max() + 1)
    error = rng.normal(size=n) * np.sqrt(0.35**2 + n_steps * 0.08**2)
    distance = np.einsum("np,np->n", regressors[:, 0], people[person]) * scale[recording] + error
    wrong = rng.random(n) < outliers
    distance[wrong] *= rng.choice([0.5, 2.0], wrong.sum())
    sums = SegmentSums(
        regressors=regressors,
        offset_m=np.zeros((n, 2)),
        distance_m=np.maximum(distance, 0.1),
        anchor_std_m=np.full(n, 0.35),
        n_steps=n_steps,
        context=context + 1 if contexts == 1 else context,
        subject=person,
        recording=recording,
        subjects=tuple(f"s{i}" for i in range(n_people)),
        recordings=tuple(f"r{i}" for i in range(int(recording.max()) + 1)),
    )
    return sums, prior, population, people


LAYOUTS = (12, 1), (30, 1), (100, 1), (12, 3), (12, 10)


def unlike_the_prior(
    rng: np.random.Generator, n_people: int, per_person: int, wrong: float, factor: float = 1.22
) -> tuple[SegmentSums, Hierarchy, float]:
    """Segments of about 12 m of the default model, people of two kinds; the usual prior, and the group's true k."""
    prior = DEFAULT_PRIORS["walking"]
    k = float(prior.mean[0])
    own = factor * k + prior.between_std[0] * rng.choice([-1, 1], n_people)
    n = n_people * per_person
    person, recording = np.repeat(np.arange(n_people), per_person), np.arange(n) // max(per_person // 3, 1)
    n_steps = rng.integers(12, 20, n).astype(float)
    row = n_steps * rng.normal(2.27, 0.104, n)
    distance = row * own[person] * (1 + rng.normal(0, RECORDING_STD, recording[-1] + 1)[recording])
    distance += rng.normal(size=n) * np.sqrt(0.35**2 + n_steps * prior.step_std_m**2)
    is_wrong = rng.random(n) < wrong
    distance[is_wrong] *= rng.choice([0.5, 2.0], is_wrong.sum())
    sums = SegmentSums(
        regressors=np.stack([row, np.zeros(n)], axis=1)[:, :, None],
        offset_m=np.zeros((n, 2)),
        distance_m=distance,
        anchor_std_m=np.full(n, 0.35),
        n_steps=n_steps,
        context=np.ones(n, dtype=np.int64),
        subject=person,
        recording=recording,
        subjects=tuple(f"s{i}" for i in range(n_people)),
        recordings=tuple(f"r{i}" for i in range(int(recording[-1]) + 1)),
    )
    return sums, hierarchy_of({"walking": prior}), factor * k


def noise(tables: Tables, n_runs: int = 20) -> None:
    """The noise found over the true one, and the error of the group's step."""
    found, further = [], []
    for loss in LOSSES:
        for wrong in (0.0, 0.1, 0.2):
            ratios, errors = [], []
            for n_people, per_person in LAYOUTS:
                rng = np.random.default_rng(6)
                runs = []
                for _ in range(n_runs):
                    sums, prior, k = unlike_the_prior(rng, n_people, per_person, wrong)
                    e = estimate_parameters(sums, prior, loss)
                    runs.append((np.sqrt(e.noise_factor[1]), 100 * (e.population[0] / k - 1)))
                ratio, error = np.array(runs).T
                ratios.append(f"{ratio.mean():.2f}")
                errors.append(f"{error.mean():+.1f}, {error.std():.1f}")
            found.append([loss, f"{100 * wrong:.0f} %", *ratios])
            further.append([loss, f"{100 * wrong:.0f} %", *errors])
    layouts = [f"{s} x {n}" for s, n in LAYOUTS]
    about, columns = f"{n_runs} made-up groups with steps 22 % longer than the prior's, ", ["loss", "wrong", *layouts]
    of_noise = "people x segments; noise found over the true one (standard deviations)."
    tables.write("calibration_noise", columns, found, about + of_noise)
    of_step = "people x segments; error of the group's step in %: bias, spread."
    tables.write("calibration_group", columns, further, about + of_step)


def coverage(tables: Tables, n_runs: int = 500) -> None:
    """How often 95 % intervals have the truth."""
    rows = []
    for n_people, per_person, outliers, loss in (
        (5, 12, 0.0, "gnc"),
        (5, 12, 0.0, "none"),
        (15, 3, 0.0, "gnc"),
        (5, 12, 0.1, "gnc"),
        (5, 12, 0.1, "cauchy"),
        (5, 12, 0.1, "huber"),
        (5, 12, 0.1, "none"),
    ):
        rng = np.random.default_rng(0)
        own, shared, square = [], [], []
        for _ in range(n_runs):
            sums, prior, population, people = simulated(rng, n_people, per_person, outliers)
            e = estimate_parameters(sums, prior, loss)
            std = np.sqrt(np.diagonal(e.people_cov, axis1=1, axis2=2))
            own.append(np.abs(e.people - people)[:, 0] < 1.96 * std[:, 0])
            shared.append(np.abs(e.population - population) < 1.96 * np.sqrt(np.diagonal(e.population_cov)))
            typical = np.array([1.0, 1.9, 4.0])
            errors = [(e.people - people) @ typical, (e.population - people) @ typical]
            square.append([np.square(x).mean() for x in errors])
        k = np.mean(shared, axis=0)
        rms = 100 * np.sqrt(np.mean(square, axis=0))
        shares = [f"{100 * share:.1f} %" for share in (np.mean(own), *k)]
        figures = [f"{100 * outliers:.0f} %", loss, *shares, *(f"{v:.2f}" for v in rms)]
        rows.append([f"{n_people} x {per_person}", *figures])
    columns = ["people x segments", "wrong", "loss", "k0 of people", "k0", "k1", "k2", "a person's step, cm"]
    about = f"{n_runs} simulated calibrations: share of 95 % intervals with the truth; RMS error of a typical step."
    tables.write("calibration_coverage", [*columns, "the population's step, cm"], rows, about)


def speed(tables: Tables) -> None:
    """Time and memory."""
    rng = np.random.default_rng(3)
    estimate_parameters(*simulated(rng, 15, 33, contexts=6)[:2])  # loads what is loaded once
    rows = []
    for n in (1000, 10_000, 100_000, 1_000_000):
        people = min(max(n // 200, 5), 5000)
        sums, prior, _, _ = simulated(rng, people, n // people // 6, contexts=6)
        began = time.process_time()
        e = estimate_parameters(sums, prior)
        seconds = time.process_time() - began
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        figures = [f"{seconds:.2f}", e.n_iterations, f"{1e6 * seconds / len(sums):.1f}", f"{memory:.2f}"]
        rows.append([len(sums), people, *figures])
    columns = ["segments", "people", "s of processor", "iterations", "µs a segment", "peak memory GiB"]
    tables.write("calibration_speed", columns, rows, "6 contexts, 18 parameters, all variances estimated.")


def main() -> None:
    arguments = options(__doc__, "noise", "halves", "measure", "coverage", "speed").parse_args()
    tables = Tables.of(__spec__.name, arguments)
    if {"halves", "measure"} & set(arguments.parts):
        found = {site: walks(arguments.data, site) for site in ("humolire", "ms_indoor")}
        sites = {site: cut(own) for site, own in found.items()}
        if "halves" in arguments.parts:
            halves(tables, sites)
            half_of_the_walks(tables, sites["humolire"], sites["ms_indoor"])
            one_corridor(tables, sites)
        if "measure" in arguments.parts:
            measures(tables, found)
    if "noise" in arguments.parts:
        noise(tables)
    if "coverage" in arguments.parts:
        coverage(tables)
    if "speed" in arguments.parts:
        speed(tables)


if __name__ == "__main__":
    main()
