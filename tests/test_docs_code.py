"""The code, commands, names and links of the pages: what a reader types works."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pymap3d
import pytest
import typer.main
from helpers import cut_randomly

import pdr_filter as pdr
from pdr_filter.cli.app import app
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.values.samples import Samples

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")])
    if "_build" not in path.parts
}
# They need a cluster, the arrays of a study, and a walk of six minutes.
NOT_RUN = {"docs/methods/batch.md", "docs/methods/rvm.md", "docs/methods/smoothing.md"}
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WITH_CODE = [name for name, text in PAGES.items() if CODE.search(text) and name not in NOT_RUN | {"docs/index.md"}]


@pytest.fixture(scope="module")
def recording() -> pdr.Recording:
    """A short walk of known length, with positions of a GNSS receiver every four seconds, 3 m off."""
    legs = [Leg("stationary", duration_s=3.0), *(Leg("walking", distance_m=d, turn_rad=1.5) for d in (25.0, 20.0))]
    walk = simulate(legs, Gait(height_m=1.75), seed=1, name="walk")
    truth, rng = walk.truth.position, np.random.default_rng(1)
    time_s = np.arange(2.0, walk.duration_s - 2.0, 4.0)
    place_m = [np.interp(time_s, truth.time_s, truth[n]) + rng.normal(0, 3, len(time_s)) for n in ("east_m", "north_m")]
    lat_deg, lon_deg, _ = pymap3d.enu2geodetic(*place_m, 0.0, 51.4779, -0.0015, 0.0)
    values = np.column_stack([lat_deg, lon_deg, np.zeros(len(time_s)), np.full(len(time_s), 3.0)])
    subject = {**walk.meta["subject"], "id": "s1"}
    return replace(walk, location=Samples(time_s, values), meta={**walk.meta, "subject": subject})


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs_from_top_to_bottom(
    page: str, recording: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = recording.save("walk.zip")
    # What pages take for granted: the reader's recording, and the samples of an app.
    names: dict[str, Any] = {
        "pdr": pdr,
        "recording": recording,
        "paths": [path],
        "blocks": cut_randomly(pdr.merge_streams(recording), seed=0),
    }
    for code in CODE.findall(PAGES[page]):
        exec(compile(code, page, "exec"), names)


def test_the_pages_that_show_code_are_run() -> None:
    assert {"README.md", "docs/faq.md", "docs/formats.md", "docs/methods/recipes.md"} <= set(WITH_CODE)


def test_the_first_page_draws_a_track_in_ten_lines_that_need_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = CODE.findall(PAGES["docs/index.md"])
    exec(compile(code, "docs/index.md", "exec"), {})
    assert len(code.splitlines()) == 10
    assert "<svg" in (tmp_path / "track.svg").read_text(encoding="utf-8")
    assert re.search(r"\d+ steps, [\d.]+ m in", capsys.readouterr().out)


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Command and options of each `pdr-filter COMMAND ...` in code, of a line or of a block."""
    shell = "\n".join(re.findall(r"^```(?:sh|bash)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    for line in [*re.findall(r"`(pdr-filter [^`]+)`", text), *re.findall(r"^ *(pdr-filter .*)$", shell, re.MULTILINE)]:
        words = line.split("#")[0].split()
        if len(words) > 1:
            yield words[1], [word for word in words if word.startswith("--")]


@pytest.mark.parametrize("page", PAGES)
def test_commands_and_options_that_a_page_names_exist(page: str) -> None:
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for command, options in commands(PAGES[page]):
        assert command in known, f"{page}: pdr-filter {command}"
        there = {name for parameter in known[command].params for name in parameter.opts}
        assert set(options) <= there, f"{page}: pdr-filter {command}: {set(options) - there}"


def test_commands_are_found_in_text_and_in_blocks() -> None:
    text = "run `pdr-filter info FILE --json` or\n```sh\npdr-filter demo  # --no-option\n```\n"
    assert list(commands(text)) == [("info", ["--json"]), ("demo", [])]


def resolved(name: str) -> Any:
    """What a dotted name of the package stands for; AttributeError if nothing."""
    parts = name.split(".")
    value: Any = pdr
    for k, part in enumerate(parts[1:], 1):
        if not hasattr(value, part):
            if part in getattr(value, "__dataclass_fields__", {}):  # one without default is no attribute of the class
                return None
            try:
                importlib.import_module(".".join(["pdr_filter", *parts[1 : k + 1]]))
            except ImportError:
                raise AttributeError(name) from None
        value = getattr(value, part)
    return value


@pytest.mark.parametrize("page", PAGES)
def test_names_of_the_package_that_a_page_gives_exist(page: str) -> None:
    text = re.sub(r"^```python\n.*?^```$", "", PAGES[page], flags=re.MULTILINE | re.DOTALL)  # which is run
    for name in re.findall(r"[`~ ]((?:pdr|pdr_filter)(?:\.[A-Za-z_]\w*)+)", text):
        if not name.endswith((".zip", ".NAME")):
            resolved(name)


def test_a_name_that_does_not_exist_is_noticed() -> None:
    assert resolved("pdr.recipes.default") is pdr.recipes.default
    for name in ("pdr.recipes.best", "pdr_filter.sensing.steps.detector.StepDetectors", "pdr_filter.stepz"):
        with pytest.raises(AttributeError):
            resolved(name)


@pytest.mark.parametrize("page", PAGES)
def test_relative_links_of_a_page_lead_somewhere(page: str) -> None:
    text = re.sub(r"^```.*?^```$", "", PAGES[page], flags=re.MULTILINE | re.DOTALL)
    images = re.findall(r"^```\{(?:image|figure)\} (\S+)", PAGES[page], re.MULTILINE)
    for link in [*re.findall(r"\]\(([^)\s]+)\)", text), *images]:
        target, _, heading = link.partition("#")
        if re.match(r"[a-z]+:", link):
            continue
        path = (ROOT / page).parent / target if target else ROOT / page
        assert path.exists(), f"{page}: {link}"
        if heading:
            lines = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in lines}
            assert heading in anchors, f"{page}: {link}"


def test_every_public_name_has_its_place_in_the_api_page() -> None:
    api = PAGES["docs/api.md"]
    missing = [name for name in pdr.__all__ if not re.search(rf"pdr_filter\.{name}\b", api)]
    assert missing == []


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = set(re.findall(r"^([\w/]+)$", PAGES["docs/index.md"], re.MULTILINE))
    pages = {str(Path(name).relative_to("docs").with_suffix("")) for name in PAGES if name.startswith("docs/")}
    assert pages - {"index"} <= listed
