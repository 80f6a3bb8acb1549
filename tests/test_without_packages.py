"""Packages that are not installed: what needs them says so in one sentence, and everything else works."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from doctest import DocTestFinder
from importlib import import_module
from pathlib import Path

import pytest

import pdr_filter as pdr
from pdr_filter.apps.cli import console

OPTIONAL = ("gtsam", "filterpy", "pywt", "matplotlib")
WALK = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=12.0)])

NEEDS: dict[str, dict[str, Callable[[], object]]] = {
    "gtsam": {
        "smooth": lambda: pdr.smooth(WALK),
        "calibrate": lambda: pdr.calibrate([WALK], smooth=True),
        "map_walks": lambda: pdr.map_walks([WALK]),
        "smooth --loop": lambda: console.estimates(WALK, False, True, False, None),
    },
    "filterpy": {"FilterpyImm": lambda: import_module("pdr_filter.filter.imm.filterpy_backend")},
    "pywt": {"martinelli2018": lambda: pdr.track(WALK, pdr.recipes.martinelli2018())},
    "matplotlib": {
        "plot": lambda: pdr.track(WALK).plot(),
        "pdr.plot": lambda: import_module("pdr_filter.apps.report.plot"),
    },
}


@pytest.fixture
def blocked(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Function after whose call a package is not installed, and the modules that imported it are not loaded."""

    def block(package: str) -> None:
        users = ("pdr_filter.filter.imm.filterpy_backend", "pdr_filter.apps.report.plot")
        for name in [name for name in sys.modules if name.startswith((f"{package}.", *users))]:
            parent, _, child = name.rpartition(".")
            if parent in sys.modules:  # which has the module as an attribute
                monkeypatch.delattr(sys.modules[parent], child, raising=False)
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, package, None)

    return block


@pytest.mark.parametrize(("package", "what"), [(package, what) for package in NEEDS for what in NEEDS[package]])
def test_what_needs_a_package_that_is_not_installed_says_so_with_the_remedy(
    package: str, what: str, blocked: Callable[[str], None]
) -> None:
    blocked(package)
    with pytest.raises(ImportError, match=rf"needs {package}, which is not installed: pip install .*") as raised:
        NEEDS[package][what]()
    assert "\n" not in str(raised.value)


def test_tracks_apps_calibrations_and_reports_need_none_of_these_packages() -> None:
    code = (
        f"import sys; sys.modules.update(dict.fromkeys({OPTIONAL}))\n"
        "import pdr_filter as pdr\n"
        "walk = pdr.simulate.simulate([pdr.simulate.Leg('walking', distance_m=40.0)])\n"
        "track = pdr.track(walk)\n"
        "samples = pdr.merge_streams(walk)\n"
        "online = pdr.OnlineFilter()\n"
        "n = len(online.push(samples.time_s, samples.specific_force_mps2, samples.angular_rate_radps))\n"
        "assert n > 40, n\n"
        "pdr.calibrate([walk])\n"
        "assert str(track.n_steps) in track.report()\n"
        "assert pdr.smooth.__doc__\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_gtsam_the_command_gives_the_online_track_with_a_note(blocked: Callable[[str], None]) -> None:
    blocked("gtsam")
    (track,) = console.estimates(WALK, False, False, False, None)
    assert not track.is_smoothed
    assert any("gtsam is not installed; pip install" in note for note in track.notes)


def test_modules_that_need_gtsam_can_be_inspected_without_it(blocked: Callable[[str], None]) -> None:
    blocked("gtsam")
    assert DocTestFinder().find(import_module("pdr_filter.offline.smoothing.solve"))


def test_an_error_inside_an_installed_package_is_not_called_a_missing_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pdr_filter.values.optional_packages import load_optional

    (tmp_path / "pywt.py").write_text("import no_such_package")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pywt", raising=False)
    with pytest.raises(ImportError, match="No module named 'no_such_package'"):
        load_optional("pywt")
