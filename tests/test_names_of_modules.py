"""`dir()` of a module shows its public names and nothing else."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from types import GenericAlias, ModuleType
from typing import Any

import pytest

import pdr_filter as pdr

PUBLIC = {"pdr_filter": pdr} | {
    f"pdr.{name}": getattr(pdr, name) for name in dir(pdr) if inspect.ismodule(getattr(pdr, name))
}
PACKAGES = [m.name for m in pkgutil.walk_packages(pdr.__path__, "pdr_filter.") if m.ispkg]


def shown(module: ModuleType) -> list[str]:
    return [name for name in dir(module) if not (name.startswith("__") and name.endswith("__"))]


def is_foreign(value: Any) -> bool:
    """Return whether a module, class or function is defined outside of the package."""
    where = value.__name__ if inspect.ismodule(value) else value.__module__ if _is_defined(value) else "pdr_filter"
    return where.partition(".")[0] != "pdr_filter"


def _is_defined(value: Any) -> bool:  # an alias of a type, such as `FloatArray`, has no module
    return type(value) is not GenericAlias and (inspect.isclass(value) or inspect.isfunction(value))


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_module_shows_its_public_names_alone(name: str) -> None:
    module = PUBLIC[name]
    assert shown(module) == sorted(module.__all__)
    assert not [public for public in shown(module) if public.startswith("_")]
    values = {public: getattr(module, public) for public in shown(module)}
    assert not [public for public, value in values.items() if is_foreign(value)]
    modules = [value for value in values.values() if inspect.ismodule(value)]
    assert all(value in PUBLIC.values() for value in modules)


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_shows_no_name_of_another_one(name: str) -> None:
    module = importlib.import_module(name)
    assert not [public for public in shown(module) if is_foreign(getattr(module, public))]
