"""Recipes from outside of the package: modules, entry points, and a distribution of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter import recipes
from pdr_filter.apps.cli.app import app

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "own_recipe"
MODULE = """
from dataclasses import replace
import pdr_filter as pdr

def of_subject(subject):
    return replace(pdr.recipes.default(subject).with_weighting("hc"), name="of_subject")

def of_nobody():
    return replace(pdr.recipes.default(), name="of_nobody")

def nothing(subject):
    return None

number = 3
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a module of recipes, in which the user works."""
    (tmp_path / "my_own_recipes.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    sys.modules.pop("my_own_recipes", None)


def test_a_function_of_a_module_in_the_working_folder_is_a_recipe(folder: Path) -> None:
    walk = pdr.simulate.demo_walk()
    config = recipes.for_recording("my_own_recipes:of_subject", walk)
    assert (config.name, config.tracker.weighting) == ("of_subject", "hc")
    assert recipes.for_recording("my_own_recipes:of_nobody", walk).name == "of_nobody"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none", "no recipe 'none'; there are default, .*module:function"),
        ("no_such_module:recipe", "cannot be imported .*no_such_module.py in this folder"),
        ("my_own_recipes:missing", "cannot be imported"),
        ("my_own_recipes:number", "must be a function that returns a Config, got 3"),
        (":recipe", "cannot be imported"),
    ],
)
def test_a_name_that_is_no_recipe_is_refused_with_the_reason(folder: Path, name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        recipes.check_name(name)


def test_a_recipe_must_return_a_configuration(folder: Path) -> None:
    with pytest.raises(ValueError, match="must return a Config, got None"):
        recipes.for_recording("my_own_recipes:nothing", pdr.simulate.demo_walk())


def test_the_command_tracks_with_a_recipe_of_a_module(folder: Path) -> None:
    pdr.simulate.demo_walk().save(folder / "walk.zip")
    done = CliRunner().invoke(app, ["track", "walk.zip", "--recipe", "my_own_recipes:of_subject", "--online", "--json"])
    assert done.exit_code == 0, done.output
    expected = pdr.track(pdr.read(folder / "walk.zip"), weighting="hc")
    assert json.loads(done.stdout)["distance_m"] == pytest.approx(expected.distance_m, abs=0.01)
    refused = CliRunner().invoke(app, ["track", "walk.zip", "--recipe", "my_own_recipes:missing"])
    assert refused.exit_code == 2


def test_a_recipe_with_own_classes_is_refused_by_the_live_server_when_it_starts(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))
    done = CliRunner().invoke(app, ["live", "--recipe", "slow_walkers:recipe"])
    assert done.exit_code == 2
    assert "classes outside of pdr_filter" in " ".join(done.output.split())


# It builds the example without an index. In CI, which installs the packages of the tests, it is never left out.
@pytest.mark.skipif(
    find_spec("hatchling") is None and not os.environ.get("CI"), reason="needs hatchling: pip install -e .[test]"
)
def test_the_example_is_a_distribution_whose_recipe_the_command_finds_by_its_name(tmp_path: Path) -> None:
    source = shutil.copytree(EXAMPLE, tmp_path / "source", ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    offline = ["--no-index", "--no-deps", "--no-build-isolation", "--target", tmp_path / "clean"]
    built = subprocess.run([*pip, *offline, source], capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    pdr.simulate.demo_walk().save(tmp_path / "walk.zip")
    package = Path(pdr.__file__).parents[1]
    main = [sys.executable, "-c", "from pdr_filter.apps.cli import main; main()"]
    done = subprocess.run(
        [*main, *["track", "walk.zip", "--recipe", "slow-walkers", "--online", "--json"]],
        cwd=tmp_path,
        env={"PYTHONPATH": f"{tmp_path / 'clean'}:{package}", "PATH": "/usr/bin:/bin", "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert '"n_steps"' in done.stdout
