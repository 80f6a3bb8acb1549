"""The code, commands, names and links of the pages: what a reader types works."""

from __future__ import annotations

import importlib
import inspect
import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main
from examples import compute_once, leave_pictures_blank, use_few_particles
from heard import heard_along
from true_positions import located, true_m
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.simulate import Gait, Leg, simulate
from pdr_filter.simulate.sensors import BAROMETER, SensorErrors
from pdr_filter.values import Samples
from pdr_filter.values.recording import Truth
from tests.benchmarks.common import FOLDER, Tables, readme_with_tables
from tests.benchmarks.throughput import QUIET_DASK

pytestmark = pytest.mark.usefixtures("sensing_once")

ROOT = Path(__file__).resolve().parents[1]
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")])
    if not {"_build", "tables"} & set(path.parts)
}
TABLES = {path.stem: path.read_text(encoding="utf-8") for path in sorted(FOLDER.glob("*.md"))}
# They need a cluster, the arrays of a study, and a walk of six minutes.
NOT_RUN = {f"docs/methods/{name}.md" for name in ("batch", "cohort", "rvm", "smoothing")}
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
WITH_CODE = [name for name, text in PAGES.items() if CODE.search(text) and name not in NOT_RUN | {"docs/index.md"}]

_RING = [[-40.0, -40.0], [40.0, -40.0], [40.0, 40.0], [-40.0, 40.0], [-40.0, -40.0]]
HALL = {
    "type": "Feature",
    "properties": {"type": "floor", "name": "entrance hall"},
    "geometry": {"type": "Polygon", "coordinates": [_RING]},
}
BUILDING = json.dumps({"type": "FeatureCollection", "features": [HALL]})


