"""The HTML page of a track in a real browser: nothing is asked of the network, and everything can be seen and read."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.io.recording import Recording
from pdr_filter.report import palette
from pdr_filter.report.html import html_report, write_report
from pdr_filter.tracks import Track

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "chrome-headless-shell")
BROWSER = next((path for name in NAMES if (path := shutil.which(name))), "")
pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")

OPTIONS = (
    "--headless",
    "--no-sandbox",  # Chromium refuses root otherwise, which is what containers have
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # whatever is asked for, nothing leaves the machine
    "--enable-logging=stderr",
)
# Of Chromium's own services, which some versions ask for in spite of the options; a page never names them.
BROWSERS_OWN = (".google.com", ".googleapis.com", ".gstatic.com", ".gvt1.com")
WIDTHS = {"wide": 1000, "phone": 390}
# A copy of the page in a frame as wide as the screen, because windows have a least width; without its policy, which
# forbids scripts. Boxes in pixels of the screen: left, top, right, bottom.
FRAME = """<!DOCTYPE html>
<iframe style="border: none" width="WIDTH" height="2400" srcdoc="PAGE"></iframe>
<pre id="measured"></pre>
<script>
const box = e => { const r = e.getBoundingClientRect(); return [r.left, r.top, r.right, r.bottom]; };
const texts = svg => [...svg.querySelectorAll("text")].map(t => ({words: t.textContent, box: box(t)}));
addEventListener("load", () => {
  const page = document.querySelector("iframe").contentDocument;
  document.getElementById("measured").textContent = JSON.stringify({
    width: page.documentElement.clientWidth,
    scroll_width: page.documentElement.scrollWidth,
    pictures: [...page.querySelectorAll("svg")].map(svg => ({box: box(svg), texts: texts(svg)})),
  });
});
</script>
"""


@dataclass(frozen=True)
class Opened:
    """What came of opening a page."""

    dom: str
    console: list[str]
    asked_of: set[str]  # hosts, those of the browser's own services left out


def opened(path: Path, folder: Path, width: int = 1000, height: int = 2400, shot: Path | None = None) -> Opened:
    log = folder / "net.json"
    what = "--dump-dom" if shot is None else f"--screenshot={shot}"
    places = [f"--user-data-dir={folder / 'profile'}", f"--log-net-log={log}", f"--window-size={width},{height}"]
    ended = subprocess.run(
        [BROWSER, *OPTIONS, *places, what, path.as_uri()], check=True, capture_output=True, timeout=60
    )
    console = [line for line in ended.stderr.decode("utf-8", "replace").splitlines() if ":CONSOLE" in line]
    addresses = re.findall(r'"url":("(?:https?|wss?|ftp)://[^"]*")', log.read_text(encoding="utf-8"))
    hosts = {urlsplit(json.loads(address)).hostname or "" for address in addresses}
    return Opened(
        ended.stdout.decode("utf-8"), console, {host for host in hosts if not f".{host}".endswith(BROWSERS_OWN)}
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return pdr.simulate.demo_walk()


@pytest.fixture(scope="module")
def track(recording: Recording) -> Track:
    """On one storey, as most walks are."""
    found = pdr.track(recording)
    zeros = np.zeros(found.n_steps)
    return replace(found, height_m=zeros, floor=zeros.astype(np.int64), floor_passages=())


@pytest.fixture(scope="module")
def page(track: Track, recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(track, tmp_path_factory.mktemp("report") / "page.html", recording)


def test_a_page_that_loads_something_or_complains_would_be_noticed(tmp_path: Path) -> None:
    """Otherwise the next test could not fail."""
    path = tmp_path / "bad.html"
    path.write_text("<!DOCTYPE html><img src='http://example.org/x.png'><script>console.error('no')</script>")
    seen = opened(path, tmp_path)
    assert seen.asked_of == {"example.org"}
    assert len(seen.console) == 1


def test_the_page_asks_nothing_of_the_network_and_the_console_is_empty(page: Path, tmp_path: Path) -> None:
    seen = opened(page, tmp_path)
    assert seen.asked_of == set()
    assert seen.console == []
    assert not re.search(r"https?:|//\w|<script", seen.dom)


def test_the_browser_finds_every_part_of_the_page(page: Path, track: Track, tmp_path: Path) -> None:
    dom = opened(page, tmp_path).dom
    assert re.findall(r"<h2>(.*?)</h2>", dom) == [
        "Where not to trust it",
        "Way",
        "Contexts over time",
        "Walking speed",
        "Step lengths",
        "How it was read",
    ]
    assert dom.count("<svg") == dom.count("</svg>") == 4
    way = re.search(r"<svg.*?</svg>", dom, re.DOTALL)
    assert way is not None
    assert way[0].count("<ellipse") >= 4
    assert f"{track.n_steps:,} steps" in dom


@pytest.mark.parametrize("screen", WIDTHS)
def test_every_picture_is_on_the_screen_in_the_colours_of_the_contexts(
    page: Path, track: Track, tmp_path: Path, screen: str
) -> None:
    from matplotlib.image import imread

    shot = tmp_path / "page.png"
    assert opened(page, tmp_path, WIDTHS[screen], 2400, shot).console == []
    colours = np.round(255 * imread(shot)[..., :3]).astype(int) @ [65536, 256, 1]  # (height, width), as in #rrggbb
    assert colours.shape[1] == WIDTHS[screen]
    places = measured(page, tmp_path, WIDTHS[screen])["pictures"]
    assert len(places) == 4
    for place in places:
        left, top, right, bottom = (round(v) for v in place["box"])
        # Not an empty sheet: a picture has lines, letters and areas.
        assert len(np.unique(colours[top:bottom, left:right])) > 20
    left, top, right, bottom = (round(v) for v in places[0]["box"])
    walking = palette.COLOURS[track.contexts.index("walking")]
    assert int(walking[1:], 16) in colours[top:bottom, left:right]


def measured(page: Path, folder: Path, width: int) -> dict:
    """Where the browser puts pictures and letters."""
    text = page.read_text(encoding="utf-8")
    without_policy = re.sub(r"<meta http-equiv=.*?/>", "", text)
    assert without_policy != text
    frame = FRAME.replace("WIDTH", str(width)).replace("PAGE", html.escape(without_policy))
    (folder / "frame.html").write_text(frame, encoding="utf-8")
    found = re.search(r'<pre id="measured">(.+?)</pre>', opened(folder / "frame.html", folder).dom)
    assert found is not None
    return json.loads(html.unescape(found[1]))


def readable(page: Path, folder: Path, screen: str) -> None:
    """Nothing is wider than the screen, no words leave their picture or lie on others, none are tiny."""
    seen = measured(page, folder, WIDTHS[screen])
    assert seen["width"] == WIDTHS[screen]
    assert seen["scroll_width"] == seen["width"]
    for picture in seen["pictures"]:
        left, top, right, bottom = picture["box"]
        for text in picture["texts"]:
            a, b, c, d = text["box"]
            assert d - b > 9.0, text
            assert left - 1 <= a <= c <= right + 1, text
            assert top - 1 <= b <= d <= bottom + 1, text
        for i, one in enumerate(picture["texts"]):
            for other in picture["texts"][:i]:
                assert not overlap(one["box"], other["box"]), (one, other)


def overlap(one: list[float], other: list[float]) -> bool:
    """Whether two boxes share more than the edge that lines of text share."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return width > 0 and height > 0.25 * min(one[3] - one[1], other[3] - other[1])


