"""Dead reckoning of a whole recording before it is smoothed: first pass, second pass, and the path online."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pdr_filter.filter.imm.imm import smoothed_mode_prob
from pdr_filter.filter.pedestrian.fix_history import StandstillSteps
from pdr_filter.filter.pedestrian.frame import START_FRAME
from pdr_filter.offline.smoothing.smoothed import Smoothed
from pdr_filter.offline.smoothing.storeys import with_arrivals
from pdr_filter.recipes.config import Config
from pdr_filter.sensing.device import Device
from pdr_filter.sensing.front_end import SensingForTwoPasses, SensingState
from pdr_filter.sensing.heading.heading_stage import after_first_pass
from pdr_filter.sensing.heading.walking_heading import WalkingHeadingState
from pdr_filter.tracking.filtering import Output, State, init_filter
from pdr_filter.tracking.track import Track
from pdr_filter.tracking.walked_path import WalkedPath, walked_path
from pdr_filter.tracking.whole_recording import outputs, run_sensing, track_of_outputs
from pdr_filter.values import Fix, Measurement, Standstill, Step, has_position, read_only, step_table
from pdr_filter.values.recording import Recording

# Sensing without the stages after the walking direction.
_WITHOUT_LATER_STAGES: dict[str, Any] = {"north": None, "contact_smoothing": None}
# Callbacks for the progress of the first and the second pass.
Passes = tuple[Callable[[float], None] | None, Callable[[float], None] | None]
# Configuration, dead-reckoned track, and state at its end. The sensing is None if the axes of a building determine the
# gyroscope bias.
Reckoned = tuple[Config, Track, SensingState | None, StandstillSteps]


def dead_reckoned(
    recording: Recording,
    config: Config,
    stood: Sequence[Standstill],
    progress: Passes,
    with_hills: bool,
) -> Reckoned:
    """Return the configuration after a first pass, the track without fixes and locations, and the state at its end.

    The state consists of that of the sensing and of the steps within standstills. The sensing is None if the first pass
    determined the gyroscope bias from the axes of a building. `stood` are the given standstills, which are used.
    `progress` has the callbacks of the first and the second pass. With `with_hills`, locations distinguish hills from
    storeys.
    """
    own, known_device = with_first_pass(recording, config, progress[0])
    own = replace(own.in_hindsight().with_model(frame=START_FRAME), keeps_path=False)
    end = init_filter(own)

    def results() -> Iterator[tuple[State, Output]]:
        nonlocal end
        for state, output in outputs(recording, own, stood, progress[1], with_hills=with_hills):
            end = state
            yield state, output

    found = track_of_outputs(recording, own, results())
    track = with_arrivals(replace(found, device=known_device or found.device))
    stood_steps = end.pedestrian.fixes.standstill_steps
    if isinstance(own.sensing, SensingForTwoPasses):
        own = replace(own, sensing=own.sensing.released())
    return own, track, end.sensing if known_device is None else None, stood_steps


def with_first_pass(
    recording: Recording, config: Config, progress: Callable[[float], None] | None
) -> tuple[Config, Device | None]:
    """Return the configuration with the walking directions and the gyroscope bias of a first pass over the recording.

    The second value is the device as estimated in the first pass if the configuration uses its bias, otherwise None.
    Without a gyroscope or without steps, the configuration is unchanged.

    The caller runs the second pass, which has the final estimates of the first pass from its first step on. The walking
    direction relative to the phone is best known at the end of the time in one carrying position. The axes of a
    building determine the gyroscope bias only after some corners. The bias of the first pass is used if building axes
    contributed to it and the configuration has no bias of its own. The second pass then turns the attitudes of the
    first pass, so that its walking directions relative to the phone stay valid. They are not estimated again with the
    new bias, so that they may be less certain while the phone is handled. The covariance of the bias is doubled,
    because the second pass uses the same samples again. Without building axes the bias is not used: straight walking
    would be counted twice, which makes tracks worse as often as better.
    """
    if "gyroscope" not in recording.streams:
        return config, None
    sensing = SensingForTwoPasses.keeping(config.sensing)
    config = replace(config, sensing=sensing)
    # the stages after the walking direction do not change it
    state, events = run_sensing(replace(sensing, **_WITHOUT_LATER_STAGES), recording, progress)
    steps = [event for event in events if isinstance(event, Step)]
    if not steps:
        return config, None
    device, known_device = config.sensing.device(state), None
    if config.sensing.attitude.bias.device is None and steps[-1].on_axes:
        config, known_device = config.with_device(Device(device.bias_radps, 2.0 * device.bias_cov_radps2)), device
        config = replace(config, sensing=sensing.with_bias_of(config.sensing.attitude))
    heading = after_first_pass(config.sensing.heading, step_table(steps))
    return replace(config, sensing=replace(config.sensing, heading=heading)), known_device


def with_smoothed_modes(track: Track, config: Config) -> Track:
    """Return the track with mode probabilities smoothed over the whole recording.

    It is unchanged unless the context probabilities are used as interacting multiple model ("imm").
    """
    if track.weighting != "imm":
        return track
    prob = smoothed_mode_prob(track.mode_prob, config.model.transition_prob)
    return replace(track, mode_prob=read_only(prob))


def online_path(recording: Recording, config: Config, fixes: Sequence[Fix]) -> WalkedPath | None:
    """Return the path of the online filter with fixes, at which measurements are first linearised.

    None if there are no measurements that need it.
    """
    if not any(isinstance(fix, Measurement) for fix in fixes):
        return None
    if any(has_position(fix) for fix in fixes):
        config = config.in_world_frame()
    config = replace(config, keeps_path=True)
    state = init_filter(config)
    for new_state, _ in outputs(recording, config, fixes):
        state = new_state
    return walked_path(config, state)


def pass_callbacks(progress: Callable[[float], None] | None) -> Passes:
    """Return progress callbacks for the first and the second pass, each for half of the progress, or None twice."""
    if progress is None:
        return None, None

    def first(done: float) -> None:
        progress(0.5 * done)

    def second(done: float) -> None:
        progress(0.5 + 0.5 * done)

    return first, second


def observed_device(smoothed: Smoothed, config: Config, sensing: SensingState) -> Device:
    """Return the phone with the gyroscope bias that the observations of a smoothed walk determine.

    During the walk the heading offset changes by minus the heading error of the gyroscope. The change is taken from the
    first step to the step at which the resulting rate is known best. A phone that is moved adds the variance of an
    unknown angle. `sensing` is the state at the end of the recording. If its direction of the phone is unknown, or with
    fewer than two steps, the bias is that of the sensing alone.
    """
    bias, heading = config.sensing.attitude.bias, sensing.heading
    steps, turned_rad = smoothed.track.steps, np.unwrap(smoothed.heading_offset_rad)
    if not isinstance(heading, WalkingHeadingState) or heading.placement is None or len(steps) < 2:
        return config.sensing.device(sensing)
    lasted_s = np.asarray(steps.time_s)[1:] - float(steps.time_s[0])
    var = smoothed.heading_offset_std_rad[1:] ** 2 + smoothed.heading_offset_std_rad[0] ** 2
    moved_var = np.asarray(steps.offset_change_std_rad) ** 2 + np.asarray(steps.heading_unknown_s)
    walk_var = config.model.noise.heading_drift.random_walk_rad_per_sqrt_s**2 * lasted_s
    other_var = np.cumsum(moved_var[1:]) + walk_var
    k = int(np.argmin((var + other_var) / lasted_s**2))
    error_rad = float(turned_rad[0] - turned_rad[1 + k])
    ago_s, up = sensing.processed_s - float(steps.time_s[1 + k]), np.array(heading.placement.up)
    return bias.device_from_smoothed(sensing.attitude.bias, error_rad, float(var[k]), float(other_var[k]), ago_s, up)
