"""Comparisons that run the filter several times on one recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, cast

import numpy as np

from pdr_filter.evaluate.distance import percent_error, walked_m
from pdr_filter.filter.chain.weighted_tracker import WeightedTracker
from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.imm.motion_model import Mode
from pdr_filter.filter.imm.weighting import WEIGHTINGS
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.front_end import KnownEvents, Sensing, SensingState
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.whole_recording import default_config, given_or_default, track
from pdr_filter.values import FloatArray, ImuBlock, Table, TrackRows, steps_of, table
from pdr_filter.values.recording import Recording


def weighting_tracks(
    recording: Recording,
    config: Config | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> dict[str, Track]:
    """Return tracks of a recording with the weightings HC, WC and IMM, with all other settings equal.

    They are those of highest context, weighted context and interacting multiple model (see `weighting_errors`).

    Parameters
    ----------
    recording : Recording
        Recording to track.
    config : Config, optional
        Configuration of the filter. The default is the default recipe for the person of the recording.
    progress : callable, optional
        Function that is called with the fraction done, 0 to 1.
    **options
        Further arguments of `pdr_filter.track`, such as `fixes` and `person`. By default the recording's own locations
        are not used.

    Returns
    -------
    dict of str to Track
        Tracks with the names "hc", "wc" and "imm".

    Raises
    ------
    ValueError
        If the modes of the configuration do not match the contexts one to one.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> list(pdr.evaluate.weighting_tracks(walk))
    ['hc', 'wc', 'imm']
    """
    tracks: dict[str, Track] = {}
    config, options = _sensing_once(given_or_default(recording, config)), {"gnss": "off", **options}
    for i, name in enumerate(WEIGHTINGS):

        def show(fraction: float, i: int = i) -> None:
            if progress is not None:
                progress((i + fraction) / len(WEIGHTINGS))

        tracks[name] = track(recording, config, weighting=name, progress=show, **options)
    return tracks


def weighting_errors(recording: Recording, config: Config | None = None, lag_steps: int = 4) -> Table:
    """Return the errors of the walked distance that are caused by wrong contexts, for each weighting.

    Parameters
    ----------
    recording : Recording
        Recording with context labels (`truth.labels`).
    config : Config, optional
        Configuration of the filter. The default is the default recipe for the person of the recording.
    lag_steps : int, default 4
        Number of later steps that the lagged IMM estimate uses, by default two seconds of walking.

    Returns
    -------
    Table
        A row for each weighting and a row "contexts known", with columns `weighting`, `distance_m` and `error_percent`.
        The error is relative to the distance of the row "contexts known".

    Raises
    ------
    ValueError
        If no step is inside a label with a context of the configuration, or if the modes do not match the contexts one
        to one.

    Notes
    -----
    All rows have the same steps and step-length models. The row "contexts known" is the reference: each step has the
    step length of its true context. Steps outside of all labels do not count.

    "hc" (highest context) takes the step length of the most probable context, averaged over the windows at and after
    the step. "wc" (weighted context) takes the mean of the step lengths, weighted with the context probabilities. If
    the second-highest probability is below 0.8 times the highest, "wc" is equal to "hc". "wc, always" takes the
    weighted mean at each step. The IMM (interacting multiple model) has four rows:

    - "imm, as the steps were made": step lengths as the filter estimated them online, without later steps.
    - "imm": mode probabilities smoothed over all later steps, as in `Track.walked_m`.
    - "imm, lagged": mode probabilities smoothed over `lag_steps` later steps.
    - "imm, smoothed": as "imm", after a filter run in which the evidence of each context window is raised to the power
      `PedestrianModel.hindsight_exponent`. `Config.in_hindsight` makes this change for offline smoothing.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> pdr.evaluate.weighting_errors(walk).weighting.tolist()[:3]
    ['hc', 'wc', 'wc, always']
    """
    labels = recording.truth.labels
    config = _sensing_once(config or default_config(recording))
    model = config.model
    model.check_one_mode_for_each_context()
    weighted = {name: track(recording, config, weighting=name, gnss="off") for name in ("hc", "wc", "imm")}
    weighted["wc, always"] = track(recording, _with_threshold(config, 0.0), gnss="off")
    imm = weighted.pop("imm")
    label = np.full(imm.n_steps, -1)
    for row in () if labels is None else labels:
        if row["context"] in model.contexts:
            inside = (imm.time_s >= row["start_s"]) & (imm.time_s < row["end_s"])
            label[inside] = model.context_index.index(model.contexts.index(str(row["context"])))
    use = label >= 0
    if not use.any():
        raise ValueError(
            f"no step of {recording.name or 'the recording'} is inside a label with one of the contexts "
            f"{model.contexts}: add such labels to truth_labels.csv (docs/formats.md)"
        )
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
    """Return the walked distance with the weighting WC (weighted context) for several thresholds.

    Parameters
    ----------
    recording : Recording
        Recording to track.
    config : Config
        Configuration of the filter.
    thresholds : sequence of float
        Thresholds of the ratio of the second-highest to the highest context probability. With 0, each step length is
        the mean over the contexts, weighted with their probabilities (WC). With 1, it is the length of the most
        probable context (HC, highest context).

    Returns
    -------
    Table
        A row for each threshold, with columns `threshold` and `distance_m`.

    Notes
    -----
    Fig. 14 of Martinelli et al. 2018 shows this relation.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> pdr.evaluate.threshold_sweep(walk, pdr.recipes.default(), [0.0, 1.0]).threshold.tolist()
    [0.0, 1.0]
    """
    config = _sensing_once(config)
    tracks = [track(recording, _with_threshold(config, float(t)), gnss="off") for t in thresholds]
    return table({"threshold": np.asarray(thresholds, float), "distance_m": np.array([t.distance_m for t in tracks])})


@dataclass(frozen=True, eq=False)
class _SensingOnce(Sensing):
    """Front end that keeps its results for further filters of the same recording. All its copies share them."""

    kept: dict[int, Any] = field(default_factory=dict[int, Any])  # by samples before

    def update(self, state: SensingState, block: ImuBlock) -> tuple[SensingState, KnownEvents]:
        n_before = state.conditioner.report.n_received
        if n_before not in self.kept:
            self.kept[n_before] = super().update(state, block)
        return self.kept[n_before]


def _sensing_once(config: Config) -> Config:
    """Return the configuration for several filters of one recording, which differ only behind the front end."""
    stages = {f.name: getattr(config.sensing, f.name) for f in fields(Sensing)}
    return replace(config, sensing=_SensingOnce(**stages))


def _with_threshold(config: Config, threshold: float) -> Config:
    """Return the configuration with the weighting WC and this threshold."""
    tracker = cast(WeightedTracker, config.with_weighting("wc").tracker)
    return replace(config, tracker=replace(tracker, threshold=threshold))


def epoch_distances(track: TrackRows, modes: Sequence[Mode]) -> tuple[FloatArray, FloatArray]:
    """Return the distance of each epoch for each context, and the context probabilities of the windows.

    Parameters
    ----------
    track : Track
        Track of a recording without gaps, with K + 1 windows.
    modes : sequence of Mode
        Modes of the configuration (`config.model.modes`), exactly one for each context of the track.

    Returns
    -------
    distance_m : ndarray of shape (K, C)
        Distance in m of epochs 1 to K, if all steps had the length of the context. Epoch k ends with window k - 1. It
        begins with the end of window k - 2, and epoch 1 with the track.
    context_prob : ndarray of shape (K + 1, C)
        Context probabilities of windows 0 to K.

    Raises
    ------
    ValueError
        If the modes do not match the contexts one to one.

    Notes
    -----
    The results are the arguments of `pdr_filter.filter.imm.weighting.weighted_distances` (Martinelli et al. 2018, eq.
    17 and 18). Windows overlap by half, so that windows k - 1 and k both contain epoch k.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)])
    >>> modes = pdr.recipes.default().model.modes
    >>> distance_m, prob = pdr.evaluate.epoch_distances(pdr.track(walk), modes)
    >>> len(prob) - len(distance_m)
    1
    """
    if sorted(m.context for m in modes) != sorted(track.contexts):
        raise ValueError(
            f"modes must have exactly one mode for each of {track.contexts}, got {[m.context for m in modes]}"
        )
    fit = {m.context: m.step_length for m in modes}
    steps = steps_of(track.steps)
    length_m = np.array([[fit[c].predict(s)[0] for c in track.contexts] for s in steps]).reshape(-1, len(fit))
    ends_s = track.windows.time_s
    starts_s = np.concatenate([[-np.inf], ends_s])[:-2]
    each = [walked_m(track.time_s, length_m[:, c], starts_s, ends_s[:-1]) for c in range(len(fit))]
    return np.column_stack(each), track.windows.context_prob
