"""Whole walks of real people left out of a calibration, and of the choice of its form: docs/benchmarks.md.

usage: python -m tests.benchmarks.calibration_left_out [--data ../shared/data]

humolire: straight legs between landmarks; ms_indoor: between waypoints; oxiod and tyrex: walked lengths of stretches of
20 s along the path of a tracking system, lengths summed. Running, trolleys and a phone that is pointed around are left
out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

import pdr_filter as pdr
from pdr_filter.offline.calibration.fit import calibrate_segments
from pdr_filter.offline.calibration.model_forms import RECORDING_STD, best_form, forms_of, lengths, start_of
from pdr_filter.offline.calibration.segments import Segment, integrate, segments_of
from pdr_filter.recipes.step_length_calibration import Calibration
from pdr_filter.tracking.track import Track
from pdr_filter.values import table
from pdr_filter.values.recording import Recording, Truth
from tests.benchmarks.calibration import cut, walks
from tests.benchmarks.common import Tables, bias_spread_rms, options, recordings

FloatArray = NDArray[np.float64]


def along_the_path(recording: Recording, track: Track) -> Recording:
    """The recording with the walked lengths of stretches of 20 s as truth, from its continuous reference.

    Below 0.7 Hz: a phone sways with the body, and a body with its steps. Stretches with a hole of more than 1.5 s, or
    that were hardly walked, are left out.
    """
    path = recording.truth.position
    assert path is not None
    grid_s = np.arange(path.time_s[0], path.time_s[-1], 0.02)
    places = np.column_stack([np.interp(grid_s, path.time_s, path[name]) for name in ("east_m", "north_m")])
    smooth = sosfiltfilt(butter(2, 0.7 / 25, output="sos"), places, axis=0)
    length_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(smooth, axis=0).T))])
    edges_s = np.arange(max(path.time_s[0], track.time_s[0] - 0.5), min(path.time_s[-1], track.time_s[-1]), 20.0)
    walked = np.diff(np.interp(edges_s, grid_s, length_m))
    holes_s = path.time_s[1:][np.diff(path.time_s) > 1.5]
    stretches = zip(edges_s[:-1], edges_s[1:], walked, strict=True)
    good = [d > 3.0 and not ((holes_s > a) & (holes_s < b + 1.5)).any() for a, b, d in stretches]
    columns = {"start_s": edges_s[:-1][good], "end_s": edges_s[1:][good], "distance_m": walked[good]}
    segments = table(columns | {"n_steps": np.full(sum(good), np.nan)})
    return replace(recording, truth=Truth(segments=segments))


def five_sites(data: Path) -> dict[str, list[Segment]]:
    """Walking of one person each in four of them, and of 95 in a mall."""
    sites = {site: cut(walks(data, site)) for site in ("humolire", "ms_indoor")}
    for name, site, pattern in (
        ("oxiod, over a floor", "oxiod", "*floor1*.zip"),
        ("oxiod, in a room", "oxiod", "*room_[hp]*.zip"),
        ("tyrex", "tyrex", "*dist_[bfpst]*.zip"),
    ):
        found = [(r, pdr.track(r)) for r in recordings(data, site, pattern)]
        cut_out = [s for r, t in found for s in segments_of(along_the_path(r, t), t, measure="length")[0]]
        sites[name] = [replace(s, subject="one") for s in cut_out]
    return sites


def theta_of(found: Calibration, subjects: tuple[str, ...]) -> FloatArray:
    """Parameters of people (S, P), the population's of those who were not calibrated."""
    known = found.subject_ids
    return np.array([found.people[known.index(s)] if s in known else found.theta for s in subjects])


def each_walk_left_out(tables: Tables, sites: dict[str, list[Segment]]) -> None:
    """Every tenth of the walks (every one, if there are ten or fewer) from the others."""
    forms = forms_of()
    of_forms: list[list[object]] = []
    of_walks: list[list[object]] = []
    for site, segments in sites.items():
        names = list(dict.fromkeys(s.recording for s in segments))
        walk = np.array([names.index(s.recording) for s in segments])
        predicted = {name: np.empty(len(segments)) for name in (*forms, "chosen", "none")}
        picked: list[str] = []
        for k in np.unique(walk % 10):
            test = np.flatnonzero(walk % 10 == k)
            training = [segments[i] for i in np.flatnonzero(walk % 10 != k)]
            chosen, _ = best_form(training, forms, "gnc", RECORDING_STD)
            picked.append(chosen)
            for name, priors in forms.items():
                found = calibrate_segments(training, priors)
                own = integrate([segments[i] for i in test], found.models, start_of(priors))
                predicted[name][test] = lengths(own, theta_of(found, own.subjects))
                if name == "bounce":
                    start = np.concatenate([p.mean for p in priors.values()])
                    predicted["none"][test] = lengths(own, np.tile(start, (len(own.subjects), 1)))
            predicted["chosen"][test] = predicted[chosen][test]
        true = np.array([s.distance_m for s in segments])
        of_segments = {name: p / true - 1 for name, p in predicted.items()}
        total = {name: np.bincount(walk, p) / np.bincount(walk, true) - 1 for name, p in predicted.items()}
        both = [(of_segments[n], total[n]) for n in (*forms, "chosen")]
        cells = [" / ".join(f"{100 * np.sqrt(np.square(e).mean()):.1f}" for e in pair) for pair in both]
        times = ", ".join(f"{n} {picked.count(n)} x" for n in forms if n in picked)
        of_forms.append([site, f"{len(names)}, {len(segments)}", *cells, times])
        before, after = 100 * total["none"], 100 * total["bounce"]
        largest = f"{np.abs(after).max():.1f}"
        of_walks.append([site, len(names), bias_spread_rms(before), bias_spread_rms(after), largest])
    about = "Walks left out of the calibration and of the choice: RMS % of segments / of walks."
    columns = ["site", "walks, segments", *forms, "chosen", "what was chosen"]
    tables.write("calibration_forms", columns, of_forms, about)
    about = "Totals of walks left out, default form: bias, spread, RMS in %. In ms_indoor the others are other people."
    columns = ["site", "walks", "no calibration", "from the other walks", "largest error"]
    tables.write("calibration_left_out", columns, of_walks, about)


def main() -> None:
    arguments = options(__doc__).parse_args()
    each_walk_left_out(Tables.of(__spec__.name, arguments), five_sites(arguments.data))


if __name__ == "__main__":
    main()
