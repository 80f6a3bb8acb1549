"""HC, WC and IMM on people and sensors that the classifier has not seen: distances, probabilities, other evidence.

usage: python -m tests.benchmarks.weightings [PART ...] [--data ../shared/data] [--cache FOLDER]

The steps, windows and lengths of the default recipe are the same for all weightings; the reference is the distance of
these steps with the length of their true contexts. What differs is the error that is due to contexts. Steps outside of
every label, and those in the still seconds of the joined walks, are left out.

`real`: walks joined of recordings of one activity (`mixed_contexts.py`) and the recordings of Di Fronzo with their real
changes, models trained without the people; terrain, a sensor on the leg that no model has seen; and level walking of
tyrex, left out as a whole, and of every third walk of ubicomp13, which trains nothing. Distances of each weighting, and
the probabilities behind them, also of the recordings of MotionSense with one activity each.

`evidence`: log loss and distance with other evidence: floors, exponents, and a classifier that may be wrong about a
person, for as long as the recording lasts.

`prior`: error of the distance with each exponent of the prior, and of the exponent with the least error, beside that of
HC, over the joined walks, Di Fronzo and MotionSense without the person. The other sets chose nothing.

`simulated`: walks with exact distances, phone in the hand. The shipped model takes all that a simulated hand does for
walking, which says nothing about weightings. So each walk gets the windows of one of the people above: for every
stretch of a context, what the model that had not seen them said of theirs, in order from its start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from pdr_filter.evaluate.comparison import second_over_first
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.offline.training.context_sequences import UNKNOWN
from pdr_filter.offline.training.cross_validation import DOUBTFUL, LabelledWindows, recordings_of
from pdr_filter.recipes import default, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.context_stage import WindowContext
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, FloatArray, IntArray, Step
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, options, paths
from tests.benchmarks.contexts_left_out import N_FOLDS as N_LEFT_OUT_FOLDS
from tests.benchmarks.contexts_left_out import on_the_level, without
from tests.benchmarks.kinds_of_people import ONE_KIND, Kinds, chain, kinds_that_are_wrong, kinds_that_say_nothing
from tests.benchmarks.mixed_contexts import (
    LAG_STEPS,
    N_WALKS,
    Event,
    cached,
    context_at,
    tracked,
    updates_of,
    walks_left_out,
    windows_of,
)

WALKING = CONTEXTS.index("walking")
MIN_STEPS = 20  # a recording with fewer says little in per cent
EVERY = 3
WC_THRESHOLD = 0.8  # of Algorithm 2
WC_THRESHOLDS = {"WC, threshold 0.8": WC_THRESHOLD, "WC, always": 0.0}


@dataclass(frozen=True, eq=False)
class Walk:
    """Of a recording: what the front end found, without steps whose context is not known."""

    recording: Recording
    person: str
    config: Config
    events: list[Event]
    label: IntArray  # (K,) true context of each step

    @property
    def windows(self) -> list[WindowContext]:
        """In order."""
        return [e for e in self.events if isinstance(e, WindowContext)]

    @property
    def length_m(self) -> FloatArray:
        """Length of each step in each mode, (K, M); the default's modes are the contexts."""
        return np.array([self.config.model.lengths(e)[0] for e in self.events if isinstance(e, Step)])

    @cached_property
    def evidence(self) -> list[WindowContext | None]:
        """The window that is new to the IMM at each step."""
        tracker = self.config.with_weighting("imm").tracker
        state, found = tracker.init(), list[WindowContext | None]()
        for event in self.events:
            before = state.used
            if isinstance(event, WindowContext):
                state, _ = tracker.on_window(state, event)
            elif isinstance(event, Step):
                state, _ = tracker.on_step(state, event)
                found.append(None if state.used is before else state.used)
            else:
                state, _ = tracker.on_gap(state, event.duration_s)
        return found

    @property
    def known_m(self) -> float:
        """Distance in the true contexts."""
        return float(self.length_m[np.arange(len(self.label)), self.label].sum())


