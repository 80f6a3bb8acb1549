"""The filter run several times on one recording, for a comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.weighting import WEIGHTINGS
from pdr_filter.recipes.config import Config
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import default_config, track
from pdr_filter.values import FloatArray, Table, TrackRows, steps_of, table
from pdr_filter.values.recording import Recording


def weighting_tracks(
    recording: Recording, config: Config | None = None, progress: Callable[[float], None] | None = None
) -> dict[str, Track]:
    """Tracks of the recording with HC, WC and IMM, all else alike, by the default recipe if no `config` is given.

    `progress` is called with the fraction done, 0 to 1.
    """
    tracks: dict[str, Track] = {}
    for i, name in enumerate(WEIGHTINGS):

        def show(fraction: float, i: int = i) -> None:
            if progress is not None:
                progress((i + fraction) / len(WEIGHTINGS))

        tracks[name] = track(recording, config, name, progress=show, gnss="off")
    return tracks


def weighting_errors(recording: Recording, config: Config | None = None, lag_steps: int = 4) -> Table:
    """What contexts cost: a row for each weighting, columns `weighting, distance_m, error_percent`.

    All take the same steps and lengths; the errors are against these lengths in the true contexts of the recording's
    labels. Steps outside of the labels do not count. WC has the threshold 0.8, and 0, which always weights. The IMM is
    as its steps were made; as walked distance, which knows of each step what was known in the end; with the evidence
    of `lag_steps` more steps, two seconds of walking; and in hindsight. ValueError without labels, or if the modes of
    the configuration are not the contexts, each once.
    """
    labels = recording.truth.labels
    config = config or default_config(recording)
    model = config.model
    model.check_one_mode_for_each_context()
    weighted = {name: track(recording, config, name, gnss="off") for name in ("hc", "wc", "imm")}
    weighted["wc, always"] = track(recording, replace(config, tracker=WeightedTracker(model, 0.0)), gnss="off")
    imm = weighted.pop("imm")
    label = np.full(imm.n_steps, -1)
    for row in () if labels is None else labels:
        if row["context"] in model.contexts:
            inside = (imm.time_s >= row["start_s"]) & (imm.time_s < row["end_s"])
            label[inside] = model.context_index.index(model.contexts.index(str(row["context"])))
    use = label >= 0
    if not use.any():
        raise ValueError(f"no step of {recording.name} is inside a truth label with a known context: label it first")
    length_m = np.array([model.lengths(step)[0] for step in steps_of(imm.steps)]).reshape(-1, len(model.modes))[use]
    known_m = length_m[np.arange(len(length_m)), label[use]].sum()
    in_hindsight = track(recording, config.in_hindsight().with_weighting("imm"), gnss="off").mode_prob
    prob = {
        "imm": smoothed_mode_prob(imm.mode_prob, model.transition_prob),
        "imm, lagged": smoothed_mode_prob(imm.mode_prob, model.transition_prob, lag_steps),
        "imm, smoothed": smoothed_mode_prob(in_hindsight, model.transition_prob),
    }
    distance_m = {name: t.step_length_m[use].sum() for name, t in weighted.items()}
    distance_m["imm, as the steps were made"] = imm.step_length_m[use].sum()
    distance_m |= {name: (p[use] * length_m).sum() for name, p in prob.items()}
    found_m = np.array([*distance_m.values(), known_m])
    return table(
        {
            "weighting": np.array([*distance_m, "contexts known"]),
            "distance_m": found_m,
            "error_percent": percent_error(found_m, np.full(len(found_m), known_m)),
        }
    )


def threshold_sweep(recording: Recording, config: Config, thresholds: Sequence[float]) -> Table:
    """Distance with WC at each threshold, columns `threshold, distance_m`.

    0 is always WC, 1 is HC (Martinelli et al. 2018, Fig. 14).
    """
    tracks = [
        track(recording, replace(config, tracker=WeightedTracker(config.model, float(t))), gnss="off")
        for t in thresholds
    ]
    return table({"threshold": np.asarray(thresholds, float), "distance_m": np.array([t.distance_m for t in tracks])})


def epoch_distances(track: TrackRows, modes: Sequence[Mode]) -> tuple[FloatArray, FloatArray]:
    """Arguments of `pdr_filter.filter.imm.weighting.weighted_distances`: (K, C) and (K + 1, C), of K + 1 windows.

    Distances in m between one window's end and the next if every step had been of a context (Martinelli et al. 2018,
    eq. 17 and 18), and the probabilities of all windows; the modes are `config.model.modes`, one for each context.
    """
    if sorted(m.context for m in modes) != sorted(track.contexts):
        raise ValueError(f"one mode for each of {track.contexts} is needed, got {[m.context for m in modes]}")
    fit = {m.context: m.step_length for m in modes}
    steps = steps_of(track.steps)
    length_m = np.array([[fit[c].predict(s)[0] for c in track.contexts] for s in steps]).reshape(-1, len(fit))
    ends_s = track.windows.time_s
    each = [walked_m(track.time_s, length_m[:, c], ends_s[:-1], ends_s[1:]) for c in range(len(fit))]
    return np.column_stack(each), track.windows.context_prob