@pytest.mark.parametrize("screen", WIDTHS)
def test_everything_can_be_read_on_a_wide_screen_and_on_a_phone(page: Path, tmp_path: Path, screen: str) -> None:
    readable(page, tmp_path, screen)


@pytest.mark.parametrize("scale", [0.05, 30.0, 4000.0], ids=["a room", "a district", "a country"])
def test_a_way_of_any_size_can_be_read_on_a_phone(track: Track, tmp_path: Path, scale: float) -> None:
    changed = replace(
        track,
        position_m=track.position_m * scale,
        position_cov_m2=track.position_cov_m2 * scale**2,
        time_s=track.time_s * 20,
        duration_s=track.duration_s * 20,
    )
    readable(write_report(changed, tmp_path / "page.html"), tmp_path, "phone")


def test_a_page_without_gyroscope_shows_its_doubts_in_the_browser(recording: Recording, tmp_path: Path) -> None:
    blind = replace(recording, gyroscope=None)
    path = write_report(pdr.track(blind), tmp_path / "page.html", blind)
    seen = opened(path, tmp_path)
    assert seen.console == []
    assert 'class="doubt"' in seen.dom
    assert "No gyroscope" in seen.dom
    readable(path, tmp_path, "phone")


def test_hostile_names_run_nothing_in_the_browser(track: Track, tmp_path: Path) -> None:
    hostile = "</title><script>console.error('ran')</script><img src=http://example.org/x onerror=console.error('ran')>"
    text = html_report(replace(track, name=hostile, notes=(hostile,), weighting=hostile))
    # Also without the policy, so that it is the escaping that holds.
    for number, content in enumerate([text, re.sub(r"<meta http-equiv=.*?/>", "", text)]):
        path = tmp_path / f"{number}.html"
        path.write_text(content, encoding="utf-8")
        seen = opened(path, tmp_path)
        assert seen.asked_of == set()
        assert seen.console == []


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["humolire/humolire_user1_1f.zip", "ubicomp13/ubicomp13_p01_e1_hand_held.zip"])
def test_reports_of_real_recordings_can_be_read_on_a_phone(data_dir: Path, tmp_path: Path, name: str) -> None:
    recording = pdr.read(data_dir / name)
    track = pdr.track(recording, pdr.recipes.for_recording("default", recording))
    readable(write_report(track, tmp_path / "page.html", recording), tmp_path, "phone")