def walk_of(recording: Recording, person: str, config: Config, is_level: bool = False) -> Walk:
    """A recording through the front end; of level walking alone what is not labelled as something else."""
    found = run_sensing(config.sensing, recording)[1]
    time_s = np.array([e.time_s for e in found if isinstance(e, Step)])
    if is_level:
        label = np.where(on_the_level(recording, time_s), WALKING, UNKNOWN)
    else:
        label = np.array([context_at(recording, t) for t in time_s], dtype=np.int64)
        label[time_s >= DOUBTFUL.get(recording.name, np.inf)] = UNKNOWN
    known = iter(label != UNKNOWN)
    events = [e for e in found if not isinstance(e, Step) or next(known)]
    return Walk(recording, person, config, events, label[label != UNKNOWN])


# --- Real walks ------------------------------------------------------------------------------------------------------


def joined_walks(data: Path, cache: Path | None, windows: LabelledWindows) -> Iterator[Walk]:
    """Those of `mixed_contexts.py`, with the same models."""
    for each in walks_left_out(data, cache, windows):
        yield walk_of(*each)


def people_left_out(data: Path, cache: Path | None, windows: LabelledWindows, dataset: str) -> Iterator[Walk]:
    """Recordings of a scored data set, with the models of `contexts_left_out.py`."""
    of_set = [sorted({p for p in windows.person if p.startswith(f"{n}/")}) for n in ("motionsense", "difronzo")]
    for k in range(N_LEFT_OUT_FOLDS):
        fold = [p for everybody in of_set for p in everybody[k::N_LEFT_OUT_FOLDS]]
        model = without(windows, fold, cache, f"people_{k}")
        for path in recordings_of(data, (dataset,)):
            recording = pdr.read(path)
            person = f"{dataset}/{recording.subject.id}"
            if person in fold:
                yield walk_of(recording, person, with_context_model(default(recording.subject), model))


def other_sites(data: Path, cache: Path | None, windows: LabelledWindows, site: str) -> Iterator[Walk]:
    """Recordings of a site that the model has not seen: level walking, and terrain with its labels."""
    known = sorted({p for p in windows.person if p.startswith(f"{site}/")})
    for path in paths(data, site)[:: EVERY if site == "ubicomp13" else 1]:
        recording = pdr.read(path)
        config = default(recording.subject)
        if known:
            config = with_context_model(config, without(windows, known, cache, f"site_{site}"))
        yield walk_of(recording, f"{site}/{recording.subject.id}", config, is_level=site != "terrain")


def sets_of(data: Path, cache: Path | None) -> dict[str, list[Walk]]:
    """All walks that have enough steps, by set."""
    windows: LabelledWindows = cached(cache, "windows", lambda: windows_of(data))
    found = {
        "joined walks": joined_walks(data, cache, windows),
        "difronzo": people_left_out(data, cache, windows, "difronzo"),
        "terrain": other_sites(data, cache, windows, "terrain"),
        "tyrex, level": other_sites(data, cache, windows, "tyrex"),
        "ubicomp13, level": other_sites(data, cache, windows, "ubicomp13"),
        "motionsense": people_left_out(data, cache, windows, "motionsense"),
    }
    return {name: [w for w in walks if len(w.label) >= MIN_STEPS] for name, walks in found.items()}


# --- Distances -------------------------------------------------------------------------------------------------------


def distances_m(walk: Walk) -> dict[str, float]:
    """Distance of the same steps by each weighting."""
    hc = tracked(walk.events, walk.config, "hc")
    found = {"HC": hc[-1].walked_m}
    for name, threshold in WC_THRESHOLDS.items():
        found[name] = updates_of(WeightedTracker(walk.config.model, threshold), walk.events)[-1].walked_m
    imm = tracked(walk.events, walk.config, "imm")
    prob = np.array([u.mode_prob for u in imm])
    lagged = smoothed_mode_prob(prob, walk.config.model.transition_prob, LAG_STEPS)
    return found | {
        "IMM, steps as they were made": sum(u.step_length_m for u in imm),
        "IMM": imm[-1].walked_m,
        "IMM, lagged": float((lagged * walk.length_m).sum()),
        "IMM, smoothed": float((hindsight_prob(walk) * walk.length_m).sum()),
    }


def hindsight_prob(walk: Walk) -> FloatArray:
    """Mode probabilities (K, M) with all evidence, as `in_hindsight` has them where no fixes are."""
    config = walk.config.in_hindsight()
    prob = np.array([u.mode_prob for u in tracked(walk.events, config, "imm")])
    return smoothed_mode_prob(prob, config.model.transition_prob)


