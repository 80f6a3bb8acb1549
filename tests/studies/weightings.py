"""HC, WC and IMM where contexts change: distances of people and sites that no classifier has seen.

usage: python -m tests.studies.weightings [distances] [paper] [--data DATA] [--cache FOLDER]
       python -m tests.studies.weightings distances --sets terrain,ipin2023     minutes, because nothing is trained

distances: the steps, windows and step lengths of a configuration are the same for all weightings. The reference is the
distance of these steps with the length of their true context, so that only errors of the contexts count. Classifiers:
the relevance vector machine, the forest and the blend of both in the default recipe, and the recipe martinelli2018 with
its own classifier and lengths. Each is trained without the people that it is scored on. Sets: recordings of MotionSense
joined to walks through all contexts; difronzo, with its real changes; terrain, a sensor at the leg that no classifier
has seen; one walk of ipin2023, stairs with the phone in the hand, where the barometer gives the truth; tyrex, level
walking of a held-out site. A step is uncertain if the second-highest probability of its window is at least 0.8 of the
highest. A change is between two steps of different contexts. Errors of the recordings of one person are averaged first;
intervals are those of Student's t over people.

paper: Tables V and VI of Martinelli et al. 2018 with the bias and the spread of their errors, and what remains if a
constant were subtracted.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

import pdr_filter as pdr
from models.training import context_training as contexts
from models.training.context_training import PLANS, ContextPlan, labelled_windows
from models.training.data_sets import DOUBTFUL, SCORED_DATASET, recordings_of
from pdr_filter.classifiers.blend import Mixture
from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.evaluate.comparison import second_over_first
from pdr_filter.evaluate.distance import distance_scores
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.offline.training.context_sequences import UNKNOWN
from pdr_filter.offline.training.cross_validation import LabelledWindows
from pdr_filter.recipes import default, martinelli2018, with_context_model
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.contexts.learned_contexts import LearnedContexts
from pdr_filter.sensing.front_end import Event
from pdr_filter.tracking.whole_recording import run_sensing
from pdr_filter.values import CONTEXTS, BoolArray, FloatArray, IntArray, Step
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, markdown_table, paths, say, timed
from tests.benchmarks.weightings import (
    LAG_STEPS,
    WALKING,
    cached,
    changes_storey,
    climbs_at,
    context_at,
    mixed_walk,
    on_the_level,
    tracked,
    updates_of,
)
from tests.studies.data import Part, person_of, run_study
from tests.studies.martinelli2018 import TABLE_V

CLASSIFIERS = ("rvm", "forest", "blend", "martinelli2018")
WEIGHTINGS = ("HC", "WC 0.8", "WC always", "IMM online", "IMM lagged", "IMM smoothed")
PLAN_OF = {plan.name: plan for plan in PLANS}
N_FOLDS = 4  # groups of people, each held out together, as in the training of the shipped models
WC_THRESHOLD = 0.8  # of Algorithm 2
NEAR_S = 3.0  # largest time from a step to a change of context that is near


# Table VI: error of the distance in each context, mean of the subjects, %.
TABLE_VI = {
    "HC": {"walking": -8.5, "upstairs": 6.2, "downstairs": -5.5, "running": -4.8},
    "WC": {"walking": -5.1, "upstairs": 3.4, "downstairs": -4.2, "running": -3.3},
}


# --- Walks of people who are held out --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Training:
    """Training windows of the default and of martinelli2018, from which people are held out."""

    data: Path
    cache: Path | None
    scored: Path  # folder of the recordings to score, which may be a part of the data

    @classmethod
    def of(cls, arguments: argparse.Namespace) -> Training:
        """Training of the arguments; the cache of a folder without some training sets is another one."""
        cache: Path | None = arguments.cache
        missing = [name for name in TRAINED_ON if not paths(arguments.whole, name)]
        if cache is not None and missing:
            cache /= "without_" + "_".join(missing)
        return cls(arguments.whole, cache, arguments.data)

    def windows(self, plan: ContextPlan) -> LabelledWindows:
        """All windows that a shipped model is trained on."""

        def made() -> LabelledWindows:
            with timed(f"training windows of {plan.name}"):
                return plan.of(labelled_windows(recordings_of(self.data, plan.datasets), feature_set=plan.feature_set))

        return cached(self.cache, f"windows_{plan.name}", made)

    def models(self, people: Sequence[str], name: str) -> dict[str, ContextModel]:
        """The models of all classifiers, trained without some people."""

        def without(shipped: str) -> ContextModel:
            plan = PLAN_OF[shipped]
            if not people:
                return load_model(shipped)
            windows = self.windows(plan)
            with timed(f"model {shipped} without {len(people)} people"):
                return contexts.model_without(load_model(shipped), plan, windows, people)

        blend = cached(self.cache, f"blend_{name}", lambda: without("context"))
        found = {"blend": blend}
        assert isinstance(blend.machine, Mixture)
        for part, number in PLAN_OF["context"].parts.items():
            alone = load_model(f"context_{part}")
            machine = blend.machine.parts[number]
            found[part] = replace(blend, machine=machine, temperature=alone.temperature, slip=alone.slip)
        paper = cached(self.cache, f"martinelli_{name}", lambda: without("context_martinelli_rvm"))
        return found | {"martinelli2018": paper}


def configs(recording: Recording, models: Mapping[str, ContextModel]) -> dict[str, Config]:
    """The configuration of each classifier."""
    own = {name: with_context_model(default(recording.subject), models[name]) for name in CLASSIFIERS[:-1]}
    paper = martinelli2018(recording.subject)
    stage = paper.sensing.contexts
    assert isinstance(stage, LearnedContexts)
    stage = replace(stage, models=replace(stage.models, with_gyroscope=models["martinelli2018"]))
    return own | {"martinelli2018": replace(paper, sensing=replace(paper.sensing, contexts=stage))}


def folds(training: Training, dataset: str) -> Iterator[tuple[list[str], Mapping[str, ContextModel]]]:
    """People of a data set who are held out together, with the models. People of both scored sets are in each fold.

    Folds without recordings to score are omitted.
    """
    there = {f"{dataset}/{person_of(path)}" for path in paths(training.scored, dataset)}
    known = {str(person) for person in training.windows(PLAN_OF["context"]).person}
    of_set = {name: sorted(p for p in known if p.startswith(f"{name}/")) for name in contexts.SCORED_DATASETS}
    for k in range(N_FOLDS):
        held = [person for people in of_set.values() for person in people[k::N_FOLDS]]
        if people := [person for person in of_set[dataset][k::N_FOLDS] if person in there]:
            yield people, training.models(held, f"fold_{k}")


def joined(training: Training) -> Iterator[tuple[Recording, str, Mapping[str, ContextModel]]]:
    """Recordings of MotionSense that follow each other, two walks of each of twelve people."""
    for people, models in folds(training, "motionsense"):
        for person in people:
            for number in (0, 1):
                yield mixed_walk(training.scored, "s" + person.split("/")[1][-2:], number), person, models


def difronzo(training: Training) -> Iterator[tuple[Recording, str, Mapping[str, ContextModel]]]:
    """Walks of four people with real changes, the phone in a trouser pocket."""
    recordings = [pdr.read(path) for path in recordings_of(training.scored, ("difronzo",))]
    for people, models in folds(training, "difronzo"):
        yield from ((r, p, models) for r in recordings if (p := f"difronzo/{r.subject.id}") in people)


def unseen(training: Training, site: str) -> Iterator[tuple[Recording, str, Mapping[str, ContextModel]]]:
    """Recordings of a site that no model has seen."""
    of_site = list[str]()
    if site in PLAN_OF["context"].datasets:
        known = training.windows(PLAN_OF["context"]).person
        of_site = sorted({str(p) for p in known if str(p).startswith(f"{site}/")})
    models = training.models(of_site, site)
    for path in paths(training.scored, site):
        recording = pdr.read(path)
        yield recording, f"{site}/{recording.subject.id or recording.name.split('_')[2]}", models


# Data sets of the models that are trained without people.
TRAINED_ON = tuple(dict.fromkeys((*PLAN_OF["context"].datasets, *PLAN_OF["context_martinelli_rvm"].datasets)))
SETS = {
    "joined walks": joined,
    "difronzo": difronzo,
    "terrain": lambda training: unseen(training, "terrain"),
    "ipin2023, stairs": lambda training: (w for w in unseen(training, "ipin2023") if changes_storey(w[0])),
    "tyrex, level": lambda training: unseen(training, "tyrex"),
}

DATA_SET = {name: {"joined walks": SCORED_DATASET}.get(name, name.split(",")[0]) for name in SETS}


@dataclass(frozen=True, eq=False)
class Walk:
    """Of a recording: what the front end found, without steps whose context is not known."""

    recording: Recording
    person: str
    config: Config
    events: list[Event]
    label: IntArray  # (K,) true context of each step

    @property
    def length_m(self) -> FloatArray:
        """Length of each step in each mode, (K, M); the default's modes are the contexts."""
        return np.array([self.config.model.lengths(e)[0] for e in self.events if isinstance(e, Step)])


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