@pytest.fixture(scope="module")
def recording() -> pdr.Recording:
    """A short walk of known length, with positions of a GNSS receiver every four seconds, 3 m off, and Wi-Fi."""
    legs = [Leg("stationary", duration_s=3.0), *(Leg("walking", distance_m=d, turn_rad=1.5) for d in (25.0, 20.0))]
    walk = simulate(legs, Gait(height_m=1.75), seed=1, name="walk")
    time_s = np.arange(2.0, walk.duration_s - 2.0, 4.0)
    off_m = np.random.default_rng(1).normal(0, 3, (len(time_s), 2))
    outdoors = located(walk, time_s, pdr.Origin(51.4779, -0.0015), 3.0, off_m)
    subject = {**walk.meta["subject"], "id": "s1"}
    wifi = heard_along(time_s, true_m(walk, time_s), seed=1)
    return replace(outdoors, wifi=wifi, meta={**walk.meta, "subject": subject})


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs_from_top_to_bottom(
    page: str, recording: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    compute_once(monkeypatch)
    use_few_particles(monkeypatch)
    recording.save("walk.zip")
    Path("building.geojson").write_text(BUILDING, "utf-8")
    names: dict[str, Any] = {}
    for code in CODE.findall(PAGES[page]):
        exec(compile(code, page, "exec"), names)


def test_the_loop_of_the_page_about_apps_gives_the_bits_of_the_track_with_a_barometer_that_begins_before_zero() -> None:
    walk = simulate(
        [Leg("walking", distance_m=20.0), Leg("upstairs", distance_m=4.0)], errors=SensorErrors(barometer=BAROMETER)
    )
    early = {n: Samples(s.time_s - (0.004 if n != "accelerometer" else 0.0), s.values) for n, s in walk.streams.items()}
    walk = replace(walk, **early)
    (loop,) = (code for code in CODE.findall(PAGES["docs/online.md"]) if "push_pressure" in code)
    names: dict[str, Any] = {"walk": walk}
    exec(compile(loop.replace("pdr.simulate.demo_walk()", "walk"), "docs/online.md", "exec"), names)
    final = [update for update in names["updates"] if update.is_final]
    track = pdr.track(walk)
    np.testing.assert_array_equal([u.position_m for u in final], track.position_m)
    np.testing.assert_array_equal([u.height_m for u in final], track.height_m)


def test_no_item_of_a_numbered_list_holds_another_one() -> None:
    inside = {name: re.findall(r"^\d+\. .*[.)] \d+\. [A-Z].*$", text, re.MULTILINE) for name, text in PAGES.items()}
    assert not {name: lines for name, lines in inside.items() if lines}


def test_the_pages_that_show_code_or_commands_are_run() -> None:
    assert {"README.md", "docs/faq.md", "docs/online.md", "docs/methods/recipes.md"} <= set(WITH_CODE)
    assert {"docs/locations.md", "docs/faq.md"} <= set(WITH_COMMANDS)


def test_the_first_page_draws_a_track_in_ten_lines_that_need_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (code,) = CODE.findall(PAGES["docs/index.md"])
    exec(compile(code, "docs/index.md", "exec"), {})
    assert len(code.splitlines()) == 10
    assert "<svg" in (tmp_path / "track.svg").read_text(encoding="utf-8")
    assert re.search(r"[\d.]+ m in \d+ s, \d+ steps", capsys.readouterr().out)


BLOCK = re.compile(r"^```sh\n((?:pdr-filter .*\n)+)```$", re.MULTILINE)
# They show what may be given, in brackets.
WITH_COMMANDS = [name for name, text in PAGES.items() if any("[" not in b for b in BLOCK.findall(text))]


@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_the_commands_of_a_page_run_as_they_are_typed(
    page: str, recording: pdr.Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine = replace(recording, truth=Truth())  # of which a reader's phone knows nothing
    mine.save(tmp_path / "walk.zip")
    recording.save(tmp_path / "surveyed" / "walk.zip")
    replace(mine, location=None, name="indoors").save(tmp_path / "indoors.zip")
    marks = tmp_path / "surveyed" / "walk.zip.marks"  # by which a single walk is a map
    marks.mkdir()
    (marks / "fixes.csv").write_text("time_s,east_m,north_m\n4,0,0\n", encoding="utf-8")
    (tmp_path / "fixes.csv").write_text("time_s,east_m,north_m\n4,0,0\n20,1,20\n30,10,25\n", encoding="utf-8")
    (tmp_path / "loops.csv").write_text("first_s,second_s,std_m\n3.0,6.0,10\n", encoding="utf-8")
    (tmp_path / "building.geojson").write_text(BUILDING, "utf-8")
    monkeypatch.chdir(tmp_path)
    use_few_particles(monkeypatch)
    leave_pictures_blank(monkeypatch)
    for block in BLOCK.findall(PAGES[page]):
        for line in block.splitlines():  # each names the one command: no shell and no process of its own is needed
            done = CliRunner().invoke(app, shlex.split(line, comments=True)[1:])
            assert done.exit_code == 0, done.stderr
    for name in re.findall(r"# .*?((?:results|local|smoothed)/\S+)", PAGES[page]):
        assert (tmp_path / name).is_file()


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
                value = importlib.import_module(".".join(["pdr_filter", *parts[1 : k + 1]]))
            except ImportError:
                raise AttributeError(name) from None
        else:
            value = getattr(value, part)
    return value


@pytest.mark.parametrize("page", PAGES)
def test_names_of_the_package_that_a_page_gives_exist(page: str) -> None:
    text = re.sub(r"^```python\n.*?^```$", "", PAGES[page], flags=re.MULTILINE | re.DOTALL)  # which is run
    for name in re.findall(r"[`~ ]((?:pdr|pdr_filter)(?:\.[A-Za-z_]\w*)+)", text):
        if not name.endswith((".zip", ".NAME")):
            assert resolved(name) is not None, name


def test_a_name_that_does_not_exist_is_noticed() -> None:
    assert resolved("pdr.recipes.default") is pdr.recipes.default
    for name in ("pdr.recipes.best", "pdr_filter.sensing.steps.step_detector.StepDetectors", "pdr_filter.stepz"):
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


def test_the_citation_names_the_version_of_the_package() -> None:
    (version,) = re.findall(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert version == pdr.__version__


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = set(re.findall(r"^(?:\d+\. .* <)?([\w/]+)>?$", PAGES["docs/index.md"], re.MULTILINE))
    pages = {str(Path(name).relative_to("docs").with_suffix("")) for name in PAGES if name.startswith("docs/")}
    assert pages - {"index"} <= listed


# --- tables -------------------------------------------------------------------------------------------------------


def tables_of(text: str) -> list[str]:
    """Names of the table files that a page includes, or holds a copy of."""
    found = re.findall(r"^```\{include\} \S*tables/(\w+)\.md$|^<!-- table (\w+) -->$", text, re.MULTILINE)
    return [included or copied for included, copied in found]


def test_every_table_file_stands_on_a_page_and_every_table_of_a_page_is_there() -> None:
    assert {name for text in PAGES.values() for name in tables_of(text)} == set(TABLES)


def test_the_page_of_benchmarks_leads_to_every_page_with_a_table() -> None:
    links = set(re.findall(r"\]\(([\w/]+\.md)", PAGES["docs/benchmarks.md"]))
    with_tables = {page.removeprefix("docs/") for page, text in PAGES.items() if tables_of(text)}
    assert with_tables - {"README.md", "benchmarks.md"} <= links


@cache
def source_of_benchmarks() -> str:
    return "".join(p.read_text("utf-8") for p in (ROOT / "tests" / "benchmarks").rglob("*.py"))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_says_the_command_that_wrote_it_and_the_day(name: str) -> None:
    *_, caption = TABLES[name].strip().splitlines()
    found = re.search(
        r"`python -m ((?:tests\.(?:benchmarks|studies)|models\.training)(?:\.\w+)+)(?: [^`]+)?`, \d{4}-\d\d-\d\d",
        caption,
    )
    assert found, caption
    script = ROOT / found[1].replace(".", "/")
    # the command for the peers runs that of another table, too
    files = [*script.glob("*.py"), script.parent / "rvm_speed.py"] if script.is_dir() else [script.with_suffix(".py")]
    assert any(f'"{name}"' in path.read_text("utf-8") for path in files)


def test_the_settings_of_the_page_on_clusters_are_those_of_its_table() -> None:
    lines = PAGES["docs/methods/batch.md"].splitlines()
    assert [line for line in lines if line.startswith("export ")] == [f"export {n}={v}" for n, v in QUIET_DASK.items()]


def test_the_tables_of_the_first_page_are_those_of_their_files() -> None:
    assert readme_with_tables(PAGES["README.md"]) == PAGES["README.md"], "run python -m tests.benchmarks.common"


def test_a_table_with_the_same_numbers_has_the_same_bytes_another_day(tmp_path: Path) -> None:
    tables, path = Tables("python -m tests.benchmarks.steps", tmp_path), tmp_path / "some.md"
    tables.write("some", ["a", "b"], [["x", 1.5]], day="2020-01-01")
    first = path.read_text("utf-8")
    assert first == "| a | b |\n| --- | --- |\n| x | 1.5 |\n\n*`python -m tests.benchmarks.steps`, 2020-01-01.*\n"
    tables.write("some", ["a", "b"], [["x", 1.5]], day="2020-01-02")
    assert path.read_text("utf-8") == first
    tables.write("some", ["a", "b"], [["x", 1.6]], day="2020-01-02")
    assert "1.6" in path.read_text("utf-8")
    with pytest.raises(ValueError, match="2 cells"):
        tables.write("some", ["a", "b"], [["x"]])


def test_the_places_of_the_equations_exist() -> None:
    (equations,) = re.findall(r"^## Equations of the papers$(.*?)^## ", PAGES["docs/architecture.md"], re.M | re.DOTALL)
    names = [re.findall(r"`([\w.]+)`", line) for line in re.findall(r"^- .*$", equations, re.MULTILINE)]
    assert len(names) > 20
    for first, *others in names:
        there = resolved(f"pdr_filter.{first}")
        for name in others:
            if "." in name:
                resolved(f"pdr_filter.{name}")
            else:  # of the same module as the first
                module = there if inspect.ismodule(there) else inspect.getmodule(there)
                assert hasattr(module, name), f"{name} is not in {first}"
