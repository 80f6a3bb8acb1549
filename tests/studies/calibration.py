"""Gain of a calibration of each recipe for one person: error of a walk's distance before, and after the other walks.

usage: python -m tests.studies.calibration

humolire, nine walks of one person with the phone in the hand. For each walk, the step lengths of a recipe are
calibrated on the other eight (`pdr.calibrate(walks, config=recipe)`, or `pdr-filter calibrate --recipe`). The error is
that of the summed straight legs by displacement. Parameters of martinelli2018 and zhou2019 were fitted with these
walks, so that their errors before are in sample.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping

import numpy as np

import pdr_filter as pdr
from pdr_filter.evaluate.distance import distance_scores, percent_error
from pdr_filter.evaluate.tracks import moved_m
from pdr_filter.recipes import RECIPES
from pdr_filter.tracking.track import Track
from pdr_filter.values.recording import Recording
from tests.benchmarks.common import Tables, recordings
from tests.studies.data import Part, paper_table, run_study


def error_percent(walk: Recording, track: Track) -> float:
    """Error of the summed straight legs."""
    legs = walk.truth.segments
    assert legs is not None
    found_m = moved_m(track.time_s, track.position_m, legs.start_s, legs.end_s).sum()
    return float(percent_error(found_m, legs.distance_m.sum()))


def gains(tables: Tables, arguments: argparse.Namespace) -> None:
    """Errors of held-out walks before and after the calibration."""
    walks = [r for r in recordings(arguments.data, "humolire") if r.truth.segments is not None]
    rows: list[Mapping[str, object]] = []
    for name, recipe in RECIPES.items():
        config = recipe(walks[0].subject)
        before = [pdr.track(walk, config, gnss="off") for walk in walks]
        after: list[float] = []
        for k, walk in enumerate(walks):
            others = [w for i, w in enumerate(walks) if i != k]
            known = [t for i, t in enumerate(before) if i != k]
            calibration = pdr.calibrate(others, tracks=known, config=config)
            after.append(error_percent(walk, pdr.track(walk, config, calibration=calibration, gnss="off")))
        row: dict[str, object] = {"recipe": f"`{name}`"}
        own = [error_percent(walk, track) for walk, track in zip(walks, before, strict=True)]
        for when, errors in (("before", own), ("after", after)):
            scores = distance_scores(np.array(errors))
            row |= {f"{when} %RMSE": scores.rmse_percent, f"{when} bias %": scores.bias_percent}
        rows.append(row)
    title = "Distance of held-out walks before and after a calibration on the person's other walks"
    paper_table(tables, "calibrated_recipes", title, rows, f"humolire, {len(walks)} walks of one person")


if __name__ == "__main__":
    run_study(__doc__, Part(make=gains, needs=("humolire",)))
