"""Context stage of the default recipe: feature windows classified by trained models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pdr_filter.classifiers.context_model import ContextModel, load_model
from pdr_filter.sensing.contexts.context_stage import ContextModels, ContextStage, WindowStage
from pdr_filter.sensing.features.feature_windows import ATTITUDE_FREE, FeatureWindow, FeatureWindows, WindowState
from pdr_filter.values import DEFAULT_CONTEXTS, ContextSet, FloatArray, JoinedFeatures, WindowContext, check_members


@dataclass(frozen=True, eq=False)
class LearnedContexts(WindowStage[WindowState, FeatureWindow, FloatArray]):
    """Context stage that classifies feature windows with trained models.

    The memory between windows is the probability vector (5,) of `CARRYING_MODES`. It is kept over a gap.

    Parameters
    ----------
    windows : FeatureWindows
        Sliding windows and their features.
    models : ContextModels
        Models of context and carrying mode, for windows with and without gyroscope.
    context_set : ContextSet, default the six contexts of `pdr_filter.CONTEXTS`
        Meanings of the contexts. `Sensing` replaces it by its own.

    Raises
    ------
    ValueError
        If a model needs features that the windows do not have.

    Examples
    --------
    The stage of the default recipe:

    >>> import pdr_filter as pdr
    >>> stage = pdr.recipes.default().sensing.contexts
    >>> type(stage).__name__, stage.hop_s
    ('LearnedContexts', 1.0)
    >>> stage.contexts
    ('stationary', 'walking', 'upstairs', 'downstairs', 'sideways', 'running')
    """

    windows: FeatureWindows
    models: ContextModels
    context_set: ContextSet = DEFAULT_CONTEXTS

    def __post_init__(self) -> None:
        for model in self.models.models:
            missing = sorted(set(model.feature_names) - set(self.windows.features.names))
            if missing:
                raise ValueError(
                    f"context model {model.name!r} needs features {missing[:5]}, which the feature set "
                    f"{self.windows.features.name!r} does not have: use a model that was trained with the feature set "
                    "of the windows"
                )

    @property
    def contexts(self) -> tuple[str, ...]:
        return self.models.with_gyroscope.labels

    def first_memory(self) -> FloatArray:
        return self.models.init()

    def memory_after_gap(self, memory: FloatArray) -> FloatArray:
        return memory

    def assess(self, memory: FloatArray, window: FeatureWindow) -> tuple[FloatArray, WindowContext]:
        return self.models.update(memory, window, self.context_set)

    def assess_all(
        self, memory: FloatArray, windows: Sequence[FeatureWindow]
    ) -> tuple[FloatArray, list[WindowContext]]:
        return self.models.update_all(memory, windows, self.context_set)


# Shipped models by their classifiers. Those for windows without gyroscope have the same names and "_accelerometer".
_MODELS: dict[str, str] = {
    "blend": "context",
    "rvm": "context_rvm",
    "forest": "context_forest",
    "boosted": "context_boosted",
}

# Limits of still windows (`FeatureWindows`): the noise of a phone that lies on a table. At 100 Hz, accelerometers of
# phones have up to 0.05 m/s2 and gyroscopes up to 0.003 rad/s of noise, three axes together (data sheets: 90 to 400
# ug/sqrt(Hz) and 0.005 to 0.01 deg/s/sqrt(Hz)). In the 620 recordings of all data sets, 1850 windows are below both
# limits, and the default classifier gives standing 0.997 to 0.9993 in all of them. A motionless phone gets 0.9988.
_STILL_MPS2, _STILL_RADPS = 0.06, 0.01


def attitude_free_contexts(classifier: str = "blend") -> LearnedContexts:
    """Return the context stage of the default recipe, with the shipped models.

    Parameters
    ----------
    classifier : {"blend", "rvm", "forest", "boosted"}
        Classifier of the contexts, as in `pdr_filter.recipes.default`.

    Returns
    -------
    LearnedContexts
        Context stage whose features do not depend on the attitude of the phone.

    Raises
    ------
    ValueError
        If there is no such classifier.

    Examples
    --------
    >>> from pdr_filter.sensing.contexts.learned_contexts import attitude_free_contexts
    >>> attitude_free_contexts().hop_s
    1.0
    """
    if classifier not in _MODELS:
        raise ValueError(
            f"classifier must be one of {tuple(_MODELS)}, got {classifier!r}: pass a model of your own to "
            "recipes.with_context_model"
        )
    name = _MODELS[classifier]
    of_context, of_carrying = ((load_model(n), load_model(f"{n}_accelerometer")) for n in (name, "carrying"))
    windows = FeatureWindows(features=ATTITUDE_FREE, still_mps2=_STILL_MPS2, still_radps=_STILL_RADPS)
    return LearnedContexts(windows, ContextModels(*of_context, *of_carrying))


def stage_of(
    contexts: ContextModel | tuple[ContextModel, ContextModel] | ContextStage, present: ContextStage | None
) -> ContextStage:
    """Return the context stage that uses a context model; a given stage is returned unchanged.

    In a pair of models, the second is for windows without gyroscope. A single model classifies such windows if it was
    trained on them, or if the previous model for such windows has all features of the new model. Otherwise such windows
    are unknown. Windows, carrying-mode models and features come from the present stage if it has the features of the
    model. Otherwise they come from the default recipe. Features that come with a model are added. Raises ValueError if
    no feature set has the features of the model.
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
        # Such a model may distinguish several kinds of rest, so that each window must be described.
        return replace(stage, windows=replace(stage.windows, still_mps2=0.0, still_radps=0.0), models=models)
    missing = sorted(set(model.feature_names) - set(ATTITUDE_FREE.names))
    raise ValueError(
        f"context model {model.name!r} needs features {missing[:5]}, which no feature set of the configuration has: "
        "if the model was fitted with your own features, load it with ContextModel.load(path, features=...); "
        "otherwise pass a context stage instead of the model"
    )


def with_carrying_models(
    models: ContextModel | tuple[ContextModel, ContextModel], present: ContextStage | None
) -> LearnedContexts:
    """Return the present context stage with other carrying-mode models.

    In a pair of models, the second is for windows without gyroscope. A single model is used for windows without
    gyroscope only if it was trained on them. Raises ValueError if the stage has no trained models.
    """
    if not isinstance(present, LearnedContexts):
        raise ValueError(
            f"the context stage of the configuration, {type(present).__name__}, has no trained models whose "
            'carrying-mode models could be replaced: use recipe "default", or pass your stage to config.with_contexts'
        )
    both = models if isinstance(models, tuple) else (models, None if models.needs_gyroscope else models)
    stage = _with_features_of(both, present)
    changed = replace(stage.models, carrying_with_gyroscope=both[0], carrying_without_gyroscope=both[1])
    return replace(stage, models=changed)


def _with_features_of(models: Sequence[ContextModel | None], stage: LearnedContexts) -> LearnedContexts:
    """Return the stage with the features that come with context models appended to its own."""
    model_features = {id(m.features): m.features for m in models if m is not None and m.features is not None}
    if not model_features:
        return stage
    joined = JoinedFeatures((ATTITUDE_FREE, *model_features.values()))
    return replace(stage, windows=replace(stage.windows, features=joined))
