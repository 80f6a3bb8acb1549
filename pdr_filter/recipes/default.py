"""Recipes: functions that return a configuration. `default` is the one to use; the others are published systems."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.transition_files import Transitions, load_transitions
from pdr_filter.filter.imm.imm_tracker import ImmTracker
from pdr_filter.filter.imm.modes import context_modes, height_notes
from pdr_filter.filter.imm.motion_model import MotionNoise
from pdr_filter.filter.imm.pedestrian_model import PedestrianModel
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.step_length.models import bounce_fit, scale_std
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.recipe import guo2018 as guo2018
from pdr_filter.recipes.martinelli2018.recipe import magnitude_contexts
from pdr_filter.recipes.martinelli2018.recipe import martinelli2018 as martinelli2018
from pdr_filter.recipes.susi2013.recipe import susi2013 as susi2013
from pdr_filter.recipes.tian2016.recipe import tian2016 as tian2016
from pdr_filter.recipes.zhou2019.recipe import zhou2019 as zhou2019
from pdr_filter.sensing.contexts.learned_contexts import attitude_free_contexts as attitude_free_contexts
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.contact_time_smoothing import EvenSteps
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.values import HeadingDrift
from pdr_filter.values.recording import Recording, Subject, check_height


def default(subject: Subject | None = None) -> Config:
    """The recipe to use: adaptive steps behind a gate, contexts from attitude-free features, learnt walking heading.

    Of the subject only the height counts; how people differ in their step lengths beyond it is `scale_std`.
    """
    if not isinstance(subject, Subject | None):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(
            f"subject must be a Subject, got {subject!r}: such as that of a recording, or of recording.of_height(1.78)"
        )
    height_m = subject.height_m if subject else None
    if height_m is not None:
        check_height(height_m)
    return replace(_for_height(height_m), notes=height_notes(subject))


# Coefficients that stages derive once are then those of all recordings of a height: a millisecond of each.
@lru_cache(maxsize=16, typed=True)
def _for_height(height_m: float | None) -> Config:
    """The default but for its notes."""
    drift = HeadingDrift()
    return Config(
        name="default",
        sensing=Sensing(
            steps=AdaptiveStepDetector(),
            gate=StepGate(),
            even=EvenSteps(),
            contexts=attitude_free_contexts(),
            heading=WalkingHeading(drift=drift),
        ),
        tracker=ImmTracker(
            PedestrianModel(
                modes=context_modes(bounce_fit(height_m)),
                transition_prob=context_transitions(),
                noise=MotionNoise(heading_drift=drift, log_scale_std=scale_std(height_m)),
            )
        ),
    )


def with_context_model(config: Config, model: ContextModel) -> Config:
    """Return the configuration with another context model for windows with gyroscope and the features that it needs.

    A model of only some of the contexts of the configuration leaves the modes of these. ValueError for a model of other
    contexts, or of features that no feature set has.
    """
    if other := [label for label in model.labels if label not in config.contexts]:
        raise ValueError(
            f"model {model.name!r} has the contexts {other}, for which recipe {config.name!r} has no modes: say what "
            "they mean in a recipe of your own with config.with_contexts(model, modes)"
        )
    if model.labels != config.contexts:
        return config.with_contexts(model, [m for m in config.model.modes if m.context in model.labels])
    for contexts in (magnitude_contexts(), attitude_free_contexts()):
        if set(model.feature_names) <= set(contexts.windows.features.names):
            contexts = replace(contexts, models=replace(contexts.models, with_gyroscope=model))
            return replace(config, sensing=replace(config.sensing, contexts=contexts))
    raise ValueError(f"model {model.name!r} needs features that no feature set has")


def with_transitions(config: Config, transitions: Transitions | str | Path) -> Config:
    """The configuration with transition probabilities and exponents of the evidence that were estimated.

    `transitions`, or the path of its file, is what `pdr-filter train` writes; the exponents in it are of the default's
    context model. The weightings "hc" and "wc" take step lengths from the windows and not from transitions. ValueError
    if the file cannot be used, or if the configuration has not one mode for each of its contexts.
    """
    learnt = transitions if isinstance(transitions, Transitions) else load_transitions(transitions)
    contexts = [mode.context for mode in config.model.modes]
    if sorted(contexts) != sorted(learnt.contexts):
        raise ValueError(
            f"transitions are between the contexts {learnt.contexts}, but recipe {config.name!r} has modes of "
            f"{contexts}; give transition_prob to config.with_modes or config.with_contexts instead"
        )
    of_mode = [learnt.contexts.index(context) for context in contexts]
    return config.with_model(
        transition_prob=learnt.transition_prob[np.ix_(of_mode, of_mode)],
        evidence_exponent=learnt.evidence_exponent,
        prior_exponent=learnt.prior_exponent,
    )


def for_recording(name: str, recording: Recording) -> Config:
    """The recipe of that name for the person and the placement of a recording; ValueError if there is none.

    `name` is one of `RECIPES`, that of an entry point of the group "pdr_filter.recipes", or "module:function".
    """
    if name == "zhou2019" and recording.is_on_foot:
        return zhou2019(recording.subject, placement="foot")
    return _called(name, recording.subject)


def contexts_of(name: str) -> tuple[str, ...]:
    """Return the names of the contexts of a recipe, given its name as in `for_recording`."""
    return _called(name, None).contexts


def _called(name: str, subject: Subject | None) -> Config:
    config: Any = _named(name)(subject)
    if not isinstance(config, Config):
        raise ValueError(f"recipe {name!r} must return a Config, got {config!r}: such as default().with_steps(...)")
    return config


def check_name(name: str) -> None:
    """ValueError that lists the recipes if there is none of that name."""
    _named(name)


# Entry points of this group, which any installed distribution may have, are recipes.
ENTRY_POINTS = "pdr_filter.recipes"


def _named(name: str) -> Callable[[Subject | None], Any]:
    """The recipe of a name; a function without parameters is called without the subject."""
    if name in RECIPES:
        return RECIPES[name]
    from importlib.metadata import entry_points  # for names that are not here

    installed = entry_points(group=ENTRY_POINTS)
    if ":" in name:
        recipe = _function_of(name)
    elif name in installed.names:
        recipe = installed[name].load()
    else:
        known = ", ".join(sorted({*RECIPES, *installed.names}))
        raise ValueError(f"no recipe {name!r}; there are {known}, and module:function for one of yours")
    if not callable(recipe):
        raise ValueError(f"recipe {name!r} must be a function that returns a Config, got {recipe!r}")
    return recipe if inspect.signature(recipe).parameters else lambda _: recipe()


def _function_of(name: str) -> Any:
    """The function of "module:function"; the module may be in the working folder."""
    module, _, function = name.partition(":")
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, folder)
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"recipe {name!r} cannot be imported ({error}); name a module that Python finds, such as a file "
            f"{module.partition('.')[0] or 'mymodule'}.py in this folder, and a function in it"
        ) from None


RECIPES: Mapping[str, Callable[[Subject | None], Config]] = MappingProxyType(
    {recipe.__name__: recipe for recipe in (default, martinelli2018, guo2018, susi2013, tian2016, zhou2019)}
)
