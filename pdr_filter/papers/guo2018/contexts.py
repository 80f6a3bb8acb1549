"""Does somebody walk, and where is the phone: Guo et al. 2018, sections 2.1 and 2.2.1.

Every 0.6 s, without overlap:

1. Walk detection: walking where delta_min < T < delta_max, stationary elsewhere (eq. 1, `features.MotionLevel`).
2. The pose, while somebody walks: texting, calling, swinging or pocket, by a random forest on the statistics of pitch
   and roll (Table 1). While nobody walks the pose stays what it was.

Deviations:

- A recording here has no light and no proximity with its uniform samples, so the forest has 12 of the 18 features; the
  name of the model on its windows shows it. What the other six would show (the ear and the pocket are dark and near) is
  missed most by phones upright in a pocket, which pitch and roll hardly distinguish from one at the ear.
- A forest that has not seen a person's grips knows little, so it is also trained on windows that stand for other people
  (`pdr_filter.training.guo2018`).
- Before anybody walked all poses are alike; after a gap, too.
- Left and right of a pose are not distinguished: no recording with a licence labels them.
- delta_min and delta_max are not printed. They are fitted on motionsense, tyrex, humolire and ms_indoor
  (`pdr_filter.training.guo2018`): delta_min where the worse of the two recalls, of standing and sitting and of the
  worst place of the phone of somebody who walks, is best; delta_max above all that anybody does who moves, running
  included, because a runner whose speed is set to zero is a worse error than a shaken phone that walks.
- Without gyroscope eq. 1 has its first half only, and a delta_min of its own.
- Stairs and running are walking here: eq. 1 has no other word for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.classifiers.model import ContextModel
from pdr_filter.papers.guo2018.features import WITHOUT_LIGHT_AND_PROXIMITY, PoseWindow, PoseWindows, PoseWindowState
from pdr_filter.sensing.contexts.learned import shipped_model
from pdr_filter.sensing.contexts.stage import WindowContext, WindowStage, known_context
from pdr_filter.values import CARRYING_MODES, FloatArray, read_only

_CONTEXTS = ("stationary", "walking")


@dataclass(frozen=True, eq=False)
class PoseContext(WindowStage[PoseWindowState, PoseWindow, FloatArray | None]):
    """Walking or stationary, and the pose, every 0.6 s; a `ContextStage`.

    What lasts from window to window, but not over a gap, is the pose (5,) of the last window in which somebody walked;
    None before anybody did.

    Parameters
    ----------
    windows : PoseWindows
        Of 0.6 s.
    model : ContextModel
        Of the carrying mode, on the 12 features `WITHOUT_LIGHT_AND_PROXIMITY`.
    min_level, max_level : float
        delta_min and delta_max of eq. 1.
    min_level_accelerometer : float
        delta_min where the angular rate is missing.
    """

    windows: PoseWindows = field(default_factory=PoseWindows)
    model: ContextModel = field(default_factory=lambda: shipped_model("guo_pose"))
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
        """The name of the model on the windows that it classified."""
        return f"{self.model.name}_without_light_and_proximity"

    def first_memory(self) -> FloatArray | None:
        """The pose is unknown."""
        return None

    def assess(self, memory: FloatArray | None, window: PoseWindow) -> tuple[FloatArray | None, WindowContext]:
        """The pose after a window, and the result for the window."""
        min_level = self.min_level if window.has_gyroscope else self.min_level_accelerometer
        is_walking = min_level < window.level < self.max_level  # eq. 1
        if is_walking:
            memory = read_only(self.model.predict(window.features))
        pose = {} if memory is None else dict(zip(CARRYING_MODES, memory.tolist(), strict=True))
        context = {_CONTEXTS[is_walking]: 1.0}
        return memory, known_context(window.time_s, context, pose, _CONTEXTS, self.name)
