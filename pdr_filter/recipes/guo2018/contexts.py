"""Does somebody walk, and where is the phone: Guo et al. 2018, sections 2.1 and 2.2.1.

Every 0.6 s, without overlap: walking where delta_min < T < delta_max (eq. 1, `features.MotionLevel`), stationary
elsewhere; and, while somebody walks, the pose by a random forest on the statistics of pitch and roll (Table 1). Before
anybody walked all poses are alike; after a gap, too. Stairs and running are walking here.

docs/methods/guo2018.md has the deviations. delta_min and delta_max are fitted on motionsense, tyrex, humolire and
ms_indoor (`pdr_filter.offline.training.guo2018_training`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.recipes.guo2018.features import WITHOUT_LIGHT_AND_PROXIMITY, PoseWindow, PoseWindows, PoseWindowState
from pdr_filter.sensing.contexts.context_stage import WindowContext, WindowStage, known_context
from pdr_filter.sensing.contexts.learned_contexts import shipped_model
from pdr_filter.values import CARRYING_MODES, FloatArray, check_numbers

_CONTEXTS = ("stationary", "walking")


@dataclass(frozen=True, eq=False)
class PoseContext(WindowStage[PoseWindowState, PoseWindow, FloatArray | None]):
    """Walking or stationary, and the pose, every 0.6 s; a `ContextStage`.

    What lasts from window to window, but not over a gap, is the pose (5,) of the last window in which somebody walked;
    None before anybody did.

    Parameters
    ----------
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
        check_numbers(self, zero=("min_level", "min_level_accelerometer"), infinite=("max_level",))
        if self.model.head != "carrying_mode" or self.model.feature_names != WITHOUT_LIGHT_AND_PROXIMITY:
            raise ValueError(
                f"model {self.model.name!r} is no model of the carrying mode on the 12 features of pitch and roll: "
                "give guo_pose, or one that `pdr_filter.offline.training.guo2018_training` made"
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
            memory = self.model.predict(window.features)
        pose = {} if memory is None else dict(zip(CARRYING_MODES, memory.tolist(), strict=True))
        context = {_CONTEXTS[is_walking]: 1.0}
        return memory, known_context(window.time_s, context, pose, _CONTEXTS, self.name)
