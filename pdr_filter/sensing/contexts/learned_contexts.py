"""The context stage of the default: feature windows, classified by trained models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.sensing.contexts.context_stage import ContextModels, ContextStage, WindowContext, WindowStage
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindow, FeatureWindows, WindowState
from pdr_filter.values import DEFAULT_CONTEXTS, ContextSet, FloatArray, JoinedFeatures, check_members


@dataclass(frozen=True, eq=False)
class LearnedContexts(WindowStage[WindowState, FeatureWindow, FloatArray]):
    """Context stage that classifies feature windows with trained models.

    What lasts from window to window are the probabilities (5,) of `CARRYING_MODES`, over a gap, too.
    """

    windows: FeatureWindows
    models: ContextModels
    context_set: ContextSet = DEFAULT_CONTEXTS  # what the contexts mean; `Sensing` gives that of its own

    def __post_init__(self) -> None:
        for model in self.models.models:
            missing = sorted(set(model.feature_names) - set(self.windows.features.names))
            if missing:
                raise ValueError(
                    f"context model {model.name!r} needs features {missing[:5]}, which the feature set "
                    f"{self.windows.features.name!r} does not have; use a model and windows of one set"
                )

    @property
    def contexts(self) -> tuple[str, ...]:
        """Names of the contexts that the models distinguish."""
        return self.models.with_gyroscope.labels

    def first_memory(self) -> FloatArray:
        """All carrying modes that the models know, alike."""
        return self.models.init()

    def memory_after_gap(self, memory: FloatArray) -> FloatArray:
        """The phone is where it was."""
        return memory

    def assess(self, memory: FloatArray, window: FeatureWindow) -> tuple[FloatArray, WindowContext]:
        """New carrying-mode probabilities, and the context of a window."""
        return self.models.update(memory, window, self.context_set)

    def assess_all(
        self, memory: FloatArray, windows: Sequence[FeatureWindow]
    ) -> tuple[FloatArray, list[WindowContext]]:
        """New carrying-mode probabilities, and the contexts of windows."""
        return self.models.step_all(memory, windows, self.context_set)


def attitude_free_contexts() -> LearnedContexts:
    """The default's context stage."""
    models = ContextModels(
        shipped_model("context"),
        shipped_model("context_accelerometer"),
        shipped_model("carrying"),
        shipped_model("carrying_accelerometer"),
    )
    return LearnedContexts(FeatureWindows(features=ATTITUDE_FREE), models)


def stage_of(
    contexts: ContextModel | tuple[ContextModel, ContextModel] | ContextStage, present: ContextStage | None
) -> ContextStage:
    """Return the context stage that uses a context model; a stage is returned as it is.

    Of two models, the second is for windows without gyroscope. A single model classifies such windows only if it does
    with the features of the shipped model for them, or learnt from such windows; otherwise they are unknown. Windows,
    carrying modes and features stay those of the present stage if it has the features of the model. Features that a
    model brings along are added. ValueError if no feature set has the features.
    """
    if not isinstance(contexts, ContextModel | tuple):
        check_members("model", contexts, ContextStage)
        return contexts
    model, without_gyroscope = contexts if isinstance(contexts, tuple) else (contexts, None)
    for stage in (present, attitude_free_contexts()):
        if isinstance(stage, LearnedContexts):
            stage = _with_features_of((model, without_gyroscope), stage)
        if not isinstance(stage, LearnedContexts) or not set(model.feature_names) <= set(stage.windows.features.names):
            continue
        known = stage.models.without_gyroscope
        does_without = known is not None and set(model.feature_names) <= set(known.feature_names)
        if without_gyroscope is None and (does_without or not model.needs_gyroscope):
            without_gyroscope = model
        models = replace(stage.models, with_gyroscope=model, without_gyroscope=without_gyroscope)
        return replace(stage, models=models)
    missing = sorted(set(model.feature_names) - set(ATTITUDE_FREE.names))
    raise ValueError(
        f"context model {model.name!r} needs features {missing[:5]}, which no feature set of the configuration has: "
        "give a context stage in place of the model, or, if it was fitted with features of your own, load it with "
        "ContextModel.load(path, features=...)"
    )


def with_carrying_models(
    models: ContextModel | tuple[ContextModel, ContextModel], present: ContextStage | None
) -> LearnedContexts:
    """Return the present context stage with other models of the carrying mode.

    Of two models, the second is for windows without gyroscope. A single model is for windows with gyroscope, and for
    those without only if it learnt from such. ValueError if the stage has no trained models.
    """
    if not isinstance(present, LearnedContexts):
        raise ValueError(
            f"the context stage of the configuration has no trained models, got {type(present).__name__}: use recipe "
            '"default", or give the stage to config.with_contexts'
        )
    both = models if isinstance(models, tuple) else (models, None if models.needs_gyroscope else models)
    stage = _with_features_of(both, present)
    return replace(
        stage,
        models=replace(stage.models, carrying_with_gyroscope=both[0], carrying_without_gyroscope=both[1]),
    )


def _with_features_of(models: Sequence[ContextModel | None], stage: LearnedContexts) -> LearnedContexts:
    """Return the stage with the features that context models bring along, after its own."""
    brought = {id(m.features): m.features for m in models if m is not None and m.features is not None}
    if not brought:
        return stage
    joined = JoinedFeatures((ATTITUDE_FREE, *brought.values()))
    return replace(stage, windows=replace(stage.windows, features=joined))


@cache
def shipped_model(name: str) -> ContextModel:
    """Return a context model of the package by its name; it is read once.

    Raises ValueError for another name.
    """
    return load_model(name)