# --- Distances -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Distances:
    """Step lengths of one walk by each weighting, and by the true contexts."""

    walk: Walk

    @property
    def person(self) -> str:
        """Person who walked."""
        return self.walk.person

    @cached_property
    def time_s(self) -> FloatArray:
        """Times of the steps, (K,)."""
        return np.array([e.time_s for e in self.walk.events if isinstance(e, Step)])

    @cached_property
    def known_m(self) -> FloatArray:
        """Lengths of the steps in their true contexts, (K,)."""
        return self.walk.length_m[np.arange(len(self.walk.label)), self.walk.label]

    @cached_property
    def found_m(self) -> dict[str, FloatArray]:
        """Lengths of the steps (K,) by each weighting."""
        walk, model = self.walk, self.walk.config.model
        hc = tracked(walk.events, walk.config, "hc")
        found = {"HC": np.diff([u.walked_m for u in hc], prepend=0.0)}
        for name, threshold in (("WC 0.8", WC_THRESHOLD), ("WC always", 0.0)):
            updates = updates_of(WeightedTracker(model, threshold), walk.events)
            found[name] = np.diff([u.walked_m for u in updates], prepend=0.0)
        imm = tracked(walk.events, walk.config, "imm")
        prob = np.array([u.mode_prob for u in imm])
        hindsight = walk.config.in_hindsight()
        later = np.array([u.mode_prob for u in tracked(walk.events, hindsight, "imm")])
        return found | {
            "IMM online": np.array([u.step_length_m for u in imm]),
            "IMM lagged": (smoothed_mode_prob(prob, model.transition_prob, LAG_STEPS) * walk.length_m).sum(axis=1),
            "IMM smoothed": (smoothed_mode_prob(later, hindsight.model.transition_prob) * walk.length_m).sum(axis=1),
        }

    @cached_property
    def is_uncertain(self) -> BoolArray:
        """Mask (K,) of the steps whose window has two contexts that are nearly equally probable."""
        prob = np.array([u.context_prob for u in tracked(self.walk.events, self.walk.config, "hc")])
        return np.asarray(second_over_first(prob) >= WC_THRESHOLD)

    def error_percent(self, weighting: str, use: BoolArray | None = None) -> float:
        """Error of the distance of some steps, NaN if these have no distance."""
        use = np.ones(len(self.known_m), dtype=bool) if use is None else use
        known_m = self.known_m[use].sum()
        return 100 * float(self.found_m[weighting][use].sum() / known_m - 1) if known_m > 1 else np.nan

    @cached_property
    def is_near_change(self) -> BoolArray:
        """Mask (K,) of the steps near a change of context."""
        changes = np.flatnonzero(np.diff(self.walk.label))
        change_s = self.time_s[np.concatenate([changes, changes + 1])]
        return (np.abs(self.time_s[:, None] - change_s) <= NEAR_S).any(axis=1)

    def in_context(self, context: str) -> BoolArray:
        """Mask (K,) of the steps in a context."""
        return np.asarray(self.walk.label == CONTEXTS.index(context))


