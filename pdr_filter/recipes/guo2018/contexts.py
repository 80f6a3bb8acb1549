"""Context stage of Guo et al. 2018, sections 2.1 and 2.2.1: walking or stationary, and the pose of the phone.

Windows of 0.6 s follow each other without overlap. A window is walking if delta_min < T < delta_max (eq. 1,
`features.MotionLevel`) and stationary otherwise. In walking windows a random forest classifies the pose from statistics
of pitch and roll (Table 1). Before the first walking window, and after a gap, all poses are equally probable. Stairs
and running count as walking.

`PoseContext` lists the deviations from the paper.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.recipes.guo2018.features import (
    NAMES,
    WITHOUT_LIGHT_AND_PROXIMITY,
    PoseWindow,
    PoseWindows,
    PoseWindowState,
)
from pdr_filter.sensing.contexts.context_stage import WindowStage
from pdr_filter.values import CARRYING_MODES, FloatArray, WindowContext, check_numbers, known_context

_CONTEXTS = ("stationary", "walking")


@dataclass(frozen=True, eq=False)
class PoseContext(WindowStage[PoseWindowState, PoseWindow, FloatArray | None]):
    """Context stage of Guo et al. 2018, which reports walking or stationary and the pose every 0.6 s.

    The memory between windows is the pose (5,) of the last walking window, or None before the first. It is reset at a
    gap.

    Parameters
    ----------
    windows : PoseWindows
        Windows and their features.
    model : ContextModel
        Classifier of the carrying mode on the 12 features `WITHOUT_LIGHT_AND_PROXIMITY`, or on all 18 `NAMES`. The
        latter needs windows with light and proximity: `PoseWindows(ambient=AmbientSamples.of(recording))`.
    min_level, max_level : float
        Range of the level of motion of a walking window, delta_min and delta_max of eq. 1, in m2/s4.
    min_level_accelerometer : float
        delta_min for windows without angular rate.

    Raises
    ------
    ValueError
        If a threshold is negative, or if the model does not classify carrying modes from the features of the windows.

    Notes
    -----
    Deviations from the paper:

    - The shipped model omits light and proximity, six of 18 features, because the training recordings lack them. The
      windows report the model as `guo_pose_without_light_and_proximity`.
    - Roll is about another axis (`pdr_filter.recipes.guo2018.features`).
    - Left and right are not distinguished, because no licensed recording labels the side. The paper also has seven
      classes with sides.
    - The training has 16 people of five public data sets, their windows mirrored, turned over and turned to the ear,
      and simulated people (`models.training.guo2018_training`). The 101 people of the paper are not public,
      and the recordings alone do not teach calling. Without a gyroscope, the recall of a swinging hand varies much
      between trainings.
    - The trees are not grown to full depth, because deep trees memorise people. There are 30 trees, with one feature at
      each split and leaves of at least 60 windows.
    - delta_min is not printed. 0.91, or 0.27 without gyroscope, maximises the smallest of the recalls of rest and of
      walking in each place of the phone, on motionsense, tyrex, humolire and ms_indoor.
    - delta_max is not printed. 1000 is above every runner (961).
    - The pose while the person stands is not given. It is that of the last walking window.

    Examples
    --------
    >>> from pdr_filter.recipes.guo2018.contexts import PoseContext
    >>> PoseContext().hop_s
    0.6
    """

    windows: PoseWindows = field(default_factory=PoseWindows)
    model: ContextModel = field(default_factory=lambda: load_model("guo_pose"))
    min_level: float = 0.91
    max_level: float = 1000.0
    min_level_accelerometer: float = 0.27

    def __post_init__(self) -> None:
        check_numbers(self, zero=("min_level", "min_level_accelerometer"), infinite=("max_level",))
        if self.model.feature_names == NAMES and self.windows.ambient is None:
            raise ValueError(
                f"model {self.model.name!r} needs light and proximity: pass "
                "windows=PoseWindows(ambient=AmbientSamples.of(recording))"
            )
        if self.model.head != "carrying_mode" or self.model.feature_names not in (NAMES, WITHOUT_LIGHT_AND_PROXIMITY):
            raise ValueError(
                f"model {self.model.name!r} does not classify carrying modes from the 12 features of pitch and roll: "
                'pass ContextModel.load("guo_pose"), or train one in a clone with '
                "`make models`"
            )

    @property
    def name(self) -> str:
        """Name of the classifier in the reports of windows."""
        has_all = self.model.feature_names == NAMES
        return self.model.name if has_all else f"{self.model.name}_without_light_and_proximity"

    def first_memory(self) -> FloatArray | None:
        return None

    def assess(self, memory: FloatArray | None, window: PoseWindow) -> tuple[FloatArray | None, WindowContext]:
        min_level = self.min_level if window.has_gyroscope else self.min_level_accelerometer
        is_walking = min_level < window.level < self.max_level  # eq. 1
        if is_walking:
            memory = self.model.predict(window.features[: len(self.model.feature_names)])
        pose = {} if memory is None else dict(zip(CARRYING_MODES, memory.tolist(), strict=True))
        context = {_CONTEXTS[is_walking]: 1.0}
        return memory, known_context(window.time_s, context, pose, _CONTEXTS, self.name)
