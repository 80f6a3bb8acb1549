"""Default recipe, selection of recipes by name, and changes of the context model or the transitions."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np

from pdr_filter.classifiers.context_model import ContextModel
from pdr_filter.classifiers.transition_files import Transitions, load_transitions
from pdr_filter.filter.chain.imm_tracker import ImmTracker
from pdr_filter.filter.imm.motion_model import MotionNoise
from pdr_filter.filter.imm.transition_probabilities import context_transitions
from pdr_filter.filter.pedestrian.pedestrian_model import PedestrianModel
from pdr_filter.filter.step_length.models import bounce_fit, scale_std
from pdr_filter.recipes.config import Config
from pdr_filter.recipes.guo2018.recipe import guo2018 as guo2018
from pdr_filter.recipes.martinelli2018.recipe import magnitude_contexts
from pdr_filter.recipes.martinelli2018.recipe import martinelli2018 as martinelli2018
from pdr_filter.recipes.modes import context_modes, height_notes
from pdr_filter.recipes.susi2013.recipe import susi2013 as susi2013
from pdr_filter.recipes.tian2016.recipe import tian2016 as tian2016
from pdr_filter.recipes.zhou2019.recipe import zhou2019 as zhou2019
from pdr_filter.sensing.contexts.learned_contexts import attitude_free_contexts as attitude_free_contexts
from pdr_filter.sensing.front_end import Sensing
from pdr_filter.sensing.heading.walking_heading import WalkingHeading
from pdr_filter.sensing.steps.adaptive_detector import AdaptiveStepDetector
from pdr_filter.sensing.steps.contact_time_smoothing import ContactTimeSmoothing
from pdr_filter.sensing.steps.step_gate import StepGate
from pdr_filter.values import HeadingDrift
from pdr_filter.values.recording import Recording, Subject, check_height


def default(
    subject: Subject | None = None, classifier: Literal["blend", "rvm", "forest", "boosted"] = "blend"
) -> Config:
    """Return the default configuration, which is recommended for carried phones.

    It has an adaptive step detector with a gate against false steps, contexts from attitude-free features, and an
    estimate of the walking direction relative to the phone.

    Parameters
    ----------
    subject : Subject, optional
        Person who carries the phone. Only the height is used, for the step lengths. Without a height, step lengths are
        those of a typical person, with a larger uncertainty, and a note says so.
    classifier : {"blend", "rvm", "forest", "boosted"}
        Classifier of the contexts. "rvm" are relevance vector machines, and "forest" are extremely randomised trees.
        "blend" is the mean of both. "boosted" is the mean of logistic regression and boosted trees. Their accuracies
        are in docs/benchmarks/contexts.md.

    Returns
    -------
    Config
        Configuration of the filter.

    Raises
    ------
    ValueError
        If `subject` is not a `Subject`, if its height is implausible, or if there is no such classifier.

    Notes
    -----
    The uncertainty of a person's step lengths given the height is `filter.step_length.models.scale_std`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> config = pdr.recipes.default()
    >>> config.contexts
    ('stationary', 'walking', 'upstairs', 'downstairs', 'sideways', 'running')
    >>> config.tracker.weighting
    'imm'
    """
    if not isinstance(subject, Subject | None):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ValueError(
            f"subject must be a Subject, got {subject!r}: pass recording.subject, or recording.of_height(1.78).subject"
        )
    height_m = subject.height_m if subject else None
    if height_m is not None:
        check_height(height_m)
    return replace(_for_height(height_m, str(classifier)), notes=height_notes(subject))


# Cached, because stages derive filter coefficients when they are created, which takes a millisecond per recording.
@lru_cache(maxsize=16, typed=True)
def _for_height(height_m: float | None, classifier: str) -> Config:
    """Return the default configuration without its notes, for a body height in m, or None for a typical person."""
    drift = HeadingDrift()
    return Config(
        name="default",
        sensing=Sensing(
            steps=AdaptiveStepDetector(),
            gate=StepGate(),
            contact_smoothing=ContactTimeSmoothing(),
            contexts=attitude_free_contexts(classifier),
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
    """Return a configuration with another context model, for windows with gyroscope, and the features that it needs.

    Parameters
    ----------
    config : Config
        Configuration to change. It is not modified.
    model : ContextModel
        Context model, such as from `fit_contexts`. If it knows only some contexts of the configuration, only the modes
        of these contexts remain.

    Returns
    -------
    Config
        Changed copy.

    Raises
    ------
    ValueError
        If the model has contexts without a mode in the configuration, or needs unknown features.

    See Also
    --------
    Config.with_contexts : Change the contexts and their modes.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> model = pdr.ContextModel.load("context")
    >>> pdr.recipes.with_context_model(pdr.recipes.default(), model).contexts
    ('stationary', 'walking', 'upstairs', 'downstairs', 'sideways', 'running')
    """
    if other := [label for label in model.labels if label not in config.contexts]:
        raise ValueError(
            f"model {model.name!r} classifies the {model.head} with the labels {other}, for which recipe "
            f"{config.name!r} has no modes: give a model whose labels are contexts of the recipe, or define modes "
            "for the other labels with config.with_contexts(model, modes)"
        )
    if model.labels != config.contexts:
        return config.with_contexts(model, [m for m in config.model.modes if m.context in model.labels])
    for contexts in (magnitude_contexts(), attitude_free_contexts()):
        if set(model.feature_names) <= set(contexts.windows.features.names):
            contexts = replace(contexts, models=replace(contexts.models, with_gyroscope=model))
            return replace(config, sensing=replace(config.sensing, contexts=contexts))
    raise ValueError(
        f"model {model.name!r} needs features that no feature set of this version has: train it again with this "
        "version, or give a model with your own features to config.with_contexts"
    )


def with_transitions(config: Config, transitions: Transitions | str | Path) -> Config:
    """Return a configuration with transition probabilities and evidence exponents estimated from recordings.

    The weightings "hc" and "wc" do not use transition probabilities, so that their step lengths do not change.

    Parameters
    ----------
    config : Config
        Configuration to change, with exactly one mode for each context of the transitions. It is not modified.
    transitions : Transitions, str or Path
        Transitions, or the path of a file that `pdr-filter train` has written. The exponents in it were estimated for
        the context model of the default recipe.

    Returns
    -------
    Config
        Changed copy.

    Raises
    ------
    ValueError
        If the file cannot be used, or if the modes of the configuration do not match the contexts.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> from pdr_filter.classifiers.transition_files import Transitions
    >>> prob = pdr.recipes.context_transitions()
    >>> transitions = Transitions(prob, evidence_exponent=0.7, prior_exponent=0.2, counts=0 * prob)
    >>> pdr.recipes.with_transitions(pdr.recipes.default(), transitions).model.evidence_exponent
    0.7
    """
    estimated = transitions if isinstance(transitions, Transitions) else load_transitions(transitions)
    contexts = [mode.context for mode in config.model.modes]
    if sorted(contexts) != sorted(estimated.contexts):
        raise ValueError(
            f"transitions are between the contexts {estimated.contexts}, but recipe {config.name!r} has modes of "
            f"{contexts}; give transition_prob to config.with_modes or config.with_contexts"
        )
    of_mode = [estimated.contexts.index(context) for context in contexts]
    return config.with_model(
        transition_prob=estimated.transition_prob[np.ix_(of_mode, of_mode)],
        evidence_exponent=estimated.evidence_exponent,
        prior_exponent=estimated.prior_exponent,
    )


def for_recording(name: str, recording: Recording) -> Config:
    """Return the configuration of a recipe for the person and the phone placement of a recording.

    Parameters
    ----------
    name : str
        Name of a recipe in `RECIPES`, name of an entry point of the group "pdr_filter.recipes", or "module:function".
    recording : Recording
        Recording, whose subject is passed to the recipe. "zhou2019" also uses whether the sensor is on the foot.

    Returns
    -------
    Config
        Configuration of the filter.

    Raises
    ------
    ValueError
        If there is no such recipe, or if it does not return a `Config`.

    Examples
    --------
    >>> import pdr_filter as pdr
    >>> walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=5.0)])
    >>> pdr.recipes.for_recording("martinelli2018", walk).name
    'martinelli2018'
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
        raise ValueError(
            f"recipe {name!r} must return a Config, got {config!r}: return, for example, default().with_steps(...)"
        )
    return config


