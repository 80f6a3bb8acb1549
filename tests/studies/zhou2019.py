"""Zhou et al. 2019: steps of walkers and runners against Levi and Judd's way, distances with seven length models.

Tables 4 to 8. A foot: the trials of pyshoe, with motion capture. A phone elsewhere: oxford, ubicomp13, humolire and
ms_indoor. Runners, of whom no public recording has counted steps, are simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from pdr_filter.evaluate.steps import StepScores
from pdr_filter.values import FloatArray
from tests.studies.data import people_left_out, recordings
from tests.studies.measured.zhou2019 import (
    MODELS,
    N_SIMULATED,
    SIMULATED_M,
    Counted,
    Walk,
    counted_on_foot,
    errors_percent,
    followed,
    foot_walk,
    simulated,
    success_percent,
    walk_of,
    without_the_person,
    without_the_walk,
)
from tests.studies.printed.zhou2019 import (
    PAPER_AVERAGE,
    PAPER_ERROR_M,
    PAPER_ERROR_PERCENT,
    PAPER_STEPS,
    PERSONS,
    paper_notes,
)
from tests.studies.report import NAN, Study, StudyTable, prefixed, together

# --- the study ------------------------------------------------------------------------------------------------------


def study(data: Path, n_simulated: int = N_SIMULATED, simulated_m: float = SIMULATED_M) -> Study:
    """Tables 4 to 8 of the paper, with what of it can be done on the recordings in a folder.

    Parameters
    ----------
    data : Path
        Of the data sets; uses `pyshoe`, `oxford`, `ubicomp13`, `humolire` and `ms_indoor`, those that are there.
    n_simulated : int
        Persons who walk and run; the paper has 205.
    simulated_m : float
        How far each of them walks, and runs.
    """
    counted: list[Counted] = []
    foot: list[Walk] = []
    for recording in recordings(data, "pyshoe"):
        counted.append(counted_on_foot(recording))
        foot.append(foot_walk(recording))
    carried = {"oxford": recordings(data, "oxford"), "ubicomp13": people_left_out(data)}
    counted += [followed(r).counted(source, "walking") for source, walks in carried.items() for r in walks]
    people: dict[str, list[Walk]] = {"walking": [], "running": []}
    for behaviour, walks in people.items():
        for person in range(1, n_simulated + 1):
            found = followed(simulated(person, behaviour, simulated_m))
            counted.append(found.counted("simulated", behaviour))
            walks += _present(walk_of(found))
    hand = {site: [w for r in recordings(data, site) for w in _present(walk_of(followed(r)))] for site in _SITES}
    return Study(
        name="zhou2019",
        paper="Z. Zhou, S. Mo, J. Wu, H. Fourati, Behaviors classification based distance measuring system for "
        "pedestrians via a foot-mounted inertial sensor, Asian Journal of Control 21(4), 2019",
        tables=(
            _counts_table("Table 4: steps by Levi and Judd's method", "Levi and Judd", counted, lambda c: c.levi_judd),
            _counts_table("Table 5: steps by the method of the paper (BCTFD)", "BCTFD", counted, lambda c: c.ours),
            _average_table(counted),
            _errors_table(people, hand),
            _average_errors_table(foot, people, hand),
        ),
        notes=(*paper_notes(), *_NOT_REMADE),
    )


_SITES = ("humolire", "ms_indoor")
_PLACES = {
    "pyshoe": "foot, pyshoe (motion capture)",
    "oxford": "phone, oxford (foot switches)",
    "ubicomp13": "phone, ubicomp13, persons 7 to 13 (video, counts only)",
    "simulated": "phone in a pocket, simulated",
}


def _present(walk: Walk | None) -> list[Walk]:
    return [] if walk is None else [walk]


def _groups(counted: Sequence[Counted]) -> Iterator[tuple[str, str, list[Counted]]]:
    """Behaviour, source, and walks of both, those that there are."""
    for behaviour in ("walking", "running"):
        for source in _PLACES:
            own = [c for c in counted if (c.behaviour, c.source) == (behaviour, source)]
            if own:
                yield behaviour, source, own


def _amount(counted: Sequence[Counted]) -> str:
    words = [
        f"{_PLACES[source]}, {behaviour}: {len(own)} recordings"
        + (f" of {len({c.person for c in own})} person(s)" if source != "pyshoe" else " of persons not stated")
        for behaviour, source, own in _groups(counted)
    ]
    return "; ".join(words) if words else "none of the data sets is in the folder"


def _counts_table(
    title: str, method: str, counted: Sequence[Counted], of: Callable[[Counted], StepScores]
) -> StudyTable:
    columns = ("true", "detected", "over-counted", "missed", "success %")
    none = (NAN,) * len(columns)
    rows: list[Mapping[str, object]] = []

    def add(behaviour: str, who: str, paper: Sequence[float], ours: Sequence[float]) -> None:
        rows.append(
            {"behaviour": behaviour, "of": who} | prefixed("paper", columns, paper) | prefixed("ours", columns, ours)
        )

    for behaviour, printed in PAPER_STEPS[method].items():
        for person, (true, detected, over, missed, _, success) in zip(PERSONS, printed, strict=True):
            add(behaviour, person, (true, detected, over, missed, success), none)
    for behaviour, source, own in _groups(counted):
        scores = together([of(c) for c in own])
        over, missed = scores.n_found - scores.n_matched, scores.n_true - scores.n_matched
        true, detected, more, less, wrong = (int(n) for n in np.sum(PAPER_STEPS[method][behaviour], axis=0)[:5])
        paper = (true, detected, more, less, 100.0 * (1.0 - wrong / true))
        ours = (scores.n_true, scores.n_found, over, missed, success_percent(scores))
        add(behaviour, f"{', '.join(PERSONS)} together; {_PLACES[source]}", paper, ours)
    return StudyTable(
        title,
        tuple(rows),
        _amount(counted),
        "Paper: strides of a foot on a stadium's lane, counted by the walkers. Ours: strides of a foot in a room of "
        "5 m, steps of a phone elsewhere, in walks of 10 strides to 400 m. A step is right if it matches one of the "
        "truth within half of the usual interval, a constant offset for each recording taken off; where only counts "
        "are known what is over-counted and missed in one walk cancels. Levi and Judd's method is what the paper says "
        "of it, with the band, spectra and thresholds of the other detector. Detector constants were chosen on every "
        "second trial of pyshoe and on persons 1 to 6 of ubicomp13.",
    )


def _average_table(counted: Sequence[Counted]) -> StudyTable:
    rows: list[Mapping[str, object]] = []
    for behaviour, source, own in _groups(counted):
        theirs, bctfd = PAPER_AVERAGE[behaviour]
        default = [c.default for c in own if c.default is not None]
        rows.append(
            {
                "behaviour": behaviour,
                "where": _PLACES[source],
                "recordings": len(own),
                "paper Levi and Judd %": theirs,
                "paper BCTFD %": bctfd,
                "ours Levi and Judd %": float(np.mean([success_percent(c.levi_judd) for c in own])),
                "ours BCTFD %": float(np.mean([success_percent(c.ours) for c in own])),
                "ours worst BCTFD %": min(success_percent(c.ours) for c in own),
                "ours default %": float(np.mean([success_percent(s) for s in default])) if default else NAN,
            }
        )
    return StudyTable(
        "Table 6: average success of step detection",
        tuple(rows),
        _amount(counted),
        "Paper: mean over 205 persons, at least 800 m each. Ours: mean over recordings; one step is 3 to 10 % of a "
        "trial of pyshoe and 1.3 % of a walk of ubicomp13. The default recipe is not made for a foot.",
    )


def _errors_table(people: Mapping[str, Sequence[Walk]], hand: Mapping[str, Sequence[Walk]]) -> StudyTable:
    real, others = hand["humolire"], hand["ms_indoor"]
    total_m = sum(w.true_m for w in real)
    shown = sorted({w.person for w in people["walking"]})[:4]
    rows: list[dict[str, object]] = []
    for behaviour in ("walking", "running"):
        for number, model in enumerate((*MODELS, "default")):
            is_paper = model in MODELS
            row: dict[str, object] = {"behaviour": behaviour, "model": model}
            for person, errors in zip(PERSONS, PAPER_ERROR_M[behaviour], strict=True):
                row[f"paper {person} m"] = errors[number] if is_paper else NAN
            own_m = NAN
            if behaviour == "walking" and real and (others or not is_paper):
                own_m = abs(_signed_m(real, model, lambda walk: others).sum())
            row["ours humolire m"] = own_m
            simulated_m = _simulated_m(people, behaviour, model) if people["walking"] else {}
            row |= {f"ours {person} m (simulated)": simulated_m[person] for person in shown}
            rows.append(row)
    far = [f"{np.mean([w.true_m for w in walks]):.0f} m {behaviour}" for behaviour, walks in people.items() if walks]
    return StudyTable(
        "Table 7: errors of the distance",
        tuple(rows),
        f"simulated persons {', '.join(shown) or 'none'} ({', '.join(far)}, phone in a pocket), and humolire: one "
        f"person, {len(real)} walks, {total_m:.0f} m of straight legs together",
        "Paper: a foot, 1200 m of walking and 800 m of running for each of four persons; how the parameters were "
        "calibrated is not said. Ours: parameters of the other simulated persons, and for humolire those of ms_indoor "
        "(other persons, another building). M1 to M6 have one set for walking and running, M7 one for each. `default` "
        "is the default recipe, whose one parameter was fitted on humolire and ms_indoor; on simulated people it is "
        "lost, because it takes half of their walking for stairs.",
    )


def _signed_m(walks: Sequence[Walk], model: str, rest: Callable[[Walk], Sequence[Walk]]) -> FloatArray:
    true_m = np.array([w.true_m for w in walks])
    if model == "default":
        return np.array([w.default_m for w in walks]) - true_m
    return true_m * errors_percent(walks, model, rest) / 100.0


def _simulated_m(people: Mapping[str, Sequence[Walk]], behaviour: str, model: str) -> dict[str, float]:
    """Absolute error in m of each simulated person, parameters of all others."""
    everyone = [w for walks in people.values() for w in walks]
    errors = np.abs(_signed_m(people[behaviour], model, without_the_person(everyone)))
    return dict(zip([w.person for w in people[behaviour]], errors.tolist(), strict=True))


def _average_errors_table(
    foot: Sequence[Walk], people: Mapping[str, Sequence[Walk]], hand: Mapping[str, Sequence[Walk]]
) -> StudyTable:
    humolire, mall = hand["humolire"], hand["ms_indoor"]
    everyone = [w for walks in people.values() for w in walks]

    def mean(walks: Sequence[Walk], model: str, rest: Callable[[Walk], Sequence[Walk]]) -> float:
        if not walks or (model in MODELS and not all(rest(w) for w in walks)):
            return NAN
        true_m = np.array([w.true_m for w in walks])
        return float(100.0 * np.mean(np.abs(_signed_m(walks, model, rest)) / true_m))

    rows: list[Mapping[str, object]] = []
    for number, model in enumerate((*MODELS, "default")):
        known = model in MODELS
        rows.append(
            {
                "model": model,
                "paper walking %": PAPER_ERROR_PERCENT["walking"][number] if known else NAN,
                "ours foot, other trials %": mean(foot, model, without_the_walk(foot)),
                "ours hand, own other walks %": mean(humolire, model, without_the_walk(humolire)),
                "ours hand, other persons %": mean(humolire, model, lambda walk: mall),
                "ours hand, other way round %": mean(mall, model, lambda walk: humolire),
                "ours walking, simulated %": mean(people["walking"], model, without_the_person(everyone)),
                "paper running %": PAPER_ERROR_PERCENT["running"][number] if known else NAN,
                "ours running, simulated %": mean(people["running"], model, without_the_person(everyone)),
            }
        )
    return StudyTable(
        "Table 8: average relative errors of the distance",
        tuple(rows),
        f"pyshoe: {len(foot)} trials of {sum(w.true_m for w in foot):.0f} m together, persons not stated; humolire: "
        f"{len(humolire)} walks of one person; ms_indoor: {len(mall)} walks of surveyors not stated; simulated: "
        f"{len(people['walking'])} persons who walk and {len(people['running'])} who run",
        "Paper: 205 persons on a stadium's lane. Ours: mean absolute error of walks with parameters of other trials of "
        "pyshoe (some of which may be of the same person), of the person's own other walks (humolire), of other "
        "persons in another building (humolire with those of ms_indoor; the other way round), of other simulated "
        "persons. Steps count by their part along the straight between two landmarks. A trial of pyshoe is 25 m, "
        "walked forwards, sideways and backwards. `default` is the default recipe as it is; its one parameter was "
        "fitted on humolire and ms_indoor, and it takes half of the simulated walking for stairs.",
        digits=2,
    )


# --- what the printed numbers say -----------------------------------------------------------------------------------

_NOT_REMADE = (
    "Tables 1 and 2 are algorithms (`pdr_filter.recipes.zhou2019`), Table 3 lists persons.",
    "Runners' steps on a foot are simulated nowhere: the simulator carries phones, in pockets and hands. pyshoe has "
    "one trial that runs.",
    "Step success by height (Fig. 6) needs persons of known height with counted steps; ubicomp13 states ranges only.",
)


if __name__ == "__main__":
    from tests.studies.run import run

    run(study)
