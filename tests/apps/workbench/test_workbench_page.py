"""The workbench in a real browser: drop, place, mark, smooth, undo, draw, export, by mouse and by keyboard.

With PDR_FILTER_PICTURES=docs/images the first test writes the pictures of the tutorial in docs/workbench.md:

    PDR_FILTER_PICTURES=docs/images python -m pytest tests/apps/workbench/test_workbench_page.py -k from_a_recording
"""

from __future__ import annotations

import base64
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from average_walk import average_walk
from benches import short_walk
from browser import BROWSER, Browser
from PIL import Image, ImageDraw
from typer.testing import CliRunner

import pdr_filter as pdr
from pdr_filter.apps.cli.app import app
from pdr_filter.apps.maps.marks import read_marks

pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
READY = "document.getElementById('said').textContent.includes('up to date')"
# Whether a place is in view on the map.
SEEN = """(p => p.x >= 0 && p.y >= 0 && p.x <= report().map.box.clientWidth && p.y <= report().map.box.clientHeight)(
    report().map.leaflet.latLngToContainerPoint(report().map.at(east, north)))"""
# Address of the picture that the page would save.
PNG = """(async () => {
    const { click } = HTMLAnchorElement.prototype;
    let saved;
    HTMLAnchorElement.prototype.click = function () { saved = this.href; };
    await png();
    HTMLAnchorElement.prototype.click = click;
    return saved;
})()"""
UNBREAKABLE = "walk_" + 55 * "w"  # a name


@contextmanager
def workbench(folder: Path, *options: str) -> Iterator[str]:
    """Address of `pdr-filter app` in a process of its own."""
    command = [sys.executable, "-m", "pdr_filter", "app", str(folder), "--port", "0", "--no-browser", "--jobs", "1"]
    process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True)
    said = ""
    for line in process.stderr:
        said += line
        if line.startswith("Ctrl+C"):
            break
    found = re.search(r"workbench +(\S+)", said)
    assert found, said
    try:
        yield re.sub(r"//[^:]+:", "//127.0.0.1:", found[1])
    finally:
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        process.stderr.close()
        assert process.wait(30) in (0, 130, -2), rest


