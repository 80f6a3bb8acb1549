"""Names of modules in version 0.1 work for one release, with a warning."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

FORMER = {
    "pdr_filter.io.recording": ("pdr_filter.values.recording", "Subject"),
    "pdr_filter.recording_run": ("pdr_filter.tracking.whole_recording", "track"),
    "pdr_filter.papers.zhou2019.steps": ("pdr_filter.recipes.zhou2019.steps", "ReferenceLineStepDetector"),
    "pdr_filter.classifiers.transition_probabilities": ("pdr_filter.classifiers.transition_files", "Transitions"),
    "pdr_filter.plot.walks": ("pdr_filter.report.plot.walk_plots", "track"),
}


def test_a_former_module_has_the_names_of_the_present_one() -> None:
    """In a fresh interpreter, which has loaded neither of them."""
    code = (
        "import importlib, warnings\n"
        f"for former, (present, name) in {FORMER}.items():\n"
        "    with warnings.catch_warnings(record=True) as caught:\n"
        "        warnings.simplefilter('always')\n"
        "        old = importlib.import_module(former)\n"
        "    assert getattr(old, name) is getattr(importlib.import_module(present), name), former\n"
        "    assert f'{former} is now {present}' in [str(w.message) for w in caught], (former, caught)\n"
        "    assert {w.category for w in caught} == {DeprecationWarning}, (former, caught)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("package", "module", "name"),
    [
        ("pdr_filter.filter.imm", "imm", "combine"),
        ("pdr_filter.filter.step_length", "models", "StepLengthFit"),
        ("pdr_filter.filter.fixes", "fix_updates", "use_fix"),
        ("pdr_filter.filter.height", "height_filter", "HeightState"),
    ],
)
def test_a_package_has_the_names_of_the_module_that_it_was(package: str, module: str, name: str) -> None:
    with pytest.warns(DeprecationWarning, match=rf"{name} is now in {package}\.{module}"):
        found = getattr(importlib.import_module(package), name)
    assert found is getattr(importlib.import_module(f"{package}.{module}"), name)


def test_a_module_that_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match="nowhere"):
        importlib.import_module("pdr_filter.nowhere")
    with pytest.raises(AttributeError, match="nowhere"):
        getattr(importlib.import_module("pdr_filter.filter.imm"), "nowhere")  # noqa: B009
