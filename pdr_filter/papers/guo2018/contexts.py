"""Does somebody walk, and where is the phone: Guo et al. 2018, sections 2.1 and 2.2.1.

Every 0.6 s, without overlap:

1. Walk detection: walking where delta_min < T < delta_max, stationary elsewhere (eq. 1, `features.guo.MotionLevel`).
2. The pose, while somebody walks: texting, calling, swinging or pocket, by a random forest on the statistics of pitch
   and roll (Table 1). While nobody walks the pose stays what it was.

Deviations:

- A recording here has no light and no proximity with its uniform samples, so the forest has 12 of the 18 features; the
  name that its windows bear says so. What the other six would tell (the ear and the pocket are dark and near) is missed
  most by phones upright in a pocket, which pitch and roll hardly tell from one at the ear.
- A forest that has not seen a person's grips knows little, so it is also trained on windows that stand for other people
  (`context.train_guo`).
- Before anybody walked all poses are alike; after a gap, too.
- Left and right of a pose are not told apart: no recording with a licence labels them.
- delta_min and delta_max are not printed. They are fitted on motionsense, tyrex, humolire and ms_indoor
  (`context.train_guo`): delta_min where the worse of the two recalls, of standing and sitting and of the worst place of
  the phone of somebody who walks, is best; delta_max above all that anybody does who moves, running included, because a
  runner whose speed is set to zero is a worse error than a shaken phone that walks.
- Without gyroscope eq. 1 has its first half only, and a delta_min of its own.
- Stairs and running are walking here: eq. 1 has no other word for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from pdr_filter.classifiers.model import ContextModel, load_model
from pdr_filter.papers.guo2018.features import (
    WITHOUT_LIGHT_AND_PROXIMITY,
    MotionLevel,
    MotionLevelState,
    PoseWindow,
    PoseWindows,
    PoseWindowState,
)
from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.stage import WindowContext, known_context
from pdr_filter.values.arrays import FloatArray, read_only
from pdr_filter.values.contexts import CARRYING_MODES

_TOLD_APART = ("stationary", "walking")
# For whoever reads the track.
NOTE = "the pose is told from pitch and roll alone (12 of 18 features): light and proximity are not among the samples"


@dataclass(frozen=True, slots=True, eq=False)
class PoseContextState:
    """Samples that later windows need, and the pose of the last window in which somebody walked."""

    level: MotionLevelState
    windows: PoseWindowState
    carrying_prob: FloatArray | None  # (5,); None before anybody walked


@dataclass(frozen=True, eq=False)
class PoseContext:
    """Walking or stationary, and the pose, every 0.6 s; a `ContextStage`.

    Parameters
    ----------
    model : ContextModel
        Of the carrying mode, on the 12 features `features.guo.WITHOUT_LIGHT_AND_PROXIMITY`.
    rate_hz, window_s : float
        Sampling rate of the blocks; length and advance of the windows.
    min_level, max_level : float
        delta_min and delta_max of eq. 1.
    min_level_accelerometer : float
        delta_min where the angular rate is missing.
    """

    model: ContextModel = field(default_factory=lambda: load_model("guo_pose"))
    rate_hz: float = 100.0
    window_s: float = 0.6
    min_level: float = 0.91
    max_level: float = 1000.0
    min_level_accelerometer: float = 0.27

    def __post_init__(self) -> None:
        if self.model.head != "carrying_mode" or self.model.feature_names != WITHOUT_LIGHT_AND_PROXIMITY:
            raise ValueError(
                f"model {self.model.name!r} is no model of the carrying mode on the 12 features of pitch and roll: "
                "give guo_pose, or one that `pdr_filter.training.guo2018` made"
            )

    @property
    def name(self) -> str:
        """What the windows say made them."""
        return f"{self.model.name}_without_light_and_proximity"

    @cached_property
    def _level(self) -> MotionLevel:
        return MotionLevel(self.rate_hz, self.window_s)

    @cached_property
    def _windows(self) -> PoseWindows:
        return PoseWindows(self.rate_hz, self.window_s, self.window_s)

    def init(self) -> PoseContextState:
        """State before the first sample."""
        return PoseContextState(self._level.init(), self._windows.init(), None)

    def after_gap(self, state: PoseContextState) -> PoseContextState:
        """State at the start of a new segment: the phone may be elsewhere by now, so nothing is kept."""
        return self.init()

    def step(
        self, state: PoseContextState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[PoseContextState, list[tuple[int, WindowContext]]]:
        """New state and the windows that became complete, each with the number of its last sample."""
        n_before = state.level.n_samples
        level_state, level, has_rate = self._level.step(state.level, block)
        windows_state, windows = self._windows.step(state.windows, block.time_s, attitude.up_sensor)
        carrying_prob = state.carrying_prob
        found: list[tuple[int, WindowContext]] = []
        for last, window in windows:
            at = last - n_before
            is_walking = self.is_walking(float(level[at]), bool(has_rate[at]))
            if is_walking:
                carrying_prob = read_only(self.model.predict(window.features))
            found.append((last, self._say(window, is_walking, carrying_prob)))
        return replace(state, level=level_state, windows=windows_state, carrying_prob=carrying_prob), found

    def is_walking(self, level: float, has_rate: bool) -> bool:
        """Whether a level of motion is that of somebody who walks (eq. 1)."""
        return (self.min_level if has_rate else self.min_level_accelerometer) < level < self.max_level

    def _say(self, window: PoseWindow, is_walking: bool, carrying_prob: FloatArray | None) -> WindowContext:
        mode = {} if carrying_prob is None else dict(zip(CARRYING_MODES, carrying_prob.tolist(), strict=True))
        context = {_TOLD_APART[is_walking]: 1.0}
        return known_context(window.time_s, context, mode, _TOLD_APART, self.name)
