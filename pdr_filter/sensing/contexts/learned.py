"""The context stage of the default: feature windows, classified by trained models."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pdr_filter.sensing.attitude import AttitudeBlock
from pdr_filter.sensing.conditioning import UniformBlock
from pdr_filter.sensing.contexts.stage import ContextModels, WindowContext
from pdr_filter.sensing.features.windows import FeatureWindows, WindowState
from pdr_filter.values.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LearnedContextState:
    """Samples of open windows, and what lasts from window to window."""

    windows: WindowState
    carrying_prob: FloatArray  # (5,) of `CARRYING_MODES`


@dataclass(frozen=True, eq=False)
class LearnedContexts:
    """Context stage that classifies feature windows with trained models.

    Parameters
    ----------
    windows : FeatureWindows
        The windows and their features.
    models : ContextModels
        Of those features.
    """

    windows: FeatureWindows
    models: ContextModels

    def __post_init__(self) -> None:
        for model in self.models.models:
            missing = sorted(set(model.feature_names) - set(self.windows.names))
            if missing:
                raise ValueError(
                    f"context model {model.name!r} needs features {missing[:5]}, which feature_set "
                    f"{self.windows.feature_set!r} does not have; use a model and windows of one set"
                )

    @property
    def rate_hz(self) -> float:
        """Sampling rate of the blocks."""
        return self.windows.rate_hz

    def init(self) -> LearnedContextState:
        """State before the first sample."""
        return LearnedContextState(self.windows.init(), self.models.init())

    def after_gap(self, state: LearnedContextState) -> LearnedContextState:
        """State at the start of a new segment: windows start afresh, the phone is where it was."""
        return replace(state, windows=self.windows.init())

    def step(
        self, state: LearnedContextState, block: UniformBlock, attitude: AttitudeBlock
    ) -> tuple[LearnedContextState, list[tuple[int, WindowContext]]]:
        """New state and the windows that became known, each with the number of its last sample."""
        windows, found = self.windows.step(state.windows, block, attitude)
        carrying_prob = state.carrying_prob
        contexts: list[tuple[int, WindowContext]] = []
        for i, window in found:
            carrying_prob, context = self.models.step(carrying_prob, window)
            contexts.append((i, context))
        return LearnedContextState(windows, carrying_prob), contexts
