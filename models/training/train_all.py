"""Training of all shipped models, followed by the estimation of transitions and exponents.

`make models` runs it (`make_models`). `fit_contexts` fits models on other data.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from models.training import carrying_training as carrying
from models.training import context_training as contexts
from models.training import guo2018_training as guo2018
from models.training.data_sets import part_progress, recordings_of
from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.data.io.formats import read
from pdr_filter.offline.training.cross_validation import Progress, calibrate_fits, fit_groups, silent
from pdr_filter.offline.training.transition_training import (
    DEFAULT_MODEL,
    changing_recordings,
    shipped_model_without,
    train_evidence,
)


def train(data_dir: Path, out_dir: Path, progress: Progress = silent) -> list[dict[str, Any]]:
    """Train the models, save them to `out_dir`, and return their cards.

    `data_dir` has one folder per data set. The files are `<name>.npz`, `<name>.json` and `transitions.json`. ValueError
    if there are no recordings to train on.
    """
    wanted = sorted({d for plan in contexts.PLANS for d in plan.datasets})
    paths = recordings_of(data_dir, wanted)
    if not paths:
        raise ValueError(f"{data_dir} has none of the data sets {wanted}; give the folder that contains their folders")
    return train_on(paths, out_dir, progress)


def train_on(paths: Sequence[Path], out_dir: Path, progress: Progress = silent) -> list[dict[str, Any]]:
    """Train the models on these recordings, save them to `out_dir`, and return their cards."""
    # before the models are trained, so that an unreadable recording raises its error at once
    changing = changing_recordings(paths, read)
    cards, default_without = _train_contexts(paths, out_dir, part_progress(progress, 0.0, 0.85))
    with threadpool_limits(1):
        cards += carrying.train_carrying(paths, out_dir, part_progress(progress, 0.85, 0.1))
        cards.append(guo2018.train_guo(paths, out_dir, part_progress(progress, 0.95, 0.04)))
        return [*cards, train_evidence(changing, read, out_dir, default_without, part_progress(progress, 0.99, 0.01))]


def _train_contexts(
    paths: Sequence[Path], out_dir: Path, progress: Progress
) -> tuple[list[dict[str, Any]], Callable[[Sequence[str]], ContextModel]]:
    """Train and save the context models, and return their model cards and a function for cross-validation.

    The function trains the context model of the default recipe again, without the people whose names it receives.
    """
    cards: list[dict[str, Any]] = []
    default_without: Callable[[Sequence[str]], ContextModel] = shipped_model_without
    share, n_done = 1 / len(contexts.PLANS), 0
    for kind in sorted({(plan.feature_set, plan.has_gyroscope) for plan in contexts.PLANS}):
        plans = [plan for plan in contexts.PLANS if (plan.feature_set, plan.has_gyroscope) == kind]
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
            if plan.name == DEFAULT_MODEL:
                default_without = partial(contexts.model_without, model, plan, own)
        n_done += len(plans)
    return cards, default_without
