"""Training of all shipped models, and the estimation of transitions and exponents with models of the same people.

`make models` trains the models (`make_models`). `fit_contexts` fits models on other data.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from models.training import carrying_training as carrying
from models.training import context_training as contexts
from models.training import guo2018_training as guo2018
from models.training.data_sets import part_progress, recordings_of
from pdr_filter.data.io.formats import read
from pdr_filter.offline.training.cross_validation import Progress, calibrate_fits, fit_groups, silent
from pdr_filter.offline.training.transition_training import (
    DEFAULT_MODEL,
    ModelWithout,
    changing_recordings,
    shipped_model_without,
    train_evidence,
)


def train(data_dir: Path, out_dir: Path, progress: Progress = silent) -> list[dict[str, Any]]:
    """Train the models, estimate the transitions, save both to `out_dir`, and return the cards.

    `data_dir` has one folder per data set. The files are `<name>.npz`, `<name>.json` and `transitions.json`. ValueError
    if there are no recordings to train on.
    """
    wanted = sorted({d for plan in contexts.PLANS for d in plan.datasets})
    paths = recordings_of(data_dir, wanted)
    if not paths:
        raise ValueError(f"{data_dir} has none of the data sets {wanted}; give the folder that contains their folders")
    # before the models are trained, so that an unreadable recording raises its error at once
    changing = changing_recordings(paths, read)
    cards, default_without = train_models(paths, out_dir, part_progress(progress, 0.0, 0.99))
    with threadpool_limits(1):
        return [*cards, train_evidence(changing, read, out_dir, default_without, part_progress(progress, 0.99, 0.01))]


def train_models(
    paths: Sequence[Path], out_dir: Path, progress: Progress = silent, without: Collection[str] = ()
) -> tuple[list[dict[str, Any]], ModelWithout]:
    """Train the models on these recordings, and save them to `out_dir`. Models named in `without` are not trained.

    Return the cards, and a function that trains the context model of the default recipe without some people.
    """
    cards, default_without = _train_contexts(paths, out_dir, part_progress(progress, 0.0, 0.85), without)
    with threadpool_limits(1):
        plans = [plan for plan in carrying.PLANS if plan.name not in without]
        cards += carrying.train_carrying(paths, out_dir, part_progress(progress, 0.85, 0.1), plans=plans)
        if guo2018.PLAN.name not in without:
            cards.append(guo2018.train_guo(paths, out_dir, part_progress(progress, 0.95, 0.05)))
    return cards, default_without


def _train_contexts(
    paths: Sequence[Path], out_dir: Path, progress: Progress, without: Collection[str]
) -> tuple[list[dict[str, Any]], ModelWithout]:
    """Train and save the context models as `train_models` does, with the same results."""
    cards: list[dict[str, Any]] = []
    default_without: ModelWithout = shipped_model_without
    wanted = [plan for plan in contexts.PLANS if not set(plan.model_names) <= set(without)]
    share, n_done = 1 / max(len(wanted), 1), 0
    for kind in sorted({(plan.feature_set, plan.has_gyroscope) for plan in wanted}):
        plans = [plan for plan in wanted if (plan.feature_set, plan.has_gyroscope) == kind]
        start, span = n_done * share, len(plans) * share
        windows = contexts.labelled_windows(paths, part_progress(progress, start, 0.2 * span), *kind)
        for i, plan in enumerate(plans):
            own, start_of_own = plan.of(windows), start + 0.2 * span + 0.8 * i * share
            fits = fit_groups(plan, own, part_progress(progress, start_of_own, 0.8 * share))
            model = calibrate_fits(plan, own, fits)
            parts = (plan.fits_of_part(fits, part) for part in plan.parts)
            for each in (model, *(calibrate_fits(of_part, own, of_fits) for of_part, of_fits in parts)):
                each.save(out_dir)
                cards.append(each.card)
            progress(f"{plan.name}: saved", start_of_own + 0.8 * share)
            if plan.name == DEFAULT_MODEL:
                default_without = partial(contexts.model_without, model, plan, own)
        n_done += len(plans)
    return cards, default_without
