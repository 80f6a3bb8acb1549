"""Importing costs nothing that is not needed."""

from __future__ import annotations

import subprocess
import sys

import pytest


def loaded_by(statement: str) -> set[str]:
    """Modules that a statement loads in a fresh interpreter.

    From sys.modules: `-X importtime` does not list what importlib.import_module loads, as the package does.
    """
    code = f"{statement}\nimport sys; print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def test_the_list_of_loaded_modules_is_not_empty() -> None:
    assert {"pdr_filter", "pdr_filter.tracks", "numpy"} <= loaded_by("import pdr_filter; pdr_filter.Track")


@pytest.mark.parametrize(
    "module", ["gtsam", "matplotlib", "sklearn", "scipy.signal", "filterpy", "numba", "typer", "rich"]
)
def test_importing_the_package_does_not_load(module: str) -> None:
    assert module not in loaded_by("import pdr_filter")


@pytest.mark.parametrize("module", ["gtsam", "matplotlib", "sklearn.ensemble", "filterpy", "numba", "typer", "rich"])
def test_importing_the_online_filter_does_not_load(module: str) -> None:
    assert module not in loaded_by("import pdr_filter.online")


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
    assert "pdr_filter.filter.imm_tracker" in loaded_by(statement)
