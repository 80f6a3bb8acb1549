"""Recipes, which are functions that return a configuration. Use `default`; the others are published systems.

Each function has the name of the subpackage with its parts. It is imported here, so that
`pdr_filter.recipes.martinelli2018` is the function and not the subpackage.
"""

from pdr_filter.recipes.default import (
    RECIPES,
    attitude_free_contexts,
    check_name,
    context_modes,
    context_transitions,
    contexts_of,
    default,
    for_recording,
    guo2018,
    martinelli2018,
    susi2013,
    tian2016,
    with_context_model,
    with_transitions,
    zhou2019,
)
from pdr_filter.values.recording import Subject

__all__ = [
    "RECIPES",
    "Subject",
    "attitude_free_contexts",
    "check_name",
    "context_modes",
    "context_transitions",
    "contexts_of",
    "default",
    "for_recording",
    "guo2018",
    "martinelli2018",
    "susi2013",
    "tian2016",
    "with_context_model",
    "with_transitions",
    "zhou2019",
]


def __dir__() -> list[str]:
    return __all__