ERRORS = ["bias %", "spread %", "RMS %", "largest %"]


def error_cells(found_m: Sequence[float], true_m: FloatArray) -> list[str]:
    """Bias and spread of relative distance errors."""
    e = 100 * (np.array(found_m) / true_m - 1)
    figures = (e.std(ddof=1), np.sqrt(np.mean(e**2)), np.abs(e).max())
    return [f"{e.mean():+.1f}", *(f"{v:.1f}" for v in figures)]


def columns_of(rows: Sequence[Mapping[str, float]]) -> dict[str, list[float]]:
    """Distances by weighting, of all walks."""
    return {name: [row[name] for row in rows] for name in rows[0]}


def probabilities(walk: Walk) -> dict[str, FloatArray]:
    """What each answer says of the steps, (K, C) each."""
    imm = tracked(walk.events, walk.config, "imm")
    prob = np.array([u.mode_prob for u in imm])
    transition_prob = walk.config.model.transition_prob
    return {
        "windows": np.array([u.context_prob for u in imm]),
        "IMM": prob,
        "IMM, lagged": smoothed_mode_prob(prob, transition_prob, LAG_STEPS),
        "IMM, smoothed": hindsight_prob(walk),
        "IMM, smoothed with the exponent of online": smoothed_mode_prob(prob, transition_prob),
    }


def log_loss(prob: FloatArray, label: IntArray) -> FloatArray:
    """Of each step, (K,)."""
    return -np.log(np.maximum(prob[np.arange(len(label)), label], 1e-6))


def real(tables: Tables, sets: Mapping[str, list[Walk]]) -> None:
    """Distances and probabilities of each weighting."""
    rows, of_prob, of_doubt = [], [], []
    for name, walks in sets.items():
        people = len({w.person for w in walks})
        what = f"{name} ({len(walks)} of {people} {'person' if people == 1 else 'people'})"
        known = np.array([w.known_m for w in walks])
        moved = known > 0
        for weighting, found in columns_of([distances_m(w) for w in walks]).items():
            if name != "motionsense":
                rows.append([what, weighting, *error_cells(np.array(found)[moved], known[moved])])
        said = [probabilities(w) for w in walks]
        y = np.concatenate([w.label for w in walks])
        for answer in said[0]:
            prob = np.concatenate([s[answer] for s in said])
            right = f"{np.mean(prob.argmax(axis=1) == y):.3f}"
            of_prob.append([f"{name} ({len(y)} steps)", answer, right, f"{log_loss(prob, y).mean():.3f}"])
        doubt = second_over_first(np.concatenate([s["windows"] for s in said])) >= WC_THRESHOLD
        wrong = np.concatenate([s["windows"].argmax(axis=1) for s in said]) != y
        of_doubt.append(
            [f"{name} ({len(y)} steps)", *(f"{100 * v:.1f}" for v in (doubt.mean(), wrong.mean(), doubt[wrong].mean()))]
        )
    about = "Against the same steps in the true contexts, of people or sites left out."
    tables.write("weightings_distance", ["walks", "weighting", *ERRORS], rows, about)
    tables.write("weightings_probabilities", ["walks", "answer", "right", "log loss"], of_prob)
    columns = ["walks", "weighted by WC, % of the steps", "window wrong, %", "of these weighted by WC, %"]
    about = "Steps whose window's second highest probability is 0.8 of the highest or more."
    tables.write("weightings_doubt", columns, of_doubt, about)


# --- Other evidence --------------------------------------------------------------------------------------------------

CHOICES: dict[str, tuple[float, float, Kinds]] = {
    "online: exponent 1, floor 0.01": (1.0, 0.01, ONE_KIND),
    "floor 0.05": (1.0, 0.05, ONE_KIND),
    "floor 0.1": (1.0, 0.1, ONE_KIND),
    "exponent 0.7": (0.7, 0.01, ONE_KIND),
    "hindsight: exponent 0.5": (0.5, 0.01, ONE_KIND),
    "exponent 0.3": (0.3, 0.01, ONE_KIND),
    "nothing known of 1 person in 10": (1.0, 0.01, kinds_that_say_nothing(0.1)),
    "walking of 1 in 25 half taken for stairs": (1.0, 0.01, kinds_that_are_wrong(0.02, 0.5)),
    "walking of 1 in 25 taken for stairs": (1.0, 0.01, kinds_that_are_wrong(0.02, 0.9)),
}


