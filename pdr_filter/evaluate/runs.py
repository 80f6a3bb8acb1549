"""The filter run several times on one recording, for a comparison: the only part of this package that runs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pdr_filter.config import Config
from pdr_filter.evaluate.distance import walked_m
from pdr_filter.filter.motion import Mode
from pdr_filter.filter.weighted_tracker import WeightedTracker
from pdr_filter.filter.weighting import WEIGHTINGS
from pdr_filter.io.recording import Recording
from pdr_filter.recording_run import track
from pdr_filter.tracks import Track
from pdr_filter.values import FloatArray, Table, TrackRows, steps_of, table


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

        tracks[name] = track(recording, config, name, progress=show)
    return tracks


def threshold_sweep(recording: Recording, config: Config, thresholds: Sequence[float]) -> Table:
    """Distance with WC at each threshold, columns `threshold, distance_m`.

    0 is always WC, 1 is HC (Martinelli et al. 2018, Fig. 14).
    """
    tracks = [track(recording, replace(config, tracker=WeightedTracker(config.model, float(t)))) for t in thresholds]
    return table({"threshold": np.asarray(thresholds, float), "distance_m": np.array([t.distance_m for t in tracks])})


def epoch_distances(track: TrackRows, modes: Sequence[Mode]) -> tuple[FloatArray, FloatArray]:
    """What `pdr_filter.filter.weighting.weighted_distances` takes: (K, C) and (K + 1, C), for a track of K + 1 windows.

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
