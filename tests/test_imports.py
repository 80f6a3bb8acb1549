"""Importing costs nothing that is not needed, and no module imports from a room above its own."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest


def loaded_by(statement: str) -> set[str]:
    """Modules that a statement loads in a fresh interpreter.

    From sys.modules: `-X importtime` does not list what importlib.import_module loads, as the package does.
    """
    code = f"{statement}\nimport sys; print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def test_the_list_of_loaded_modules_is_not_empty() -> None:
    assert {"pdr_filter", "pdr_filter.tracking.track", "numpy"} <= loaded_by("import pdr_filter; pdr_filter.Track")


@pytest.mark.parametrize("module", ["gtsam", "matplotlib", "sklearn", "scipy.signal", "filterpy", "typer", "rich"])
def test_importing_the_package_does_not_load(module: str) -> None:
    assert module not in loaded_by("import pdr_filter")


@pytest.mark.parametrize("module", ["gtsam", "matplotlib", "sklearn.ensemble", "filterpy", "typer", "rich"])
def test_importing_the_online_filter_does_not_load(module: str) -> None:
    assert module not in loaded_by("import pdr_filter.tracking.online")


def test_the_first_online_filter_loads_neither_scipy_nor_what_only_other_recipes_need() -> None:
    loaded = loaded_by("import pdr_filter; pdr_filter.OnlineFilter()")
    assert "vqf" in loaded
    assert loaded.isdisjoint({"scipy", "pywt", "sklearn"})


@pytest.mark.parametrize("module", ["gtsam", "matplotlib", "sklearn", "scipy", "vqf", "pymap3d"])
def test_the_help_of_the_command_does_not_load(module: str) -> None:
    statement = (
        "import sys; sys.argv = ['pdr-filter', '--help']\n"
        "from pdr_filter.cli.app import app; app(standalone_mode=False)"
    )
    loaded = loaded_by(statement)
    assert "typer" in loaded
    assert module not in loaded


def test_every_public_name_can_be_loaded() -> None:
    import pdr_filter

    for name in pdr_filter.__all__:
        assert getattr(pdr_filter, name) is not None
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = pdr_filter.no_such_name


def test_an_app_that_only_filters_runs_where_gtsam_is_not_installed() -> None:
    statement = (
        "import sys; sys.modules['gtsam'] = None\n"
        "import pdr_filter as pdr\n"
        "samples = pdr.merge_streams(pdr.simulate.demo_walk())\n"
        "online = pdr.OnlineFilter()\n"
        "n = len(online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps))\n"
        "assert n > 100, n"
    )
    assert "pdr_filter.filter.imm.imm_tracker" in loaded_by(statement)


# --- the rooms, from the ground up ------------------------------------------------------------------------------------

ROOMS = [
    "version",
    "values",
    "io",
    "classifiers",
    "sensing",
    "filter",
    "maps",
    "config",
    "papers",
    "recipes",
    "gnss",
    "counts",
    "filtering",
    "notes",
    "now",
    "serialise",
    "online",
    "report",
    "plot",
    "calibration",
    "tracks",
    "placing",
    "aligned",
    "recording_run",
    "simulate",
    "datasets",
    "evaluate",
    "offline",
    "radio",
    "training",
    "batch",
    "live",
    "",  # the package itself: the public names
    "cli",
]
LEVEL = {room: level for level, room in enumerate(ROOMS)}
PACKAGE = Path(__file__).resolve().parents[1] / "pdr_filter"


def imports_of_modules() -> dict[str, set[str]]:
    """For each module of the package those that it imports, inside of functions too; not those for types alone."""
    names = {path: ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in PACKAGE.rglob("*.py")}
    names = {path: name.removesuffix(".__init__") for path, name in names.items()}
    modules, found = set(names.values()), {}
    for path, name in names.items():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for_types = {
            id(inner)
            for node in ast.walk(tree)
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            for inner in ast.walk(node)
        }
        targets: set[str] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                targets |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and id(node) not in for_types:
                inner = {f"{node.module}.{alias.name}" for alias in node.names}
                targets |= (inner & modules) or {str(node.module)}
        found[name] = (targets & modules) - {name}
    return found


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def test_every_module_lives_in_a_known_room() -> None:
    assert {room_of(m) for m in imports_of_modules()} == set(ROOMS)


def test_no_module_imports_from_a_room_above_its_own() -> None:
    up = [
        f"{module} -> {target}"
        for module, targets in imports_of_modules().items()
        for target in targets
        if LEVEL[room_of(target)] > LEVEL[room_of(module)]
    ]
    assert up == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph = {m: targets - {"pdr_filter"} for m, targets in imports_of_modules().items()}
    while leaves := {m for m, targets in graph.items() if not targets & graph.keys()}:
        graph = {m: targets for m, targets in graph.items() if m not in leaves}
    assert graph == {}


def test_gtsam_is_imported_in_the_offline_room_only() -> None:
    users = {
        room_of(".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts))
        for path in PACKAGE.rglob("*.py")
        if "import gtsam" in path.read_text(encoding="utf-8")
    }
    assert users == {"offline"}


SCRIPTS = sorted(Path(__file__).parent.glob("benchmarks/*.py")) + sorted(Path(__file__).parent.glob("studies/*.py"))


@pytest.mark.parametrize("script", [s for s in SCRIPTS if not s.name.startswith("test_")], ids=lambda path: path.stem)
def test_benchmarks_and_studies_import_what_exists(script: Path) -> None:
    assert importlib.import_module(f"tests.{script.parent.name}.{script.stem}").__doc__