def evidence(tables: Tables, sets: Mapping[str, list[Walk]]) -> None:
    """Log loss of the filter and the smoother, and the distance in hindsight, with each choice."""
    rows = []
    for choice, (exponent, floor, kinds) in CHOICES.items():
        cells = []
        for walks in sets.values():
            of_steps = [(w, *chain(w.config.model, w.evidence, exponent, floor, kinds)) for w in walks]
            losses = [np.concatenate([log_loss(s[i], s[0].label) for s in of_steps]).mean() for i in (1, 2)]
            moved = [(w, smoothed) for w, _, smoothed in of_steps if w.known_m > 0]
            errors = [100 * ((p * w.length_m).sum() / w.known_m - 1) for w, p in moved]
            cells.append(f"{losses[0]:.3f}, {losses[1]:.3f}, {np.sqrt(np.mean(np.square(errors))):.1f}")
        rows.append([choice, *cells])
        print(rows[-1], flush=True)
    about = "Log loss at the steps, filtered and smoothed, and RMS error of the smoothed distance, %."
    tables.write("weightings_evidence", ["evidence", *sets], rows, about)


PRIOR_EXPONENTS = (0.0, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.6, 1.0)
CHOSEN_ON = ("joined walks", "difronzo", "motionsense")


def prior(tables: Tables, sets: Mapping[str, list[Walk]]) -> None:
    """Distance of the IMM by the exponent of the prior, and of the one that is chosen without the person."""
    moved = {name: [w for w in walks if w.known_m > 0] for name, walks in sets.items()}
    errors = {name: np.array([errors_by_prior(w) for w in walks]) for name, walks in moved.items()}
    of_hc = {
        name: np.array([[tracked(w.events, w.config, "hc")[-1].walked_m / w.known_m - 1] for w in walks])
        for name, walks in moved.items()
    }

    def chosen_without(person: str) -> int:
        """The exponent with the least RMS error beside that of HC, mean of the sets."""
        ratios: list[FloatArray] = []
        for name in CHOSEN_ON:
            others = np.array([w.person != person for w in moved[name]])
            ratios.append(rms(errors[name][others]) / rms(of_hc[name][others]))
        return int(np.mean(ratios, axis=0).argmin())

    rows = [
        [f"{k:.2f}", *(f"{100 * rms(e[:, i : i + 1])[0]:.1f}" for e in errors.values())]
        for i, k in enumerate(PRIOR_EXPONENTS)
    ]
    nested: list[str] = []
    for name, walks in moved.items():
        own = [e[chosen_without(w.person)] for w, e in zip(walks, errors[name], strict=True)]
        nested.append(f"{100 * rms(np.array(own)[:, None])[0]:.1f}" if name in CHOSEN_ON else "")
    rows.append(["chosen without the person", *nested])
    rows.append(["HC", *(f"{100 * rms(e)[0]:.1f}" for e in of_hc.values())])
    chosen = sorted({PRIOR_EXPONENTS[chosen_without(w.person)] for name in CHOSEN_ON for w in moved[name]})
    about = f"RMS error of the distance, %. Chosen without one person: {chosen[0]:.2f} to {chosen[-1]:.2f}."
    tables.write("weightings_prior", ["exponent of the prior", *sets], rows, about)


def errors_by_prior(walk: Walk) -> FloatArray:
    """Relative error of the IMM's distance with each exponent, (E,)."""
    found: list[float] = []
    for exponent in PRIOR_EXPONENTS:
        model = replace(walk.config.model, prior_exponent=exponent)
        _, smoothed = chain(model, walk.evidence, model.evidence_exponent, model.evidence_floor, ONE_KIND)
        found.append(float((smoothed * walk.length_m).sum()) / walk.known_m - 1)
    return np.array(found)


def rms(errors: FloatArray) -> FloatArray:
    """Root mean square over the rows."""
    return np.sqrt(np.mean(errors**2, axis=0))


# --- Simulated walks -------------------------------------------------------------------------------------------------

Change = Callable[[WindowContext], WindowContext]


