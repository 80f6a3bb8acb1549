"""The context stage of the default: feature windows, classified by trained models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.sensing.contexts.context_stage import ContextModels, WindowContext, WindowStage
from pdr_filter.sensing.features.feature_windows import FeatureWindow, FeatureWindows, WindowState
from pdr_filter.values import FloatArray


@dataclass(frozen=True, eq=False)
class LearnedContexts(WindowStage[WindowState, FeatureWindow, FloatArray]):
    """Context stage that classifies feature windows with trained models.

    What lasts from window to window are the probabilities (5,) of `CARRYING_MODES`, over a gap, too.
    """

    windows: FeatureWindows
    models: ContextModels

    def __post_init__(self) -> None:
        for model in self.models.models:
            missing = sorted(set(model.feature_names) - set(self.windows.features.names))
            if missing:
                raise ValueError(
                    f"context model {model.name!r} needs features {missing[:5]}, which the feature set "
                    f"{self.windows.features.name!r} does not have; use a model and windows of one set"
                )

    def first_memory(self) -> FloatArray:
        """All carrying modes that the models know, alike."""
        return self.models.init()

    def memory_after_gap(self, memory: FloatArray) -> FloatArray:
        """The phone is where it was."""
        return memory

    def assess(self, memory: FloatArray, window: FeatureWindow) -> tuple[FloatArray, WindowContext]:
        """New carrying-mode probabilities, and the context of a window."""
        return self.models.update(memory, window)

    def assess_all(
        self, memory: FloatArray, windows: Sequence[FeatureWindow]
    ) -> tuple[FloatArray, list[WindowContext]]:
        """New carrying-mode probabilities, and the contexts of windows."""
        return self.models.step_all(memory, windows)


@cache
def shipped_model(name: str) -> ContextModel:
    """A model of the package, read once."""
    return load_model(name)