@pytest.fixture(scope="module")
def several(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a workbench with a walk and a plan for each test: to start one takes seconds."""
    folder = tmp_path_factory.mktemp("walks")
    for name in (UNBREAKABLE, "by keyboard", "of two"):
        short_walk().save(folder / name)
    (folder / "plans").mkdir()
    hall = {"type": "Polygon", "coordinates": [[[0, 0], [30, 0], [30, 20], [0, 20], [0, 0]]]}
    floor = {"properties": {"type": "floor"}, "geometry": hall}
    for name, features in {"Hall": [floor], "Empty": []}.items():
        plan = {"type": "FeatureCollection", "features": features}
        (folder / "plans" / f"{name}.geojson").write_text(json.dumps(plan))
    with workbench(folder) as address:
        yield address


def id_of(browser: Browser, walk: str) -> str:
    """Of a walk of the list when it is tracked."""
    return browser.until(f"[...walks.values()].find(walk => walk.name === '{walk}' && walk.state === 'done')?.id", 60)


def drop(browser: Browser, *files: Path) -> None:
    """Drop files from outside onto the page."""
    data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
    for kind in ("dragEnter", "dragOver", "drop"):
        browser.ask("Input.dispatchDragEvent", type=kind, x=300, y=160, data=data)


def choose_file(browser: Browser, selector: str, file: Path) -> None:
    root = browser.ask("DOM.getDocument")["root"]["nodeId"]
    node = browser.ask("DOM.querySelector", nodeId=root, selector=selector)["nodeId"]
    browser.ask("DOM.setFileInputFiles", nodeId=node, files=[str(file)])


def click_way(browser: Browser, east_m: float, north_m: float) -> None:
    """Click the map of the report at a place."""
    x, y = browser.value(f"""(() => {{
        const {{ map }} = report(), box = map.box.getBoundingClientRect();
        const at = map.leaflet.latLngToContainerPoint(map.at({east_m}, {north_m}));
        return [box.left + at.x, box.top + at.y];
    }})()""")
    for kind in ("mousePressed", "mouseReleased"):
        browser.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    browser.settle()


def click_plan(browser: Browser, *pixels: tuple[float, float]) -> None:
    """Click the map of the editor at pixels of the picture."""
    for x, y in pixels:
        at = browser.value(f"""(() => {{
            const m = scaleOf(storey()), place = map.at({x} * m, (storey().height - {y}) * m);
            const p = map.leaflet.latLngToContainerPoint(place);
            return [p.x / map.box.clientWidth, p.y / map.box.clientHeight];
        }})()""")
        browser.hover("#map", *at)
        browser.click("#map", *at)


def press_button(browser: Browser, selector: str) -> None:
    """Press a button that leads to another page."""
    browser.value(f"setTimeout(() => document.querySelector({selector!r}).click(), 30)")


def draw_house(folder: Path) -> Path:
    """Picture of a building, 10 pixels to a metre: two halls and a door."""
    picture = Image.new("RGB", (900, 500), "white")
    pen = ImageDraw.Draw(picture)
    pen.rectangle((100, 60, 800, 440), outline="black", width=6)
    pen.line((300, 350, 800, 350), fill="black", width=6)
    pen.line((100, 300, 100, 340), fill="white", width=8)
    path = folder / "house.png"
    picture.save(path)
    return path


def test_from_a_recording_to_a_path_on_a_floor_plan(tmp_path: Path) -> None:
    pictures = Path(os.environ.get("PDR_FILTER_PICTURES") or tmp_path)
    walk = average_walk().save(tmp_path / "my walk.zip")
    bad = tmp_path / "notes.zip"
    bad.write_text("no recording")
    folder = tmp_path / "walks"
    with workbench(folder) as address, Browser() as browser:
        # drop
        browser.open(address, 1400, 800)
        browser.until("!document.getElementById('empty').hidden")
        drop(browser, walk, bad)
        browser.until(
            "document.querySelectorAll('#drops li').length === 2 && !document.querySelector('#drops progress')", 60
        )
        browser.until("!!document.querySelector('#list li.done polyline')", 60)
        assert "notes.zip not added: notes.zip: not recognised as a recording" in browser.words("#drops")
        assert re.search(r"file of .*1:54 · \d+ steps · 1\d\d m", browser.value("byId('list').textContent"))
        browser.shot(pictures / "workbench_list.png", is_whole=False)
        # draw
        browser.value("document.getElementById('plan-name').value = 'House'")
        press_button(browser, "#new-plan button")
        browser.until("location.pathname === '/plan/House' && document.readyState === 'complete'")
        browser.until("typeof plan !== 'undefined' && plan !== null")
        choose_file(browser, "#picture", draw_house(tmp_path))
        browser.until("!!document.querySelector('#map img') && document.querySelector('#map img').complete", 60)
        browser.value("document.getElementById('length').value = 70")
        browser.click("#scale")
        click_plan(browser, (100, 250), (800, 250))
        # the map is fitted again when the scale is saved; clicks before would be elsewhere
        browser.until(
            "byId('said').textContent.includes('70 m apart') && Math.abs(storey().metres_per_pixel - 0.1) < 0.002"
        )
        shapes: list[tuple[str, list[tuple[int, int]]]] = [
            ("floor", [(100, 60), (800, 60), (800, 440), (100, 440), (100, 60)]),
            ("wall", [(800, 350), (300, 350), (300, 350)]),
            ("door", [(100, 300), (100, 340), (100, 340)]),
        ]
        for n, (kind, corners) in enumerate(shapes, 1):
            browser.click(f"[data-kind={kind}]")
            click_plan(browser, *corners)
            browser.until(f"ours.size > {n} && plan.features.length === {n}")
            assert browser.value(f"document.querySelector('[data-kind={kind}]').ariaPressed") == "true"  # for the next
        browser.value("document.activeElement.blur()")
        browser.press("Escape")
        assert not browser.value("map.leaflet.pm.globalDrawModeEnabled()")
        browser.until("plan.problems.length === 1")
        assert "the wall is open at 30" in browser.words("#problems")
        assert "--plan plans/House.geojson" in browser.words("#usable")
        browser.shot(pictures / "workbench_plan.png", is_whole=False)
        browser.click("#undo")
        browser.until("plan.features.length === 2 && !document.getElementById('redo').disabled")
        browser.click("#redo")
        browser.until("plan.features.length === 3 && document.getElementById('redo').disabled")
        read = pdr.FloorPlan.read(folder / "plans" / "House.geojson")
        assert read.storeys[0].summary()["width_m"] == pytest.approx(70.0, abs=0.6)
        # place
        assert [words for words in browser.complaints if "422" not in words] == []
        id = browser.value("fetch('/walks').then(a => a.json()).then(found => found.walks[0].id)")
        browser.open(f"{address}walk/{id}", 1400, 1000)
        browser.until(f"report() && {READY}", 60)
        browser.value(
            "(e => { e.value = 'House'; e.dispatchEvent(new Event('change')); })(document.getElementById('plan'))"
        )
        browser.until(f"state.marks.walk.plan === 'House' && {READY}", 60)
        n_steps = browser.value("report().map.track.time.length")
        # a click far from the path leaves the tools usable
        browser.value("(report().map.fit([-20, 90], [-20, 60], 4), 0)")
        for leave in (lambda: browser.press("Escape"), lambda: browser.click("#here")):
            browser.click("#two")
            click_way(browser, 85.0, -15.0)
            assert browser.words("#said").startswith("No step of the path is near.")
            leave()
            assert browser.value("mode?.name ?? null") != "two"
            assert not browser.words("#said").startswith("No step")
        browser.press("Escape")
        assert browser.value("mode") is None
        browser.click("#two")
        for n, row in enumerate((10, n_steps // 3)):
            browser.value("(report().map.fit([-20, 90], [-20, 60], 4), 0)")
            assert browser.value("document.querySelectorAll('.cross.waiting').length") == n
            assert ("The first point is set" in browser.words("#said")) == (n == 1)
            east, north = browser.value(f"[report().map.track.east[{row}], report().map.track.north[{row}]]")
            click_way(browser, east, north)
            assert "Click where you were" in browser.words("#said")
            click_way(browser, east + 15.0, north + 10.0)
        browser.until(f"state.marks.fixes.length === 2 && {READY}", 60)
        fixes = browser.value("state.marks.fixes")
        assert fixes[1][1:3] == pytest.approx([east + 15.0, north + 10.0], abs=0.5)
        assert browser.value("document.querySelectorAll('.cross').length") == 2
        # the picture of the plan lies below the path, where it was drawn
        browser.until("document.querySelector('#map .picture').naturalWidth === 900")
        browser.value("(report().map.whole(), 0)")
        corners = browser.value("report().map.pictures.get(0).corners.map(place => report().map.frame.place(place))")
        assert np.ptp(corners, axis=0) == pytest.approx([90.0, 50.0], abs=1.0)
        assert browser.value(f"[{corners}[1], {corners}[2]].every(([east, north]) => {SEEN})")
        browser.shot(pictures / "workbench_walk.png", is_whole=False)
        # a point that does not fit is refused and says why
        rejected_at_s = browser.value("report().map.track.time[report().map.track.time.length >> 1]")
        browser.value(f"(edit(marks => withFix(marks, [{rejected_at_s}, 74, 12, 0.5, null, null])), 0)")
        browser.until(f"state.marks.fixes.length === 3 && {READY}", 60)
        at, box = (
            browser.value(f"(r => [r.left + r.width / 2, r.top + r.height / 2])({element}.getBoundingClientRect())")
            for element in ("document.querySelector('.cross.rejected')", "report().map.box")
        )
        off = [
            f"{a - b} + report().map.box.client{side} / 2"
            for a, b, side in zip(at, box, ("Width", "Height"), strict=True)
        ]
        place = browser.value(f"report().map.place({off[0]}, {off[1]})")
        assert place == pytest.approx([74.0, 12.0], abs=0.5)
        assert browser.value(f"(([east, north]) => {SEEN})([74, 12])")
        assert "standard deviations away" in browser.words("#fixes .wrong")
        for width, name in ((1400, "workbench_rejected"), (390, "workbench_narrow")):
            browser.ask(
                "Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False
            )
            browser.until(f"innerWidth === {width} && document.documentElement.scrollWidth === {width}")
            browser.value("(report().map.whole(), 0)")
            browser.settle()
            browser.shot(pictures / f"{name}.png", is_whole=False)
        browser.ask("Emulation.setDeviceMetricsOverride", width=1400, height=1000, deviceScaleFactor=1, mobile=False)
        browser.until("innerWidth === 1400")
        browser.click("#undo")
        browser.until(f"state.marks.fixes.length === 2 && {READY}", 60)
        # mark, smooth, undo
        browser.value(
            "(report().show(report().map.track.time.length - 5), report().map.fit([-20, 90], [-20, 60], 4), 0)"
        )
        browser.click("#here")
        click_way(browser, 16.0, 12.0)
        browser.until(f"state.marks.fixes.length === 3 && {READY}", 60)
        assert read_marks(folder / "my walk").fixes[-1].time_s == browser.value("state.marks.fixes[2][0]")
        browser.click("#undo")
        browser.until(f"state.marks.fixes.length === 2 && {READY}", 60)
        browser.click("#redo")
        browser.until(f"state.marks.fixes.length === 3 && {READY}", 60)
        # export
        browser.ask("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path / "saved"))
        for kind, begin in (("csv", "time_s,east_m"), ("geojson", "{")):
            browser.click(f"#export-{kind}")
            end = time.monotonic() + 20
            while not (saved_as := list((tmp_path / "saved").glob(f"*.{kind}"))) and time.monotonic() < end:
                time.sleep(0.05)
            assert saved_as[0].read_text("utf-8").startswith(begin)
        assert browser.value("byId('export-gpx').disabled && byId('export-kml').disabled")
        assert "place the walk on a map" in browser.words("#not-on-earth")
        east = browser.value("report().map.track.heading.findIndex(heading => Math.abs(heading - 90) < 30)")
        browser.value(f"(report().show({east}), 0)")
        saved = Image.open(BytesIO(base64.b64decode(browser.value(PNG).partition(",")[2]))).convert("L")
        signs = ".cross, .end, .bar-of-metres, .north"
        centres = browser.value(f"""[...report().map.box.querySelectorAll("{signs}")].map(sign => {{
            const out = report().map.box.getBoundingClientRect(), at = sign.getBoundingClientRect();
            return [at.left - out.left, at.top - out.top, at.right - out.left, at.bottom - out.top].map(v => 2 * v);
        }})""")
        assert len(centres) == 6
        x, y = browser.value(f"""(p => [2 * p.x, 2 * p.y])(
            report().map.leaflet.latLngToContainerPoint(report().map.way[{east} + 1]))""")
        rows, columns = np.nonzero(np.asarray(saved.crop((x - 40, y - 40, x + 40, y + 40))) < 60)
        assert np.ptp(columns) > np.ptp(rows), "the arrow points east"
        browser.value("(report().map.pictures.clear(), document.querySelector('#map .picture').remove(), 0)")
        without = Image.open(BytesIO(base64.b64decode(browser.value(PNG).partition(",")[2]))).convert("L")
        assert np.mean(np.asarray(saved) != np.asarray(without)) > 0.01  # walls of the picture
        for sign in centres:  # each has something dark in it
            assert min(saved.crop(tuple(map(round, sign))).tobytes()) < 150, sign
        # Compare must keep the marks and the view
        view = browser.value("(report().map.fit([0, 40], [0, 30], 4), report().map.place())")
        browser.click("#compare")
        browser.until("!document.getElementById('show-walk').hidden", 120)
        assert browser.value("report().map.place()") == pytest.approx(view, abs=0.5)
        assert browser.value("document.querySelectorAll('.cross').length") == 3
        browser.click("#show-walk")
        browser.until(f"document.getElementById('show-walk').hidden && {READY}", 60)
        # ground truth is used only if the user asks for it, and then the report says so
        said = "document.body.textContent.includes('position fixes are ground truth of the recording')"
        assert not browser.value(said)
        browser.click("#truth_as_fixes")
        browser.until(f"state.marks.walk.truth_as_fixes && {READY} && {said}", 60)
        assert [url for url in browser.asked_for if not url.startswith((address, "data:"))] == []
        assert browser.complaints == []
    # the command line has the same path
    done = CliRunner().invoke(app, ["smooth", str(folder / "my walk"), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.stderr
    (table,) = (tmp_path / "out").glob("*.csv")
    assert "time_s" in table.read_text()


@pytest.mark.parametrize(("width", "theme"), [(1400, "light"), (390, "dark")])
def test_every_page_can_be_seen_and_read(several: str, tmp_path: Path, width: int, theme: str) -> None:
    with Browser() as browser:
        browser.open(several, width, 900, theme)
        id = id_of(browser, UNBREAKABLE)
        pages: dict[str, str] = {
            "": "byId('more').textContent",
            f"walk/{id}": f"report() && {READY}",
            "plan/Hall": "plan?.features.length",
        }
        for page, ready in pages.items():
            browser.open(several + page, width, 900, theme)
            browser.until(ready, 60)
            browser.settle()
            if page.startswith("walk"):  # the map must be visible without scrolling
                assert browser.value("byId('map').getBoundingClientRect().top") < 200
                assert browser.value("byId('truth_as_fixes').disabled")  # the walk has no waypoints
            assert browser.value("document.documentElement.scrollWidth") == width, page
            unnamed = browser.value("""
                [...document.querySelectorAll('button, select, input, [tabindex], iframe')].filter(e => !(e.ariaLabel
                  || e.title || e.textContent.trim() || e.labels?.length || e.getAttribute('aria-labelledby')))
                  .map(e => e.outerHTML)""")
            assert unnamed == [], page
            covered = browser.value("""
                [...document.querySelectorAll('button, select, input:not(.beyond), label, h1, h2, p')].filter(e => {
                  const r = e.getBoundingClientRect();
                  return r.width && (r.left < 0 || r.left + Math.max(r.width, e.scrollWidth) > innerWidth + 0.5);
                }).map(e => e.outerHTML.slice(0, 80))""")
            assert covered == [], page
            background = browser.value("getComputedStyle(document.body).backgroundColor")
            assert (background == "rgb(255, 255, 255)") == (theme == "light")
            assert browser.shot(tmp_path / f"page{len(page)}.png").stat().st_size > 10_000
            assert browser.complaints == []


def test_a_walk_is_marked_and_a_plan_drawn_with_the_keyboard_alone(several: str) -> None:
    with Browser() as browser:
        browser.open(several)
        id = id_of(browser, "by keyboard")
        browser.open(f"{several}walk/{id}")
        browser.until(f"report() && {READY}", 60)
        browser.value("document.getElementById('direction').click()")
        browser.press("Enter")  # the step that is shown
        place = browser.value("report().map.place()")
        browser.press("Enter")
        browser.press("ArrowRight")
        browser.until(f"report().map.place()[0] > {place[0]} + 0.1")
        browser.press("Enter")
        browser.until(f"state.marks.fixes.length === 1 && {READY}", 60)
        fix = browser.value("state.marks.fixes[0]")
        assert fix[1:3] == pytest.approx(place, abs=0.01)
        assert fix[4] == pytest.approx(90.0, abs=1.0)
        # Escape leaves everything as it is
        browser.value("document.getElementById('here').click()")
        browser.press("Escape")
        assert browser.words("#said") == "Cancelled."
        browser.open(f"{several}plan/Empty")
        browser.until("plan !== null")
        browser.value("document.querySelector('[data-kind=wall]').click()")
        for key in ("Enter", "ArrowRight"):
            browser.press(key)
        browser.until("map.place()[0] !== 0")
        for key in ("Enter", "f"):
            browser.press(key)
        browser.until("ours.size === 1 && plan.features.length === 1")
        assert browser.value("plan.features[0].properties.type") == "wall"


def test_a_browser_that_comes_later_is_told_and_can_make_its_change_again(several: str) -> None:
    with Browser() as browser:
        browser.open(several)
        id = id_of(browser, "of two")
        browser.open(f"{several}walk/{id}")
        browser.until(f"report() && {READY}", 60)
        # The other browser changes the walk, and this one does not know it yet.
        browser.value("state.version = 'old'")
        browser.click("#is_loop")
        browser.until("document.getElementById('said').textContent.startsWith('Not saved: another browser')", 60)
        assert not browser.value("document.getElementById('is_loop').checked")
        browser.click("#said button")
        browser.until(f"state.marks.walk.is_loop && {READY}", 60)
        # It is told of changes that another browser makes.
        other = (
            "ask(base).then(now => ask(`${base}/marks`, { version: now.version, marks: { ...now.marks, walk: {} } }))"
        )
        browser.value(other)
        browser.until("document.getElementById('said').textContent.startsWith('Another browser changed')", 60)
        assert not browser.value("document.getElementById('is_loop').checked")


def test_a_phone_records_into_the_folder(tmp_path: Path) -> None:
    folder = tmp_path / "walks"
    with workbench(folder, "--host", "0.0.0.0", "--token", "secret") as address, Browser() as browser:
        browser.open(address)
        browser.until("!document.getElementById('phone-on').hidden")
        assert browser.value("!!document.querySelector('#phone-code svg')")
        assert "/live/data?token=secret" in browser.words("#phone-address")
        assert "token=secret" in browser.value("document.getElementById('link').value")
        browser.value("""(async () => {
            for (let k = 0; k < 12; k++) {
                const time = Array.from({ length: 100 }, (_, i) => k + i / 100);
                const accelerometer = time.map(t => [t, 0, 0, 9.8 + 3 * Math.sin(12 * t)]);
                const gyroscope = time.map(t => [t, 0, 0, 0]);
                const body = { device: "phone", session: "one", number: k, samples: { accelerometer, gyroscope } };
                const answer = await fetch("/live/data", { method: "POST", body: JSON.stringify(body) });
                if (!answer.ok) throw new Error(await answer.text());
            }
        })()""")
        browser.until("[...walks.values()].some(walk => walk.name.startsWith('phones/') && walk.state === 'done')", 90)
        assert browser.complaints == []
