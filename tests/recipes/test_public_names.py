"""Recipes can do what a recipe from outside can: they import names of the interface page and of their own modules."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest

import pdr_filter as pdr
from pdr_filter import protocols, testing

ROOT = Path(__file__).resolve().parents[2]
RECIPES = ROOT / "pdr_filter" / "recipes"
# The default, and all modules of the papers.
MODULES = sorted([RECIPES / "default.py", *RECIPES.glob("*/*.py")])


@cache
def listed() -> frozenset[str]:
    """Full names on the interface page."""
    text = (ROOT / "docs" / "api.md").read_text("utf-8")
    return frozenset(re.findall(r"^(?: {3}|\.\. (?:autodata|py:data):: )(pdr_filter(?:\.\w+)+)$", text, re.MULTILINE))


@cache
def public(name: str) -> tuple[Any, ...]:
    """All objects that are public under this name, wherever."""
    exported = [getattr(home, name) for home in (pdr, protocols, testing) if name in home.__all__]
    homes = [full.rpartition(".")[0] for full in listed() if full.rpartition(".")[2] == name]
    return (*exported, *(getattr(resolve_name(home), name) for home in homes))


def is_public(module: str, name: str) -> bool:
    """Whether a name is on the interface page or exported, or the same object as one that is."""
    if f"{module}.{name}" in listed():
        return True
    imported = getattr(importlib.import_module(module), name)
    return any(imported is each for each in public(name))


def imports_of(path: Path) -> list[tuple[str, str]]:
    """Module and name of all that a module imports from the package but from its own sub-package."""
    own = f"pdr_filter.recipes.{path.parent.name}"
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    plain = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    assert not [name for name in plain if name.startswith("pdr_filter")], "from MODULE import NAME"
    return [
        (node.module, alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("pdr_filter")
        if not (node.module == own or node.module.startswith(f"{own}."))
        for alias in node.names
    ]


@pytest.mark.parametrize("path", MODULES, ids=lambda path: f"{path.parent.name}.{path.stem}")
def test_a_recipe_imports_only_public_names_and_its_own_modules(path: Path) -> None:
    assert [pair for pair in imports_of(path) if not is_public(*pair)] == []


def test_the_recipes_are_looked_at_and_other_names_are_not_public() -> None:
    names = {name for path in MODULES for _, name in imports_of(path)}
    assert {"Config", "Sensing", "context_modes", "AttitudeBlock", "butterworth", "check_numbers"} <= names
    assert not any(name.startswith("_") for name in names)
    assert not is_public("pdr_filter.sensing.steps.step_detector", "unknown_contexts")
    assert not is_public("pdr_filter.values", "read_only")


def test_every_function_and_class_of_the_interface_page_has_a_docstring() -> None:
    assert len(listed()) > 200
    for full in listed():
        home, _, name = full.rpartition(".")
        named = getattr(resolve_name(home), name)
        if inspect.isclass(named) or inspect.isroutine(named):
            doc = named.__doc__ or ""  # a dataclass without one gets its signature
            assert doc and not doc.startswith(f"{named.__name__}("), full
