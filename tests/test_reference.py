"""The reference is complete: docstrings of public names have every section, and their examples run."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import doctest
import importlib
import inspect
import io
import re
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from examples import compute_once
from numpydoc.docscrape import NumpyDocString
from numpydoc.validate import validate

import pdr_filter

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pdr_filter"

# Codes of numpydoc's validation. Left out are those on layout (capitals, periods, See Also, Yields).
CHECKED = {
    *(f"GL0{k}" for k in range(1, 9)),
    *(f"PR0{k}" for k in range(1, 8)),
    *("RT01", "RT02", "RT03"),
    *("SS03", "SS04", "SS05", "SS06"),
    "EX01",
}


def resolved(name: str) -> Any:
    """Return the object of a dotted name. An attribute comes before a module of the same name, as in `recipes`."""
    value: Any = pdr_filter
    _, *parts = name.split(".")
    for k, part in enumerate(parts, 1):
        path = ".".join(["pdr_filter", *parts[:k]])
        value = getattr(value, part) if hasattr(value, part) else importlib.import_module(path)
    return value


@cache
def listed() -> dict[str, str]:
    """Name in docs/api.md: its name in the module that defines it."""
    lines = (ROOT / "docs" / "api.md").read_text("utf-8").splitlines()
    names = [line.strip() for line in lines if re.fullmatch(r"\s*pdr_filter(\.\w+)+\s*", line)]
    found = {name: resolved(name) for name in names}
    return {
        name: f"{value.__module__}.{value.__qualname__}" if hasattr(value, "__qualname__") else name
        for name, value in found.items()
    }


@cache
def public_names() -> dict[str, str]:
    """Names in docs/api.md and the public members of the classes among them, as in `listed`."""
    names = dict(listed())
    for name, defined in listed().items():
        value = resolved(name)
        if not inspect.isclass(value):
            continue
        own = [base for base in value.__mro__ if base.__module__.startswith("pdr_filter.")]
        members = [(base, *item) for base in own for item in vars(base).items()]
        for base, member, of_member in members:
            is_documented = inspect.isfunction(of_member) or isinstance(
                of_member, (classmethod, staticmethod, property)
            )
            is_inherited = not of_member.__doc__ and bool(inspect.getdoc(getattr(value, member)))
            where = defined if base is value else f"{base.__module__}.{base.__qualname__}"
            if is_documented and not is_inherited and not member.startswith("_"):
                names.setdefault(f"{name}.{member}", f"{where}.{member}")
    return names


def fields_of(value: Any) -> set[str]:
    """Public fields of a dataclass or NamedTuple; empty for any other object."""
    if not inspect.isclass(value):
        return set()
    fields = [field.name for field in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else []
    if issubclass(value, tuple):
        fields += getattr(value, "_fields", ())
    return {name for name in fields if not name.startswith("_")}


def undocumented_fields(value: Any) -> set[str]:
    """Fields of a dataclass or NamedTuple that are in neither Attributes nor Parameters of its docstring."""
    doc = NumpyDocString(inspect.cleandoc(value.__doc__ or ""))
    parameters = [*doc["Attributes"], *doc["Parameters"]]
    documented = {name.strip(" *") for parameter in parameters for name in parameter.name.split(",")}
    return fields_of(value) - documented


def complaints(name: str) -> list[str]:
    """What numpydoc misses in the docstring of a public name."""
    value, defined = resolved(name), public_names()[name]
    errors = [(code, text) for code, text in validate(defined)["errors"] if code in CHECKED]
    if name not in listed():
        errors = [(code, text) for code, text in errors if code != "EX01"]
    if getattr(value, "_is_protocol", False):
        # `Protocol` gives its classes a constructor, which nobody calls.
        errors = [(code, text) for code, text in errors if not (code == "PR01" and "'*args'" in text)]
    if not fields_of(value):
        return [f"{code} {text}" for code, text in errors]
    errors = [(code, text) for code, text in errors if code != "PR01"]
    if missing := undocumented_fields(value):
        errors.append(("PR01", f"fields {sorted(missing)} are not under Attributes"))
    return [f"{code} {text}" for code, text in errors]


def test_every_method_has_a_docstring_or_inherits_one() -> None:
    classes = [
        node
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    bases = {node.name: [re.split(r"\W", ast.unparse(base))[0] for base in node.bases] for node in classes}
    methods = {
        (node.name, method.name): ast.get_docstring(method)
        for node in classes
        for method in node.body
        if isinstance(method, ast.FunctionDef | ast.AsyncFunctionDef) and not method.name.startswith("_")
    }

    def is_documented(owner: str, method: str) -> bool:
        return bool(methods.get((owner, method))) or any(is_documented(base, method) for base in bases.get(owner, ()))

    assert not {pair for pair in methods if not is_documented(*pair) and not pair[0].startswith("_")}


@pytest.mark.parametrize("name", sorted(public_names()))
def test_the_docstring_of_a_public_name_has_every_section(name: str) -> None:
    found = complaints(name)
    assert not found, "; ".join(found)


class _Pair(NamedTuple):
    """Two numbers.

    Attributes
    ----------
    first : float
        The first one.
    """

    first: float
    second: float


@dataclasses.dataclass
class _Point:
    """Point in the plane.

    Parameters
    ----------
    x, y : float
        Coordinates in metres.
    """

    x: float
    y: float
    _norm: float = 0.0


def test_a_field_without_description_is_noticed() -> None:
    assert undocumented_fields(_Pair) == {"second"}
    assert undocumented_fields(_Point) == set()
    assert fields_of(float) == set()


WITH_EXAMPLES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
    if ">>> " in path.read_text("utf-8")
}


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_of_a_module_give_the_output_that_they_show(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # some examples write files
    compute_once(monkeypatch)
    tests = [test for test in doctest.DocTestFinder().find(importlib.import_module(module)) if test.examples]
    n_shown = WITH_EXAMPLES[module].read_text("utf-8").count(">>> ")
    assert sum(len(test.examples) for test in tests) == n_shown, "an example is not found by doctest"
    runner, output = doctest.DocTestRunner(verbose=False), io.StringIO()
    with contextlib.redirect_stdout(io.StringIO()):
        failed = sum(runner.run(test, out=output.write).failed for test in tests)
    assert failed == 0, output.getvalue()