def check_name(name: str) -> None:
    """Raise ValueError for an unknown recipe name. The message lists all recipes."""
    _named(name)


# Group of entry points with which installed packages can add recipes.
ENTRY_POINTS = "pdr_filter.recipes"


def _named(name: str) -> Callable[[Subject | None], Any]:
    """Return the function of a recipe, which takes the subject. A function without parameters is wrapped.

    ValueError for an unknown name, and if the name does not lead to a function.
    """
    if name in RECIPES:
        return RECIPES[name]
    from importlib.metadata import entry_points  # slow import, needed only for other names

    installed = entry_points(group=ENTRY_POINTS)
    if ":" in name:
        recipe = _function_of(name)
    elif name in installed.names:
        recipe = installed[name].load()
    else:
        known = ", ".join(sorted({*RECIPES, *installed.names}))
        raise ValueError(f"no recipe {name!r}; there are {known}. A recipe of your own is module:function")
    if not callable(recipe):
        raise ValueError(f"recipe {name!r} must be a function that returns a Config, got {recipe!r}")
    return recipe if inspect.signature(recipe).parameters else lambda _: recipe()


def _function_of(name: str) -> Any:
    """Return the function of "module:function", imported. The module may be in the working directory.

    ValueError if the import fails.
    """
    module, _, function = name.partition(":")
    if (folder := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, folder)
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(
            f"recipe {name!r} cannot be imported ({error}): give an importable module, such as a file "
            f"{module.partition('.')[0] or 'mymodule'}.py in this folder, and a function in it"
        ) from None


RECIPES: Mapping[str, Callable[[Subject | None], Config]] = MappingProxyType(
    {recipe.__name__: recipe for recipe in (default, martinelli2018, guo2018, susi2013, tian2016, zhou2019)}
)