def contexts_of(real_walk: Walk, walk: Recording) -> Change:
    """Windows with what a model that had not seen them said of somebody's real windows of the same context.

    The one as long after the start of a stretch of the context, and again from its start at its end.
    """
    windows = real_walk.windows
    truth = np.array([context_at(real_walk.recording, w.time_s - 1.0) for w in windows])

    def change(window: WindowContext) -> WindowContext:
        context, since_s = stretch(walk, window)
        starts = [i for i in np.flatnonzero(truth == context) if i == 0 or truth[i - 1] != context]
        # walking has three stretches: another one each time
        start = starts[round(window.time_s - since_s) % len(starts)]
        length = int(np.argmax(np.append(truth[start:] != context, True)))
        said = windows[start + int(max(since_s, 0.0)) % length]
        return replace(window, prob=said.prob, training_prior=said.training_prior)

    return change


def stretch(walk: Recording, window: WindowContext) -> tuple[int, float]:
    """Context at the middle of a window, and the time since it began."""
    labels = walk.truth.labels
    middle_s = window.time_s - 1.0
    k = min(int(np.searchsorted(labels["end_s"], middle_s, side="right")), len(labels) - 1)
    first = k
    while first and labels["context"][first - 1] == labels["context"][k]:
        first -= 1
    return CONTEXTS.index(str(labels["context"][k])), middle_s - float(labels["start_s"][first])


def simulated_walk(seed: int) -> Recording:
    """A person of the simulator's population on a walk through all contexts but sideways, in the hand."""
    rng = np.random.default_rng(seed)
    flights = [Leg("upstairs", distance_m=0.29 * rng.integers(12, 33)), Leg("downstairs", distance_m=0.29 * 20)]
    middle = [*flights, Leg("running", distance_m=float(rng.uniform(30, 60)))]
    legs = [Leg("stationary", duration_s=5.0)]
    for i in rng.permutation(len(middle)):
        legs += [
            Leg("walking", distance_m=float(rng.uniform(25, 60)), turn_rad=float(rng.choice([-1, 1]) * np.pi / 2)),
            middle[i],
        ]
    legs += [Leg("walking", distance_m=float(rng.uniform(25, 60))), Leg("stationary", duration_s=4.0)]
    return simulate(legs, Gait.random(seed), seed=seed, name=f"simulated_{seed}")


def simulated(tables: Tables, sets: Mapping[str, list[Walk]], n_walks: int = 24) -> None:
    """Distances of simulated walks, by the shipped model and with the windows of real people."""
    joined = sets["joined walks"]
    found: dict[str, list[dict[str, float]]] = {}
    true_m: list[float] = []
    for seed in range(n_walks):
        recording = simulated_walk(seed)
        true_m.append(float(recording.truth.segments["distance_m"].sum()))
        walk = walk_of(recording, "", default(recording.subject))
        # another person each time, then another walk of theirs
        change = contexts_of(joined[(N_WALKS * seed + seed // 12) % len(joined)], recording)
        events = [change(e) if isinstance(e, WindowContext) else e for e in walk.events]
        for name, each in (("real people", replace(walk, events=events)), ("the shipped model", walk)):
            found.setdefault(name, []).append(distances_m(each) | {"contexts known": walk.known_m})
    truth = np.array(true_m)
    rows = []
    for name, of_walks in found.items():
        columns = columns_of(of_walks)
        rows += [[f"windows of {name}", w, *error_cells(d, truth)] for w, d in columns.items()]
        known = np.array(columns.pop("contexts known"))
        if name == "real people":
            rows += [["the same, against the true contexts", w, *error_cells(d, known)] for w, d in columns.items()]
    about = f"{n_walks} simulated walks of {truth.min():.0f} to {truth.max():.0f} m."
    tables.write("weightings_simulated", ["contexts from", "weighting", *ERRORS], rows, about)


def main() -> None:
    parts = {"real": real, "evidence": evidence, "prior": prior, "simulated": simulated}
    parser = options(str(__doc__), *parts)
    parser.add_argument("--cache", type=Path, default=None, help="keeps windows and models")
    args = parser.parse_args()
    tables = Tables.of(__spec__.name, args)
    sets = sets_of(args.data, args.cache)
    for part in args.parts:
        parts[part](tables, sets)


if __name__ == "__main__":
    main()