def climbing(recording: Recording, person: str, config: Config) -> Walk:
    """A walk whose truth is the climb rate of the barometer, which the classifier does not get."""
    found = run_sensing(config.sensing, replace(recording, barometer=None))[1]
    time_s = np.array([e.time_s for e in found if isinstance(e, Step)])
    return Walk(recording, person, config, found, climbs_at(recording, time_s))


def walks_of(training: Training, name: str) -> dict[str, list[Distances]]:
    """Walks of a set by classifier."""
    found: dict[str, list[Distances]] = {classifier: [] for classifier in CLASSIFIERS}
    for recording, person, models in SETS[name](training):
        for classifier, config in configs(recording, models).items():
            walk = (
                climbing(recording, person, config)
                if "stairs" in name
                else walk_of(recording, person, config, "level" in name)
            )
            if len(walk.label) >= 20:
                found[classifier].append(Distances(walk))
    return found


def over_people(values: Sequence[float], people: Sequence[str]) -> str:
    """Mean over people of the mean absolute error of each, with the half width of its 95 % interval; - without any."""
    from scipy.stats import t as student

    e, who = np.abs(np.asarray(values, dtype=float)), np.asarray(people)
    each = np.array([np.nanmean(e[who == p]) for p in np.unique(who) if np.isfinite(e[who == p]).any()])
    if not len(each):
        return "-"
    half = student.ppf(0.975, len(each) - 1) * each.std(ddof=1) / np.sqrt(len(each)) if len(each) > 1 else np.nan
    return f"{each.mean():.1f}" + ("" if np.isnan(half) else f" ± {half:.1f}")


