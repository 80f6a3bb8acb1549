"""Tian et al. 2016: how the phone is carried, step lengths of people of any height, tracks with compensated heading.

Counted steps and carrying modes are of ubicomp13, tracks of humolire (phone in the hand) and tyrex (a room of 5 m).
Nobody changes the carrying mode on a public walk of known path: those walks are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from pdr_filter.evaluate.comparison import straight_leg_error_percent
from pdr_filter.evaluate.steps import count_error_percent
from pdr_filter.evaluate.tracks import end_error_percent, path_m, position_errors_m, positions_at
from pdr_filter.recipes import tian2016
from pdr_filter.tracking.whole_recording import classify, run_sensing, track
from pdr_filter.values import Step
from pdr_filter.values.recording import Recording
from tests.studies.data import has, recordings
from tests.studies.measured.tian2016 import (
    RECIPES,
    TRANS,
    Carried,
    Counted,
    Size,
    counted_of,
    fits_of,
    modes_said,
    round_corners,
    scaled,
    scores_of,
    straight_walks,
)
from tests.studies.printed.tian2016 import (
    FALSE,
    MISSED,
    MODES,
    PAPER,
    PATH_M,
    TABLE_IX,
    TABLE_VI,
    TABLE_VII,
    TABLE_VIII,
    Printed,
    printed_checks,
)
from tests.studies.report import Study, StudyTable

Rows = tuple[Mapping[str, object], ...]
Row = dict[str, object]


def _table_vi_real(tian: Sequence[Counted], by_default: Sequence[Counted]) -> Rows:
    """Per cent of the recordings of each true mode."""
    rows: list[Row] = []
    for i, found in enumerate((*MODES, TRANS)):
        row: Row = {"": f"classified as {found}" if found != TRANS else "no mode"}
        for j, true in enumerate(MODES):
            row[f"paper {true}"] = float(TABLE_VI[i, j]) if found != TRANS else np.nan
            for name, counted in (("ours", tian), ("ours default", by_default)):
                own = [c.most == found for c in counted if c.true == true]
                row[f"{name} {true}"] = 100.0 * float(np.mean(own)) if own else np.nan
        rows.append(row)
    return tuple(rows)


def _table_viii_steps(tian: Sequence[Counted], by_default: Sequence[Counted]) -> Rows:
    """Steps in per cent of the true ones, of the totals as the paper counts, and absolute errors walk by walk."""
    rows: list[Row] = []
    for printed in TABLE_VIII:
        row: Row = {"mode": printed.name, "n": sum(c.true == printed.name for c in tian)}
        row["paper, % of steps"] = printed.percent
        for name, counted in (("ours", tian), ("ours default", by_default)):
            own = [c for c in counted if c.true == printed.name]
            n_true = np.array([c.n_true for c in own], dtype=float)
            n_found = np.array([c.n_found for c in own], dtype=float)
            row[f"{name}, % of steps"] = float(100 * n_found.sum() / n_true.sum()) if own else np.nan
            row[f"{name}, mean absolute error, %"] = (
                float(np.abs(count_error_percent(n_found, n_true)).mean()) if own else np.nan
            )
        rows.append(row)
    return tuple(rows)


def _table_vi_simulated(size: Size) -> Rows:
    """Of all transitions that were seen, the modes found; those missed and those invented in per cent of all."""
    counts = np.zeros((4, len(MODES)))
    names = (*MODES, TRANS)
    n_missed = n_false = 0
    for walk, modes in straight_walks(size):
        windows = classify(walk, tian2016(walk.subject))
        found = Carried(windows.time_s, modes_said(windows.carrying_prob)).transitions()
        labels = walk.truth.labels
        assert labels is not None
        for start_s, true in zip(labels["start_s"][2:], modes, strict=True):
            # the phone is on the way for 1.2 s about the start of the leg
            own = [k for k, (t, _) in enumerate(found) if abs(t - start_s) <= 1.0]
            n_missed += not own
            if own:
                counts[names.index(found.pop(own[0])[1]), list(MODES).index(true)] += 1
        n_false += len(found)
    share = 100.0 * counts / np.maximum(counts.sum(axis=0), 1)
    rows: list[Row] = []
    for i, name in enumerate(MODES):
        row: Row = {"": f"classified as {name}"}
        for j, true in enumerate(MODES):
            row |= {f"paper {true}": float(TABLE_VI[i, j]), f"ours {true}": float(share[i, j])}
        rows.append(row)
    for name, printed, n in (("missed, all modes", MISSED, n_missed), ("false, all modes", FALSE, n_false)):
        nan: Row = {f"{who} {true}": np.nan for true in MODES for who in ("paper", "ours")}
        rows.append({"": name} | nan | {"paper HOLDING": printed, "ours HOLDING": 100.0 * n / size.n_transitions})
    return tuple(rows)


# Rows of Tables VIII and IX, and the paper's values.
_QUANTITIES: Mapping[str, Callable[[Printed], float]] = {
    "steps, % of the true ones": lambda p: p.percent,
    "distance, % of the true one": lambda p: 100.0 * p.distance_m / PATH_M,
    "largest heading error, degrees": lambda p: p.max_heading_deg,
    "median heading error, degrees": lambda p: p.median_heading_deg,
    "mean position error, m": lambda p: p.position_m,
}


def _track_rows(printed: Printed, walks: Sequence[Recording], smooth_s: float = 0.0) -> list[Row]:
    """Rows of one column of Table VIII or IX: medians over our walks."""
    found = {
        name: [scores_of(walk, track(walk, recipe(walk.subject)), smooth_s) for walk in walks]
        for name, recipe in RECIPES.items()
    }
    rows: list[Row] = []
    fields = ("steps_percent", "distance_percent", "max_heading_deg", "median_heading_deg", "position_m")
    for (quantity, of_paper), field in zip(_QUANTITIES.items(), fields, strict=True):
        row: Row = {"walk": printed.name, "n": len(walks), "": quantity, "paper": of_paper(printed)}
        ours = {k: float(np.median([getattr(s, field) for s in v])) for k, v in found.items()}
        if not np.isnan(list(ours.values())).all():
            rows.append(row | ours)
    return rows


def _humolire_rows(data: Path) -> Rows:
    """HOLDING at landmarks: mean over nine walks of what is known there."""
    found: dict[str, list[tuple[float, ...]]] = {name: [] for name in RECIPES}
    for walk in recordings(data, "humolire"):
        points = walk.truth.waypoints
        assert points is not None
        reference = np.column_stack([points.east_m, points.north_m])
        for name, recipe in RECIPES.items():
            own = track(walk, recipe(walk.subject))
            estimate = positions_at(own.time_s, own.position_m, points.time_s)
            position = position_errors_m(estimate, reference, "first")
            legs = 100.0 + straight_leg_error_percent(walk, own)
            share = 100.0 * position.mean() / path_m(reference)[-1]
            found[name].append((legs, float(position.mean()), share, end_error_percent(estimate, reference, "first")))
    holding = TABLE_VIII[0]
    names = {
        "distance of straight legs, % of the true one": _QUANTITIES["distance, % of the true one"](holding),
        "mean position error, m": holding.position_m,
        "mean position error, % of the path": 100.0 * holding.position_m / PATH_M,
        "end error, % of the path": np.nan,
    }
    return tuple(
        {"walk": "HOLDING", "n": len(found["ours"]), "": name, "paper": printed}
        | {who: float(np.median([v[k] for v in values])) for who, values in found.items()}
        for k, (name, printed) in enumerate(names.items())
        if found["ours"]
    )


def _table_vii(walks: Iterable[Recording]) -> tuple[Rows, int, int]:
    """Distances of one route, each model scaled so that their mean is 28 m; and how many walks of how many people."""
    found: dict[str, dict[str, list[float]]] = {name: {} for name in RECIPES}
    people: list[str] = []
    for walk in walks:
        labels, segments = walk.truth.labels, walk.truth.segments
        if labels is None or segments is None or str(labels["carrying_mode"][0]) != MODES["HOLDING"]:
            continue
        people.append(str(walk.subject.id))
        start_s, end_s = float(segments["start_s"][0]), float(segments["end_s"][0])
        for recipe_name, recipe in RECIPES.items():
            events = run_sensing(recipe(walk.subject).sensing, walk)[1]
            steps = [e for e in events if isinstance(e, Step) and start_s <= e.time_s <= end_s]
            for name, fit in fits_of(walk.subject).items():
                found[recipe_name].setdefault(name, []).append(sum(fit.predict(step)[0] for step in steps))
    rows: list[Row] = []
    for name, values in found["ours default"].items():
        ours, with_own = scaled(values), scaled(found["ours"][name])
        row: Row = {"distance, m": name}
        statistics = (ours.min(), ours.max(), np.median(ours), ours.std())
        for statistic, p, o in zip(
            ("minimum", "maximum", "median", "STD"), TABLE_VII.get(name, (np.nan,) * 4), statistics, strict=True
        ):
            row |= {f"paper {statistic}": p, f"ours {statistic}": float(o)}
        rows.append(row | {"ours STD, steps of tian2016": float(with_own.std())})
    return tuple(rows), len(people), len(set(people))


# --- The study -------------------------------------------------------------------------------------------------------


def study(data: Path, size: Size | None = None) -> Study:
    """Tables VI to IX on ubicomp13, humolire and tyrex, and on simulated walks.

    Parameters
    ----------
    data : Path
        Folder of the data sets.
    size : Size, optional
        Smaller for a quick look.
    """
    size = size or Size()
    *modes, steps = _table_vi(data, size)
    return Study(
        name="tian2016",
        paper=PAPER,
        tables=(*modes, _of_step_lengths(data), steps, *_of_single_mode(data, size), _of_multi_mode(size)),
        notes=(*printed_checks(), *_NOTES),
    )


_NOTES = (
    "Not remade: Tables I to V are the algorithms, in `pdr_filter.recipes.tian2016.contexts`, "
    "`pdr_filter.recipes.tian2016.steps` and "
    "`pdr_filter.recipes.tian2016.heading`; Tables X and XI compare with what other papers print. The largest "
    "processing time of an iteration depends on the machine: `tests/benchmarks/throughput.py` has ours. Trained "
    "offsets of Table IX belong to their trousers. Figures 10, 11, 13 and 15 are tracks on maps that are not public.",
    "Simulated transitions take 1.2 s, which nobody has measured, and many stay below R_y and R_z: how many are missed "
    "says more about the simulator than about the method.",
)


def _table_vi(data: Path, size: Size) -> list[StudyTable]:
    """Table VI on ubicomp13 and simulated, and the steps of Table VIII, which are of the same recordings."""
    counted: dict[str, list[Counted]] = {name: [] for name in RECIPES}
    for recording in recordings(data, "ubicomp13"):
        for name, recipe in RECIPES.items():
            own = counted_of(recording, recipe(recording.subject))
            if own is not None:
                counted[name].append(own)
    tian, by_default = counted["ours"], counted["ours default"]
    in_pocket = [c for c in tian if c.true == "POCKET"]
    who = f"ubicomp13, {len(tian)} walks of 13 people, phone in the hand or in a trouser pocket"
    seen = (
        f"the mode most often said in each walk, in per cent of the walks, where the paper has that after each "
        "transition. Nobody swings the phone. Each phone in a pocket was put there before its walk: a transition was "
        f"seen before {sum(c.moved_before for c in in_pocket)} of {len(in_pocket)} of these walks; inside all walks "
        f"{sum(c.n_transitions for c in tian)} false ones. The default gives the mode of every window"
    )
    real = _table_vi_real(tian, by_default) if tian else ()
    steps = _table_viii_steps(tian, by_default) if tian else ()
    missing = "ubicomp13 is not in the folder: nothing measured"
    return [
        StudyTable("Table VI: mode classification, %", real, who if tian else missing, seen),
        StudyTable(
            "Table VI, simulated: modes after transitions, %",
            _table_vi_simulated(size),
            f"simulated, {size.n_people} people, {size.n_transitions} transitions on straight walks of 80 m",
            "nobody walked this; the number of people and transitions is the paper's. Columns are the true mode; the "
            "last two rows are in per cent of all transitions",
        ),
        StudyTable(
            "Table VIII, steps: those found in per cent of those counted",
            steps,
            who if tian else missing,
            "many people in place of one, counted on video; totals as in the paper, where errors of walks cancel, and "
            "absolute errors of single walks. The thresholds of tian2016 were chosen on people 1 to 6 of these 13",
        ),
    ]


def _of_step_lengths(data: Path) -> StudyTable:
    title = "Table VII: distances by four step-length models, scaled to a mean of 28 m"
    if not has(data, "ubicomp13"):
        return StudyTable(title, (), "ubicomp13 is not in the folder: nothing measured", "nothing to compare", 2)
    rows, n_walks, n_people = _table_vii(recordings(data, "ubicomp13"))
    return StudyTable(
        title,
        rows,
        f"ubicomp13, {n_walks} walks of {n_people} people with the phone in the hand",
        "one route for all, whose length is not published: every model is scaled, also eq. (2), which the paper leaves "
        "as it is, and the ratio of the constants of men and women is the printed one. Heights are the middle of "
        "published ranges; everybody walks at several paces in one walk, where the paper has slow, moderate and fast "
        "ones. Steps are those of the default recipe, nearly all right, so that models are compared and not steps; "
        "last column: those of tian2016, some of which are false and quick, which eq. (9) takes for long. Kim's model "
        "has |f| - g in place of the vertical",
        2,
    )


def _of_single_mode(data: Path, size: Size) -> list[StudyTable]:
    humolire = _humolire_rows(data)
    tyrex: list[Row] = []
    for printed, name in zip(TABLE_VIII, ("texting", "swinging", "frontpocket"), strict=True):
        walks = [r for r in recordings(data, "tyrex", f"*_nodist_{name}.zip")]
        tyrex += _track_rows(printed, walks, smooth_s=1.0) if walks else []
    simulated: list[Row] = []
    for k, printed in enumerate(TABLE_VIII):
        simulated += _track_rows(printed, round_corners(printed, [printed.name], k, size.n_walks))
    return [
        StudyTable(
            "Table VIII: tracking in a single mode",
            humolire,
            f"humolire, {humolire[0]['n']} walks of one person of 1.86 m, HOLDING, medians"
            if humolire
            else "humolire is not in the folder: nothing measured",
            "219 to 239 m with many corners in place of 96 m with four; errors at 17 to 29 landmarks in place of every "
            "metre; turned and moved onto the first 20 % of the path, where the paper knows the start. The default's "
            "step length was fitted on these walks too",
            2,
        ),
        StudyTable(
            "Table VIII, in a room: tracking in a single mode",
            tuple(tyrex),
            "tyrex (nodist), one person, two minutes in each mode" if tyrex else "tyrex is not in the folder",
            "a room of 5 m in place of corridors: the walk is a string of turns, and the truth is the phone (mean over "
            "1 s). Height and gender are not known. The phone is in its place before the recording begins, so that "
            "the machine sees no transition and takes it to be held until something turns it fast; the offset is "
            "trained then. Steps are not known",
            2,
        ),
        StudyTable(
            "Table VIII, simulated: tracking in a single mode",
            tuple(simulated),
            f"simulated, {size.n_walks} walks of {PATH_M} m in each mode by people of 1.73 m, medians",
            "nobody walked this. Four right angles on sides of our own; HOLDING for the first 8 m, so that there is a "
            f"direction to train the offset with. {_SIMULATED_LENGTH}",
            2,
        ),
    ]


# measured on these walks
_SIMULATED_LENGTH = (
    "Simulated people have the step lengths of the simulator, which eq. (9) overestimates: the distance is no finding"
)


def _of_multi_mode(size: Size) -> StudyTable:
    rows: list[Row] = []
    for k, printed in enumerate(TABLE_IX):
        # the last walk of the paper has no SWING
        modes = ["POCKET", "HOLDING"] if k == len(TABLE_IX) - 1 else ["SWING", "POCKET"]
        rows += _track_rows(printed, round_corners(printed, modes, 10 + k, size.n_walks))
    return StudyTable(
        "Table IX: tracking in several modes",
        tuple(rows),
        f"simulated, {size.n_walks} walks of {PATH_M} m for each column by people of the printed height, medians",
        "nobody walked this: no public walk of known path has a change of the carrying mode. HOLDING, then SWING after "
        "8 m, then POCKET on the third side (the last walk without SWING), where the phone lies as "
        f"everybody likes. A transition that is missed costs the rest of the walk. {_SIMULATED_LENGTH}",
        2,
    )


if __name__ == "__main__":
    from tests.studies.run import run

    run(study)
