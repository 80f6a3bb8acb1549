"""Importing costs nothing that is not needed, and no module imports from a package above its own."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from itertools import takewhile
from pathlib import Path

import pytest


@cache
def loaded_by(statement: str) -> frozenset[str]:
    """Modules that a statement loads in a fresh interpreter, which may have loaded some itself.

    From sys.modules: `-X importtime` does not list what importlib.import_module loads, as the package does.
    """
    code = f"import sys; own = set(sys.modules)\n{statement}\nprint(*(set(sys.modules) - own), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return frozenset(done.stderr.split())


def test_the_list_of_loaded_modules_is_not_empty() -> None:
    assert {"pdr_filter", "pdr_filter.tracking.track", "numpy"} <= loaded_by("import pdr_filter; pdr_filter.Track")


HELP = (
    "import sys; sys.argv = ['pdr-filter', '--help']\n"
    "from pdr_filter.apps.cli.app import app; app(standalone_mode=False)"
)
# `importlib.abc` loads tempfile and 30 further modules, which took twice as long as the package.
NOT_LOADED = {
    "import pdr_filter": "gtsam matplotlib sklearn scipy.signal filterpy typer rich tempfile",
    "import pdr_filter.tracking.online": "gtsam matplotlib sklearn.ensemble filterpy typer rich",
    # the live server leaves the filter to its workers
    "import pdr_filter.apps.live.hub": "scipy vqf pdr_filter.filter pdr_filter.sensing pdr_filter.tracking",
    HELP: "gtsam matplotlib sklearn scipy vqf pymap3d",
}


@pytest.mark.parametrize("statement", NOT_LOADED)
def test_what_only_others_need_is_not_loaded(statement: str) -> None:
    assert loaded_by(statement).isdisjoint(NOT_LOADED[statement].split())
    assert statement != HELP or "typer" in loaded_by(statement)


def test_the_first_online_filter_loads_neither_scipy_nor_what_only_other_recipes_need() -> None:
    loaded = loaded_by("import pdr_filter; pdr_filter.OnlineFilter()")
    assert "vqf" in loaded
    assert loaded.isdisjoint({"scipy", "pywt", "sklearn"})


def test_every_public_name_can_be_loaded() -> None:
    import pdr_filter

    for name in pdr_filter.__all__:
        assert getattr(pdr_filter, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = pdr_filter.no_such_name


def test_each_package_logs_with_one_logger_of_its_name() -> None:
    calls = {
        path.relative_to(PACKAGE): ast.unparse(node)
        for path, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("getLogger")
    }
    assert len(calls) > 3
    assert set(calls.values()) == {"logging.getLogger(__package__)"}


# --- the packages -----------------------------------------------------------------------------------------------------

# Three groups, in the order in which they may import: each package those before it.
FRAMEWORK = ["values", "classifiers", "sensing", "filter", "recipes", "tracking", "simulate", "offline", "evaluate"]
DATA = [f"data.{name}" for name in ("io", "datasets")]
APPLICATIONS = [f"apps.{name}" for name in ("maps", "report", "batch", "walk_map", "live", "workbench", "cli")]
PACKAGES = [*FRAMEWORK, *DATA, *APPLICATIONS]
PACKAGE = Path(__file__).resolve().parents[1] / "pdr_filter"

# Convenience methods of the framework that import data or applications when they are called, never before.
WHEN_CALLED = {
    ("values.recording", "data.io.files.own_format_writer"),  # Recording.save
    ("recipes.calibration", "apps.report.plot"),  # Calibration.plot
    ("tracking.track", "data.io.files.track_writers"),  # Track.to_csv, Track.to_geojson and others
    ("tracking.track", "apps.report.plot"),  # Track.plot
}


@cache
def trees() -> dict[Path, ast.Module]:
    """Syntax tree of each module of the package."""
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.py")}


def statements(body: ast.AST, only_at_import: bool) -> Iterator[ast.AST]:
    """Statements of a module and those inside them."""
    for node in ast.iter_child_nodes(body):
        if not isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case):
            continue
        if only_at_import and isinstance(node, ast.FunctionDef):
            continue
        yield node
        yield from statements(node, only_at_import)


@cache
def imports_of_modules(only_at_import: bool = False) -> dict[str, set[str]]:
    """Modules that each module of the package imports, both named without the package.

    They include imports for type checkers. `only_at_import`: without those inside of functions.
    """
    names = {path: ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in trees()}
    names = {path: name.removesuffix("__init__").removesuffix(".") for path, name in names.items()}
    modules, found = set(names.values()), {}
    for path, name in names.items():
        targets: set[str] = set()
        for node in statements(trees()[path], only_at_import):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= {t for t in inner if t.removeprefix("pdr_filter.") in modules} or {str(node.module)}
        own = {t.removeprefix("pdr_filter").removeprefix(".") for t in targets if t.partition(".")[0] == "pdr_filter"}
        found[name] = (own & modules) - {name, "version"}
    return found


def package_of(module: str) -> str:
    first, *rest = module.split(".")
    return ".".join([first, *rest[:1]]) if first in ("data", "apps") else first


# Modules outside the packages: names for users and `python -m pdr_filter`. Nothing in the package imports them.
FOR_USERS = ["imm", "protocols", "testing", "__main__"]


def test_the_framework_has_nine_packages_and_beside_all_packages_are_only_names_for_users() -> None:
    imports = imports_of_modules()
    assert len(FRAMEWORK) == 9
    assert {package_of(module) for module in imports} == {"", "version", "data", "apps", *PACKAGES, *FOR_USERS}
    assert {path.stem for path in PACKAGE.glob("*.py")} == {"__init__", "version", *FOR_USERS}
    assert not {target for targets in imports.values() for target in targets} & set(FOR_USERS)


def test_every_folder_of_modules_is_a_package() -> None:
    assert [path for path in PACKAGE.rglob("*.py") if not (path.parent / "__init__.py").is_file()] == []


def test_no_module_imports_from_a_package_above_its_own_but_in_four_methods() -> None:
    order = ["version", *PACKAGES[:-1], "data", "apps", "", "apps.cli", *FOR_USERS]
    level = {package: number for number, package in enumerate(order)}
    up = {
        (module, target)
        for module, targets in imports_of_modules().items()
        for target in targets
        if level[package_of(target)] > level[package_of(module)]
    }
    assert up == WHEN_CALLED and len(WHEN_CALLED) <= 4
    at_import = imports_of_modules(only_at_import=True)
    assert [(module, target) for module, target in WHEN_CALLED if target in at_import[module]] == []


def test_no_modules_and_no_folders_import_each_other_in_a_circle() -> None:
    packages = {name.rpartition(".")[0] for name in imports_of_modules()}
    graph: dict[str, set[str]] = {}
    for module, targets in imports_of_modules().items():
        for target in targets - {"", *(t for m, t in WHEN_CALLED if m == module)}:
            a, b = (f"{name}.__init__".split(".") if name in packages else name.split(".") for name in (module, target))
            same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False)))
            # two modules or folders in one folder, where a folder has the imports of all modules inside
            graph.setdefault(".".join(a[: same + 1]), set()).add(".".join(b[: same + 1]))
    while leaves := {name for name, targets in graph.items() if not targets & graph.keys()}:
        graph = {name: targets for name, targets in graph.items() if name not in leaves}
    assert graph == {}


def test_the_package_does_not_import_the_training_of_its_models() -> None:
    imports = [node for tree in trees().values() for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert [node.module for node in imports if (node.module or "").startswith("models")] == []


def test_the_package_has_no_assert() -> None:
    asserts = [
        f"{path.relative_to(PACKAGE)}:{node.lineno}"
        for path, tree in trees().items()
        for node in statements(tree, only_at_import=False)
        if isinstance(node, ast.Assert)
    ]
    assert asserts == []


# Names of more than one function, each with the reason.
SHARED_NAMES = {
    "track": "pdr.track of one recording, pdr.batch.track of many; pdr.plot.track draws the result",
    "calibrate": "pdr.calibrate takes recordings, pdr.batch.calibrate takes paths",
    "nees": "pdr.evaluate.nees computes it, pdr.plot.nees draws it",
    "mix": "of imm, once more with the classes of filterpy",
    "update": "of imm, once more with the classes of filterpy",
    "update_mode_prob": "of imm, once more with the classes of filterpy",
    "combine": "of the mixtures, once more with the classes of filterpy",
}


def test_no_public_function_or_class_has_the_name_of_another() -> None:
    homes: dict[str, list[str]] = {}
    for path, tree in trees().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.name[0] != "_":
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    shared = {name: files for name, files in homes.items() if len(files) > 1}
    assert {name: files for name, files in shared.items() if name not in SHARED_NAMES} == {}
    assert shared.keys() == SHARED_NAMES.keys()


def test_gtsam_is_imported_only_where_walks_are_smoothed() -> None:
    users = {
        path.relative_to(PACKAGE).parts[0]
        for path in PACKAGE.rglob("*.py")
        if "import gtsam" in path.read_text(encoding="utf-8")
    }
    assert users == {"offline"}


SCRIPTS = sorted(Path(__file__).parent.glob("benchmarks/*.py")) + sorted(Path(__file__).parent.glob("studies/*.py"))


@pytest.mark.parametrize("script", [s for s in SCRIPTS if not s.name.startswith("test_")], ids=lambda path: path.stem)
def test_benchmarks_and_studies_import_what_exists(script: Path) -> None:
    assert importlib.import_module(f"tests.{script.parent.name}.{script.stem}").__doc__