def distances(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors of the distance by set, classifier and weighting: whole walks, near changes, bias, and by context."""
    training = Training.of(arguments)
    whole, near, bias, by_context = (list[list[str]]() for _ in range(4))
    columns = ["walks (people)", "classifier", "uncertain %", *WEIGHTINGS]
    for name in SETS:
        if not paths(training.scored, DATA_SET[name]):
            continue
        if DATA_SET[name] in TRAINED_ON and not paths(training.data, SCORED_DATASET):
            say(f"{name}: left out, because models without people must be trained on {SCORED_DATASET}")
            continue
        say(f"{name}: begins")
        with timed(f"{name}, steps and contexts"):
            found = walks_of(training, name)
        n_before = len(whole)
        for classifier, walks in found.items():
            if not walks:
                say(f"{name}, {classifier}: no walks of the chosen people")
                continue
            start = time.perf_counter()
            people = [w.person for w in walks]
            uncertain = 100 * np.mean(np.concatenate([w.is_uncertain for w in walks]))
            about = [f"{name} ({len(walks)} of {len(set(people))})", classifier]
            errors = {w: [walk.error_percent(w) for walk in walks] for w in WEIGHTINGS}
            changes = {w: [walk.error_percent(w, walk.is_near_change) for walk in walks] for w in WEIGHTINGS}
            whole.append([*about, f"{uncertain:.1f}", *(over_people(e, people) for e in errors.values())])
            near.append([*about, *(over_people(e, people) for e in changes.values())])
            spread = [f", {np.std(e, ddof=1):.1f}" if len(e) > 1 else "" for e in errors.values()]
            bias.append([*about, *(f"{np.mean(e):+.1f}{s}" for e, s in zip(errors.values(), spread, strict=True))])
            if name == "joined walks":
                for context in TABLE_VI["HC"]:
                    each = [[walk.error_percent(w, walk.in_context(context)) for walk in walks] for w in WEIGHTINGS]
                    by_context.append([context, classifier, *(over_people(e, people) for e in each)])
            say(f"{name}, {classifier}: {time.perf_counter() - start:.0f} s")
        if rows := whole[n_before:]:
            print(f"\n{markdown_table(columns, rows)}", flush=True)
    if not whole:
        raise SystemExit("no walk of the chosen data sets and people can be scored: choose others with --sets")
    mean = "Mean absolute error of the distance in %, over people, with 95 % interval"
    tables.write("weightings_study", columns, whole, f"{mean}. Uncertain: share of the steps.")
    short = [[cell.split(" ±")[0] for cell in row] for row in whole if row[0].startswith(("joined", "difronzo"))]
    if short:
        tables.write("weightings_readme", columns, short, "Mean absolute error of the distance in %, over people.")
    columns.remove("uncertain %")
    tables.write("weightings_changes", columns, near, f"{mean}, of the steps within 3 s of a change of context.")
    tables.write("weightings_bias", columns, bias, "Bias and spread over walks, %.")
    columns[0] = "context"
    if by_context:
        tables.write("weightings_contexts", columns, sorted(by_context), f"Joined walks. {mean}.")


# --- The paper -------------------------------------------------------------------------------------------------------


def bias_and_spread(errors: Sequence[float]) -> list[str]:
    """Cells: root mean square, bias and spread."""
    scores = distance_scores(errors)
    return [f"{scores.rmse_percent:.2f}", f"{scores.bias_percent:+.2f}", f"{scores.spread_percent:.2f}"]


def paper(tables: Tables, arguments: argparse.Namespace) -> None:
    """Write Tables V and VI of the paper beside our errors on the joined walks."""
    walks = walks_of(Training.of(arguments), "joined walks")["martinelli2018"]
    errors: dict[str, list[float]] = {
        f"paper, {name}": list(found) for name, found in (("HC", TABLE_V["hc"]), ("WC", TABLE_V["wc"]))
    }
    gain = float(np.mean(TABLE_V["wc"]) - np.mean(TABLE_V["hc"]))
    errors[f"paper, HC {gain:+.1f} points"] = [e + gain for e in TABLE_V["hc"]]
    people = sorted({w.person for w in walks})
    for weighting in WEIGHTINGS:
        of_person = [[w.error_percent(weighting) for w in walks if w.person == p] for p in people]
        errors[f"ours, {weighting}"] = [float(np.mean(each)) for each in of_person]
    rows = [[name, str(len(found)), *bias_and_spread(found)] for name, found in errors.items()]
    about = "Error of the total distance in % (Table V), over people. Ours: martinelli2018 on the joined walks."
    tables.write("martinelli2018_table_v", ["", "people", "RMSE", "bias", "spread"], rows, about)
    names = list(TABLE_VI["HC"])
    rows = [[f"paper, {name}", *(f"{found[c]:+.1f}" for c in names)] for name, found in TABLE_VI.items()]
    for weighting in WEIGHTINGS:
        means = [np.nanmean([w.error_percent(weighting, w.in_context(c)) for w in walks]) for c in names]
        rows.append([f"ours, {weighting}", *(f"{mean:+.1f}" for mean in means)])
    tables.write("martinelli2018_table_vi", ["", *names], rows, "Mean error of the distance in each context, %.")


if __name__ == "__main__":
    run_study(
        __doc__,
        Part(make=distances, uses=tuple(DATA_SET.values()), trained_on=TRAINED_ON),
        Part(make=paper, needs=(SCORED_DATASET,), trained_on=TRAINED_ON),
        cache=None,
    )
