"""HTML report in a real browser: drawing, pointing, zooming, and no network access."""

from __future__ import annotations

import io
import re
import time
from collections.abc import Generator
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import BROWSER, Browser
from helpers import a_plan

import pdr_filter as pdr
from pdr_filter.apps.cli.index_page import write_index
from pdr_filter.apps.report import palette
from pdr_filter.apps.report.html import html_report, write_report
from pdr_filter.tracking.track import Track
from pdr_filter.values import Cluster, FixResult, IntArray, RangeFix
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")

WIDTHS = {"wide": 1280, "phone": 390}
CHARTS = ["contexts", "speed", "lengths", "heading"]


@pytest.fixture(scope="module")
def browser() -> Generator[Browser]:
    with Browser() as driven:
        yield driven


@pytest.fixture(scope="module")
def page(track: Track, recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_report(track, tmp_path_factory.mktemp("report") / "page.html", recording)


def shown(browser: Browser) -> dict[str, str]:
    """Return the table of the selected step."""
    rows = browser.value("[...document.querySelectorAll('#step tr')].map(r => [...r.children].map(c => c.textContent))")
    return dict(rows)


def step_shown(browser: Browser) -> int:
    return int(shown(browser)["step"].split()[0])


def seen(browser: Browser, selector: str) -> IntArray:
    """Return a screenshot of an element, (height, width, 3)."""
    image = matplotlib.image.imread(io.BytesIO(browser.picture(selector)))
    return np.round(255 * image[..., :3]).astype(int)


def colours_of(browser: Browser, selector: str) -> set[str]:
    """Return all colours in a screenshot of an element, as #RRGGBB."""
    pixels = np.unique(seen(browser, selector).reshape(-1, 3), axis=0)
    return {"#{:02X}{:02X}{:02X}".format(*pixel) for pixel in pixels}


def picture(browser: Browser, name: str) -> str:
    """Return a screenshot of a chart, to compare it with others."""
    return browser.value(f"document.querySelector('#{name} canvas').toDataURL()")


def scrub(browser: Browser, time_s: float) -> None:
    browser.value(
        f"(() => {{ const t = document.getElementById('time'); t.value = {time_s};"
        "t.dispatchEvent(new Event('input', {bubbles: true})); })()"
    )
    browser.settle()


def way(browser: Browser) -> IntArray:
    """Return a screenshot of the map, without the influence of the mouse position."""
    browser.hover("h1")
    scrub(browser, 30.0)
    return seen(browser, "#map")


def is_same(one: IntArray, other: IntArray) -> bool:
    """Return True if two screenshots are equal except at the edges of lines."""
    return float((np.abs(one - other).max(axis=2) > 100).mean()) < 1e-4


def way_but(browser: Browser, before: IntArray) -> IntArray:
    """Return a screenshot of the map when it has changed, because the wheel zooms with a delay."""
    end = time.monotonic() + 5.0
    while is_same(now := way(browser), before):
        assert time.monotonic() < end, "the map stays as it was"
    return now


def test_network_access_and_errors_of_a_page_are_detected(browser: Browser, tmp_path: Path) -> None:
    """Without this check, the next test could not fail."""
    path = tmp_path / "bad.html"
    path.write_text("<!DOCTYPE html><img src='http://example.org/x.png'><script>console.error('no')</script>")
    browser.open(path)
    assert "http://example.org/x.png" in browser.asked_for
    assert any("error" in complaint for complaint in browser.complaints)


@pytest.mark.parametrize(("screen", "theme"), [("wide", "light"), ("phone", "dark")])
def test_all_is_drawn_on_any_screen_and_nothing_leaves_the_page(
    browser: Browser, page: Path, track: Track, screen: str, theme: str
) -> None:
    browser.open(page, WIDTHS[screen], theme=theme)
    assert browser.asked_for == [page.as_uri()]
    assert browser.complaints == []
    assert browser.value("document.documentElement.scrollWidth") == WIDTHS[screen]
    walking = palette.COLOURS[track.contexts.index("walking")].upper()
    assert walking in colours_of(browser, "#map")
    for name in CHARTS:
        box = browser.value(f"document.querySelector('#{name} canvas').getBoundingClientRect().toJSON()")
        assert box["left"] >= 0
        assert box["right"] <= WIDTHS[screen]
        assert len(colours_of(browser, f"#{name} canvas")) > 10  # lines, letters and areas
    paper = browser.value("getComputedStyle(document.body).backgroundColor")
    assert (min(map(int, re.findall(r"\d+", paper))) > 200) == (theme == "light")


def test_the_theme_can_be_changed(browser: Browser, page: Path) -> None:
    browser.open(page)
    light = {name: picture(browser, name) for name in CHARTS}
    browser.click("#theme")
    assert "#15181C" in colours_of(browser, "#map")
    assert all(picture(browser, name) != before for name, before in light.items())
    assert browser.value("document.documentElement.dataset.theme") == "dark"


def test_the_last_step_is_shown_first_with_its_numbers(browser: Browser, page: Path, track: Track) -> None:
    browser.open(page)
    said = shown(browser)
    assert said["step"] == f"{track.n_steps} of {track.n_steps}"
    assert said["length"] == f"{track.step_length_m[-1]:.2f} m"
    assert said["heading"] == f"{np.degrees(track.walking_heading_rad[-1]) % 360:.0f}°"
    assert said["standard deviation"] == f"± {track.position_std_m[-1]:.1f} m"
    assert float(said["position error"].split()[0]) < 5.0
    best = track.contexts[int(track.context_prob[-1].argmax())]
    assert f"{best}\n" in browser.words("#probabilities")


def test_pointing_at_the_path_selects_the_nearest_step(browser: Browser, page: Path, track: Track) -> None:
    browser.open(page)
    k = 60
    browser.hover("#map", *pixel_of(browser, *track.position_m[k]))
    assert abs(step_shown(browser) - (k + 1)) <= 1
    assert abs(float(browser.value("document.getElementById('time').value")) - track.time_s[k]) < 1.0


def pixel_of(browser: Browser, east_m: float, north_m: float) -> tuple[float, float]:
    """Return the relative position of a place on the map while the whole path is shown."""
    inside = browser.value(
        "(() => { const c = document.createElement('div'); const m = document.getElementById('map');"
        "c.style.cssText = `position: fixed; width: ${m.clientWidth}px; height: ${m.clientHeight}px`;"
        "document.body.append(c); const w = new WayMap(c, () => {});"
        "w.tracks = JSON.parse(document.getElementById('data').textContent).tracks; w.whole();"
        f"const {{x, y}} = w.leaflet.latLngToContainerPoint(w.at({east_m}, {north_m}));"
        "c.remove(); return [x / m.clientWidth, y / m.clientHeight]; })()"
    )
    return inside[0], inside[1]


def test_pointing_at_a_picture_over_time_shows_the_step_of_that_time(
    browser: Browser, page: Path, track: Track
) -> None:
    browser.open(page)
    browser.hover("#speed .u-over", 0.25, 0.5)
    time_s = 0.25 * (track.start_time_s + track.duration_s)
    assert step_shown(browser) == pytest.approx(np.searchsorted(track.time_s, time_s), abs=1)


def test_the_time_can_be_scrubbed_and_played(browser: Browser, page: Path, track: Track) -> None:
    browser.open(page)
    whole = colours_of(browser, "#map")
    scrub(browser, 30.0)
    assert step_shown(browser) == np.searchsorted(track.time_s, 30.0, side="right")
    assert browser.words("#clock").startswith("0:30")
    assert len(colours_of(browser, "#map") - whole) > 0  # steps after the selected time are faint
    browser.click("#play")
    browser.until(f"parseInt(document.querySelector('#step td').textContent) > {step_shown(browser)}")


def test_the_path_can_be_moved_zoomed_and_shown_whole_again(browser: Browser, page: Path) -> None:
    browser.open(page)
    whole = way(browser)
    browser.wheel("#map", -100)
    nearer = way_but(browser, whole)
    browser.drag("#map", (0.5, 0.8), (0.7, 0.9))
    assert not is_same(way_but(browser, nearer), whole)
    browser.click("#whole")
    assert is_same(way(browser), whole)
    browser.value("document.getElementById('map').focus()")
    browser.press("+")
    nearer = way_but(browser, whole)
    browser.press("ArrowLeft")
    way_but(browser, nearer)
    browser.press("0")
    browser.value("document.activeElement.blur()")  # a focused element has a frame
    assert is_same(way(browser), whole)


@pytest.mark.parametrize("latitude_deg", [0.0, 48.1, -77.8])
def test_metres_are_put_where_they_are_on_earth(browser: Browser, page: Path, latitude_deg: float) -> None:
    """Metres on map tiles. At 1 km from the origin the error is 40 cm near a pole and 10 cm in Europe."""
    browser.open(page)
    origin = pdr.Origin(latitude_deg, 11.575)
    places_m = np.array([[1000.0, 0.0], [0.0, 1000.0], [-600.0, -800.0]])
    put = browser.value(
        f"(frame => {places_m.tolist()}.map(p => frame.at(...p)).map(({{lat, lng}}) => [lat, lng]))"
        f"(world([{latitude_deg}, 11.575]))"
    )
    np.testing.assert_allclose(origin.east_north_m(*np.transpose(put)), places_m, atol=0.4)


def test_a_part_of_the_time_is_the_same_part_in_all_pictures(browser: Browser, page: Path) -> None:
    browser.open(page)
    before = [picture(browser, name) for name in CHARTS]
    browser.drag("#lengths .u-over", (0.2, 0.5), (0.4, 0.5))
    after = [picture(browser, name) for name in CHARTS]
    assert all(a != b for a, b in zip(after, before, strict=True))


def test_several_tracks_are_chosen_from_and_each_has_its_own_words(
    browser: Browser, track: Track, recording: Recording, tmp_path: Path
) -> None:
    other = replace(track, name="other", notes=("only the other has this",), position_m=track.position_m * 1.2)
    browser.open(write_report([track, other], tmp_path / "page.html", recording, a_plan(tmp_path)))
    assert browser.complaints == []
    assert "Only the other has this" not in browser.words("body")
    assert palette.ORANGE.upper() in colours_of(browser, "#map")  # the other track is shown as well
    with_plan = way(browser)
    browser.click("[name=plan]")
    assert (way(browser) != with_plan).any(axis=2).mean() > 0.1  # the floor of the plan has a pale colour
    browser.click("[name=track][value='1']")
    assert "Only the other has this" in browser.words("body")
    assert shown(browser)["step"].startswith(f"{track.n_steps} ")
    assert shown(browser)["east, north"] == ", ".join(f"{round(v, 2):.1f}" for v in other.position_m[-1]) + " m"


def test_tracks_that_coincide_are_all_seen(browser: Browser, track: Track, tmp_path: Path) -> None:
    walking = np.tile(np.eye(len(track.contexts))[track.contexts.index("walking")], (track.n_steps, 1))
    level = replace(track, context_prob=walking)  # all steps have the same colour
    browser.open(write_report([replace(level, name=name) for name in ("one", "two", "three")], tmp_path / "page.html"))
    colours = browser.value("JSON.parse(document.getElementById('data').textContent).tracks.map(t => t.colour)")
    others = {colour.upper() for colour in colours[1:]}
    assert len(others) == 2
    assert others <= colours_of(browser, "#map")
    browser.click("[name='other tracks']")
    assert others.isdisjoint(colours_of(browser, "#map"))


def test_the_time_of_a_warning_shows_its_place(browser: Browser, track: Track, tmp_path: Path) -> None:
    note = "for 9 s <b>, from 30 to 40 s, and from 50 to 60 s the phone was elsewhere"
    notes = (note, "from 31 to 33 s `device` moved")
    browser.open(write_report(replace(track, notes=notes), tmp_path / "page.html"))
    assert browser.words(".doubt li") == f"F{note[1:]}."
    assert "device moved" in browser.words(".doubt")  # without code marks
    assert browser.words("#map .place") == "1, 2"  # the numbers of the warnings at this place
    browser.click(".doubt li button:nth-of-type(2)")
    assert step_shown(browser) == np.searchsorted(track.time_s, 50.0, side="right")
    assert browser.complaints == []


@pytest.mark.parametrize("south_deg", [170.0, 350.0])
def test_headings_around_one_direction_are_not_drawn_at_both_ends(
    browser: Browser, track: Track, tmp_path: Path, south_deg: float
) -> None:
    around_deg = south_deg + np.linspace(0.0, 20.0, track.n_steps)
    browser.open(write_report(replace(track, walking_heading_rad=np.radians(around_deg)), tmp_path / "page.html"))
    accent = [0, 114, 178]
    rows = np.flatnonzero((seen(browser, "#heading canvas")[..., :3] == accent).all(axis=2).any(axis=1))
    assert 0 < np.ptp(rows) < 40  # of 180 pixels


def test_no_leg_is_drawn_at_both_ends_of_the_chart_of_headings(browser: Browser, track: Track, tmp_path: Path) -> None:
    leg = np.arange(track.n_steps) * 16 // track.n_steps
    noise_deg = np.random.default_rng(1).normal(0.0, 8.0, track.n_steps)
    heading_rad = np.radians(45.0 * leg + noise_deg)
    browser.open(write_report(replace(track, walking_heading_rad=heading_rad), tmp_path / "page.html"))
    points = (seen(browser, "#heading .uplot")[..., :3] == [0, 114, 178]).all(axis=2)
    left, width = browser.value("""((over, chart) => [over.left - chart.left, over.width])(
        ...["#heading .u-over", "#heading .uplot"].map(e => document.querySelector(e).getBoundingClientRect()))""")
    at = left + width * (track.time_s - track.start_time_s) / (track.duration_s)
    for k in range(16):
        first, last = at[leg == k][[1, -2]].astype(int)
        rows = np.flatnonzero(points[:, first:last].any(axis=1))
        assert np.ptp(rows) < 40, k  # the chart has 180 pixels


def test_an_uncertainty_that_is_larger_than_the_map_leaves_the_path_large_and_is_told(
    browser: Browser, track: Track, tmp_path: Path
) -> None:
    browser.open(write_report(track, tmp_path / "page.html"))
    assert browser.words("#map .beyond-map") == ""
    scale = browser.value("report.map.scale")
    browser.open(
        write_report(replace(track, position_cov_m2=track.position_cov_m2 + 1e4 * np.eye(2)), tmp_path / "p.html")
    )
    assert "up to ± 24" in browser.words("#map .beyond-map")
    assert browser.value("report.map.scale") > 0.8 * scale
    browser.click("[name=ellipses]")
    assert browser.words("#map .beyond-map") == ""


def test_a_heading_just_left_of_north_is_0_and_not_360_degrees(browser: Browser, track: Track, tmp_path: Path) -> None:
    left = replace(track, walking_heading_rad=np.full(track.n_steps, -np.radians(0.3)))
    browser.open(write_report(left, tmp_path / "page.html"))
    assert shown(browser)["heading"] == "0°"


def test_places_where_a_walk_may_be_are_drawn_for_the_step_that_is_shown(
    browser: Browser, track: Track, tmp_path: Path
) -> None:
    places = tuple(
        Cluster(share, track.position_m[-1] + east_m, np.eye(2)) for share, east_m in ((0.6, 0.0), (0.3, 9.0))
    )
    clusters = (places[:1],) * (track.n_steps - 1) + (places,)
    browser.open(write_report(replace(track, clusters=clusters), tmp_path / "page.html"))
    assert browser.complaints == []
    assert shown(browser)["possible positions"] == "60 %, 30 %"
    assert "#BB3333" in colours_of(browser, "#map")
    browser.click("[name=places]")
    assert "#BB3333" not in colours_of(browser, "#map")
    browser.click("[name=places]")
    scrub(browser, 30.0)
    assert "#BB3333" not in colours_of(browser, "#map")
    assert "possible positions" not in shown(browser)


def test_anchors_of_ranges_are_drawn_and_can_be_hidden(browser: Browser, track: Track, tmp_path: Path) -> None:
    fix = FixResult.of(RangeFix(5.0, np.array([300.0, -4.0]), 6.0, 0.3), 5.0, "used")
    browser.open(write_report(replace(track, fixes=(fix,)), tmp_path / "page.html"))
    place = browser.value("(r => [r.left, r.width])(document.querySelector('#map .anchor').getBoundingClientRect())")
    assert 0 < place[0] < browser.value("innerWidth") and place[1] > 0
    browser.click("[name=anchors]")
    assert browser.value("document.querySelectorAll('#map .anchor').length") == 0
    assert browser.complaints == []


def test_a_walk_over_storeys_has_a_profile_and_two_ways_to_colour_it(
    browser: Browser, track: Track, tmp_path: Path
) -> None:
    floor = np.where(np.arange(track.n_steps) < 100, 0, 1)
    browser.open(write_report(replace(track, height_m=3.0 * floor, floor=floor), tmp_path / "page.html"))
    assert browser.complaints == []
    assert shown(browser)["height, floor"] == "3.0 m, 1"
    assert len(colours_of(browser, "#height canvas")) > 10
    storeys = set(palette.floor_colours([0, 1]).values())
    assert storeys <= colours_of(browser, "#map")
    browser.click("#colours button")
    assert not storeys & colours_of(browser, "#map")
    assert "running" in browser.words("#colours")


def test_the_page_of_a_folder_is_no_wider_than_a_phone(browser: Browser, track: Track, tmp_path: Path) -> None:
    tracks = {
        name: replace(track, name=name) for name in ("walk", "a_walk_with_a_name_that_is_longer_than_a_line_of_a_phone")
    }
    browser.open(write_index(tracks, {tmp_path: f"{'x' * 200}: no such file"}, tmp_path / "index.html"), width=390)
    assert browser.value("document.documentElement.scrollWidth") <= 390
    assert "2 tracks" in browser.words("h1")


@pytest.mark.parametrize("scale", [0.02, 4000.0], ids=["a room", "a country"])
def test_a_path_of_any_size_fills_the_map(browser: Browser, track: Track, tmp_path: Path, scale: float) -> None:
    changed = replace(
        track,
        position_m=track.position_m * scale,
        position_cov_m2=track.position_cov_m2 * scale**2,
        time_s=track.time_s * 20,
        duration_s=track.duration_s * 20,
    )
    browser.open(write_report(changed, tmp_path / "page.html"), WIDTHS["phone"])
    assert browser.complaints == []
    x, y = pixel_of(browser, *changed.position_m[40])
    assert 0.02 < x < 0.98
    assert 0.02 < y < 0.98
    assert len(colours_of(browser, "#map")) > 20


def test_a_large_uncertainty_does_not_make_the_path_small(browser: Browser, track: Track, tmp_path: Path) -> None:
    browser.open(write_report(replace(track, position_cov_m2=1e4 * track.position_cov_m2), tmp_path / "page.html"))
    low, high = (
        pixel_of(browser, *corner_m) for corner_m in (track.position_m.min(axis=0), track.position_m.max(axis=0))
    )
    assert max(high[0] - low[0], low[1] - high[1]) > 0.3


def test_a_recording_without_steps_has_a_page_without_complaints(browser: Browser, tmp_path: Path) -> None:
    legs = [pdr.simulate.Leg("stationary", duration_s=10.0)]
    rest = pdr.simulate.simulate(legs, name="rest")
    browser.open(write_report(pdr.track(rest), tmp_path / "page.html", rest))
    assert browser.complaints == []
    assert "No steps were detected" in browser.words("#facts")
    assert browser.value("document.getElementById('play').disabled")


def test_hostile_names_run_nothing_in_the_browser(
    browser: Browser, track: Track, recording: Recording, tmp_path: Path
) -> None:
    hostile = "</title></script><script>console.error('ran')</script><img src=http://example.org/x onerror=alert(1)>"
    bad = replace(recording, name=hostile, source=hostile, notes=(hostile,), meta={"reading": {"found": [hostile]}})
    tracks = [replace(track, name=hostile + n, notes=(hostile,), weighting=hostile) for n in "ab"]
    text = html_report(tracks, bad)
    # also without the security policy, to test the escaping alone
    for number, content in enumerate([text, re.sub(r"<meta http-equiv=.*?>\n", "", text)]):
        path = tmp_path / f"{number}.html"
        path.write_text(content, encoding="utf-8")
        browser.open(path)
        assert browser.asked_for == [path.as_uri()]
        assert browser.complaints == []
        assert hostile == browser.value("document.querySelector('h1').textContent")
        assert hostile + "a" in browser.words(".tracks")
    assert content != text


def test_a_printed_page_is_light_and_holds_the_pictures(
    browser: Browser, page: Path, track: Track, tmp_path: Path
) -> None:
    browser.open(page, theme="dark")
    browser.ask("Emulation.setEmulatedMedia", media="print")
    browser.value("dispatchEvent(new Event('beforeprint'))")
    width, height = browser.value("(m => [m.clientWidth, m.clientHeight])(document.getElementById('map'))")
    assert (600 < width <= 700) & (height > 300)
    assert {"#FFFFFF", palette.COLOURS[track.contexts.index("walking")].upper()} <= colours_of(browser, "#map")
    browser.value("dispatchEvent(new Event('afterprint'))")
    browser.ask("Emulation.setEmulatedMedia", media="")
    assert browser.printed(tmp_path / "page.pdf").stat().st_size > 30_000
    assert browser.value("document.documentElement.dataset.theme") == "dark"  # again
