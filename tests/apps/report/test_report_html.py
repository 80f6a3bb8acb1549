"""HTML report: complete, self-contained, and safe for any contents of a recording."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import a_plan, windows_of
from made_tracks import make_track
from shapely import LinearRing
from true_positions import located, true_m

import pdr_filter as pdr
from pdr_filter.apps.report import html, palette
from pdr_filter.apps.report.geometry import band_rings
from pdr_filter.apps.report.html import html_report, write_report
from pdr_filter.apps.report.page_data import _windows, track_data
from pdr_filter.data.io.describe import reading_report
from pdr_filter.tracking import trust_report as trust
from pdr_filter.tracking.track import Track
from pdr_filter.values import CONTEXTS, RADIUS_95, Fix, FixOutcome, FixResult, FloorPassage, PositionFix, RangeFix
from pdr_filter.values.recording import Recording

HOSTILE = '<script>alert(\'x\')</script>"><img src=x onerror="alert(1)">&amp;\x00\x1b\u202e\udc80 ]]>'

ASSETS = Path(html.__file__).parent / "assets"


@pytest.fixture(scope="module")
def page(track: Track, recording: Recording) -> str:
    return html_report(track, recording)


class Seen(HTMLParser):
    """HTML parser that collects titles, scripts and the visible text."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.words, self.titles, self.scripts = "", [], []
        self._inside = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._inside = tag
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts.append(data)
        elif self._inside != "style":
            self.words += data
        if self._inside in ("title", "h2"):
            self.titles.append(data)


def given(page: str) -> list[dict[str, Any]]:
    """Return the data of each track in a page."""
    return json.loads(Seen(page).scripts[0])["tracks"]


# --- complete --------------------------------------------------------------------------------------------------------


def test_the_page_has_every_part(page: str) -> None:
    charts = ["Contexts over time", "Walking speed (m/s)", "Step lengths (m)", "Heading"]
    assert Seen(page).titles[1:] == ["Warnings", "Selected step", "Height (m)", *charts, "Input data"]


def test_every_step_is_given_with_its_numbers(page: str, track: Track) -> None:
    (seen,) = given(page)
    assert seen["number"] == list(range(1, track.n_steps + 1))
    assert seen["start"] == [0.0, 0.0]
    for name, values, digits in (
        ("time", track.time_s, 2),
        ("east", track.position_m[:, 0], 2),
        ("north", track.position_m[:, 1], 2),
        ("length", track.step_length_m, 3),
        ("heading", np.degrees(track.walking_heading_rad) % 360, 1),
        ("speed", track.smoothed_speed_mps, 2),
        ("speed_std", track.smoothed_speed_std_mps, 3),
        ("walked", track.walked_m, 1),
        ("std", track.position_std_m, 1),
        ("major", RADIUS_95 * track.position_std_m, 2),
    ):
        np.testing.assert_allclose(seen[name], values, atol=0.51 * 10**-digits, err_msg=name)
        np.testing.assert_array_equal(seen[name], np.round(seen[name], digits), err_msg=name)
    np.testing.assert_allclose(np.transpose(seen["prob"]), 100 * track.context_prob, atol=0.51)
    assert "height" not in seen
    group = seen["groups"]["contexts"]
    assert [group["names"][i] for i in group["group"]] == [CONTEXTS[i] for i in track.context_prob.argmax(axis=1)]
    assert group["colours"] == list(palette.COLOURS)


def test_a_walk_over_storeys_is_given_with_heights_and_their_colours(track: Track) -> None:
    floor = np.where(np.arange(track.n_steps) < 100, 0, -1)
    change = FloorPassage(60.0, 70.0, 0, -1, "lift")
    page = html_report(replace(track, height_m=3.0 * floor, floor=floor, floor_passages=(change,)))
    assert "60 to 70 s: from floor 0 to floor -1, by lift" in Seen(page).words
    (seen,) = given(page)
    assert seen["height"] == (3.0 * floor).tolist()
    floors = seen["groups"]["floors"]
    assert [floors["names"][i] for i in floors["group"]] == [f"floor {i}" for i in floor]
    assert floors["colours"] == list(palette.floor_colours([0, -1]).values())


def test_ellipses_have_the_axes_and_the_direction_of_the_covariance(track: Track) -> None:
    # 30 degrees from east towards north; deviations of 4 m along and 1 m across.
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov_m2 = np.tile(turn @ np.diag([16.0, 1.0]) @ turn.T, (track.n_steps, 1, 1))
    (seen,) = given(html_report(replace(track, position_cov_m2=cov_m2)))
    assert seen["major"] == pytest.approx([4 * 2.4477] * track.n_steps, abs=0.01)
    assert seen["minor"] == pytest.approx([1 * 2.4477] * track.n_steps, abs=0.01)
    assert np.degrees(seen["angle"]) % 180 == pytest.approx(np.full(track.n_steps, 30.0), abs=0.1)
    assert seen["ellipses"] == [track.n_steps - 1]
    assert seen["band"] == list(range(track.n_steps))


def test_ellipses_are_drawn_at_used_fixes(track: Track) -> None:
    fixes: list[tuple[float, FixOutcome]] = [(9.0, "used"), (20.0, "rejected"), (50.0, "used")]
    at = tuple(FixResult.of(RangeFix(t, np.zeros(2), 6.0, 0.3), t, outcome) for t, outcome in fixes)
    (seen,) = given(html_report(replace(track, fixes=at)))
    assert [seen["time"][k] for k in seen["ellipses"][:-1]] == pytest.approx([9.0, 50.0], abs=1.0)
    assert len(seen["ellipses"]) == 3


def test_contexts_fill_their_share_of_the_time(page: str, track: Track) -> None:
    windows = given(page)[0]["windows"]
    *prob, without_steps = windows["prob"]
    area = (np.array(windows["end"]) - windows["start"]) @ np.transpose(prob)
    starts = np.concatenate([[track.start_time_s], track.windows.time_s[:-1]])
    seconds = np.minimum(track.windows.time_s - starts, 2.0) @ track.windows.context_prob
    assert area / area.sum() == pytest.approx(seconds / seconds.sum(), abs=0.01)
    assert not any(without_steps)


def test_motion_without_steps_is_drawn_as_in_the_legend_and_not_as_walking() -> None:
    ride = replace(make_track(0, 30), windows=windows_of(np.arange(1.0, 31.0), np.tile(np.eye(6)[1], (30, 1))))
    page = html_report(ride)
    assert "walking 0 s" not in Seen(page).words
    assert f"moving without steps {ride.seconds_without_steps:.0f} s (100 %)" in Seen(page).words
    *prob, without_steps = given(page)[0]["windows"]["prob"]
    assert set(without_steps) == {100}
    assert not np.any(prob)


def test_the_end_is_counted_from_the_start_of_the_walk(track: Track) -> None:
    shift_m = np.array([300.0, -40.0])
    moved = replace(track, position_m=track.position_m + shift_m, start_position_m=track.start_position_m + shift_m)
    assert trust.end(moved) == trust.end(track)
    assert trust.end(track).startswith(f"{np.linalg.norm(track.position_m[-1]):.1f} m from the start (")
    west_m = replace(track, position_m=np.tile([-3.04, -1.0], (track.n_steps, 1)))
    assert "3.2 m from the start (3.0 m west, 1.0 m south)" in html_report(west_m)


def test_the_truth_is_aligned_with_the_track_and_each_step_has_its_error(track: Track, recording: Recording) -> None:
    """A correct track has no error for any frame of the truth."""
    turned_m = true_m(recording, track.time_s) @ [[0.0, 1.0], [-1.0, 0.0]] + [5.0, 7.0]
    right = replace(track, position_m=turned_m, start_position_m=np.array([5.0, 7.0]))
    (seen,) = given(html_report(right, recording))
    assert not seen["truth"]["points"]
    # The way between two contacts is not straight and not even.
    assert max(seen["from_truth"]) < 0.3
    wrong_m = turned_m.copy()
    wrong_m[-1] += 10.0
    assert given(html_report(replace(right, position_m=wrong_m), recording))[0]["from_truth"][-1] > 10.0


def test_locations_are_given_in_the_frame_of_a_track_that_knows_north(track: Track, recording: Recording) -> None:
    here = pdr.Origin(48.137, 11.575, turn_rad=0.0)
    latitude_deg, longitude_deg = here.latitude_longitude_deg(track.position_m[:3])
    values = np.column_stack([latitude_deg, longitude_deg, np.zeros(3), [4.0, 5.0, 6.0]])
    located = replace(recording, location=pdr.Samples(np.arange(3.0), values))
    (seen,) = given(html_report(track.placed(here), located))
    np.testing.assert_allclose(seen["gps"]["east"], track.position_m[:3, 0], atol=0.02)
    assert seen["gps"]["accuracy"] == [4.0, 5.0, 6.0]
    assert "gps" not in given(html_report(track, located))[0]


def test_several_tracks_are_told_apart_by_name_weighting_or_number(track: Track) -> None:
    other = replace(track, weighting="hc")
    words = Seen(html_report([track, other])).words
    assert words.strip().startswith("2 tracks")
    assert f"{track.name}, imm" in words
    assert f"{track.name}, hc" in words
    assert f"2: {track.name}, imm" in Seen(html_report([track, track])).words


def test_a_floor_plan_is_given_as_shapes_those_below_first(track: Track, tmp_path: Path) -> None:
    plan = a_plan(tmp_path)
    for page in (html_report(track, plan=plan), html_report(replace(track, plan=plan))):
        floor, room, wall = given(page)[0]["plan"]
        assert [len(floor["rings"]), floor["fill"]] == [1, palette.PLAN_COLOURS["floor"]]
        np.testing.assert_allclose(np.ptp(floor["rings"][0], axis=0), [60.0, 60.0])
        assert room["fill"] == palette.PLAN_COLOURS["room"]
        assert (wall["fill"], wall["edge"]) == (None, palette.WALL)
    assert given(html_report(track))[0]["plan"] == []


def test_all_warnings_and_notes_are_on_the_page(recording: Recording) -> None:
    blind = replace(recording, gyroscope=None, notes=("the clock was set back once",))
    track = pdr.track(blind)
    words = Seen(html_report(track, blind)).words
    doubts = trust.doubts(track)
    assert doubts
    assert all(doubt in words for doubt in doubts)
    assert "The clock was set back once." in words
    assert words.count("lock was set back once") == 1
    assert "None." not in words


def test_the_reading_report_is_all_there(page: str, recording: Recording) -> None:
    words = Seen(page).words
    report = reading_report(recording)
    assert report.source in words
    assert report.clock in words
    assert all(found in words for found in report.found)
    for stream in report.streams:
        assert stream.sentence() in words
    assert "Input data" not in Seen(html_report(pdr.track(recording))).words


# --- self-contained and safe -----------------------------------------------------------------------------------------


def assert_self_contained(page: str) -> None:
    seen = Seen(page)
    assert not {"link", "iframe", "object", "embed", "img", "image", "use", "base", "form", "svg"} & set(seen.tags)
    assert not [a for a in seen.attributes if a[1] in ("src", "href", "xlink:href", "srcset", "action", "data")]
    assert not [a for a in seen.attributes if a[1].startswith("on")]
    style = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    assert not re.search(r"url\(|@import", "".join(style))
    (policy,) = [v for tag, name, v in seen.attributes if (tag, name) == ("meta", "content") and "src" in v]
    rules = dict(rule.split(maxsplit=1) for rule in policy.split("; "))
    assert rules.keys() == {"default-src", "style-src", "script-src"}
    assert rules["default-src"] == "'none'"
    # scripts are allowed only by their checksums
    assert re.fullmatch(r"('sha256-[\w+/=]{44}' ?)+", rules["script-src"])


def test_the_page_loads_nothing_and_names_no_address(page: str) -> None:
    assert_self_contained(page)
    own = page
    for library in ASSETS.glob("*.[cj]s*"):  # libraries name their authors and the name space of SVG
        own = own.replace(library.read_text(encoding="utf-8"), "")
    assert not re.search(r"https?://|javascript:|data:[a-z]+/", own)


def test_libraries_are_those_of_npm_and_come_with_their_licences(page: str) -> None:
    libraries = json.loads((ASSETS / "libraries.json").read_text())
    named = {name for library in libraries for name in library["files"]}
    assert named == {path.name for path in ASSETS.iterdir()} - {"libraries.json"}
    for library in libraries:
        for name, of in library["files"].items():
            content = (ASSETS / name).read_bytes()
            assert hashlib.sha256(content).hexdigest() == of["sha256"], name
            if name.startswith("geoman"):  # of the editor of floor plans; reports do not have it
                assert content.decode() not in page
                continue
            assert name.endswith(".css") or content.decode() in page, name
            assert not name.endswith(".js") or library["version"] in content.decode()[:200]


def test_hostile_names_and_notes_are_only_text(track: Track, recording: Recording, tmp_path: Path) -> None:
    meta = {"reading": {"source": HOSTILE, "found": [HOSTILE], "clock": HOSTILE}}
    bad_track = replace(track, name=HOSTILE, notes=(HOSTILE,), weighting=HOSTILE)
    bad_recording = replace(recording, name=HOSTILE, source=HOSTILE, notes=(HOSTILE + "2",), meta=meta)
    page = html_report([bad_track, bad_track], bad_recording)
    assert_self_contained(page)
    kinds = set(Seen(html_report([track, track], recording)).tags)
    assert set(Seen(page).tags) - {"ol"} == kinds  # the list of warnings
    assert Seen(page).titles[0] == HOSTILE.translate(dict.fromkeys([0, 0x1B, 0x202E, 0xDC80], "�"))
    path = write_report([bad_track, bad_track], tmp_path / "deep" / "page.html", bad_recording)
    assert path.read_text(encoding="utf-8") == page


def test_a_recording_without_steps_has_a_page(recording: Recording) -> None:
    still = recording.accelerometer.time_s < 4.0
    cut = pdr.Samples(recording.accelerometer.time_s[still], recording.accelerometer.values[still])
    short = Recording("rest", accelerometer=cut)
    page = html_report(pdr.track(short), short)
    assert_self_contained(page)
    words = Seen(page).words
    assert "0 steps" in words
    assert "No steps were detected" in words
    assert given(page)[0]["time"] == []


def test_a_single_step_has_a_page() -> None:
    page = html_report(make_track(1, 1))
    assert "1 step " in Seen(page).words
    assert len(given(page)[0]["time"]) == 1


def test_the_page_states_the_frame_and_the_uncertainty_of_the_end(track: Track) -> None:
    placed = track.placed((48.137, 11.575))
    words = Seen(html_report(placed)).words
    assert placed.about_frame in words
    assert placed.how_sure in words


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_non_finite_numbers_are_omitted(track: Track, value: float) -> None:
    position_m, cov_m2, speed = track.position_m.copy(), track.position_cov_m2.copy(), track.smoothed_speed_mps.copy()
    position_m[50:60], cov_m2[-1], speed[10] = value, value, np.nan
    page = html_report(replace(track, position_m=position_m, position_cov_m2=cov_m2, smoothed_speed_mps=speed))
    (seen,) = given(page)
    assert seen["number"] == [*range(1, 51), *range(61, track.n_steps + 1)]
    assert seen["speed"][10] is None
    assert seen["major"][-1] is None
    assert seen["ellipses"] == []
    assert seen["band"][-1] == len(seen["number"]) - 2
    assert not re.search(r"\bNaN\b|Infinity|e\+\d", Seen(page).scripts[0])


def test_a_page_says_how_locations_became_fixes() -> None:
    walk = pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=30.0)])
    recording = located(walk, np.arange(0.0, walk.duration_s))
    page = html_report(pdr.track(recording), recording)
    assert f"The recording has {len(recording.location)} locations." in Seen(page).words
    assert "takes one in 10 s as a fix" in Seen(page).words
    assert "locations" not in Seen(html_report(pdr.track(recording, gnss="off"), recording)).words


def test_anchors_of_used_ranges_are_given(track: Track) -> None:
    fix = FixResult.of(RangeFix(5.0, np.array([3.25, -4.0, 2.0]), 6.0, 0.3), 5.0, "used")
    assert given(html_report(replace(track, fixes=(fix,))))[0]["anchors"] == {"east": [3.25], "north": [-4.0]}
    assert "anchors" not in given(html_report(replace(track, fixes=(replace(fix, outcome="waiting"),))))[0]


def test_fixes_that_were_not_used_are_told(recording: Recording) -> None:
    fixes: list[Fix] = [
        PositionFix(t, np.array([e, n]), np.eye(2)) for t, e, n in [(20.0, 0.0, 22.0), (60.0, 9e3, 9e3)]
    ]
    track = pdr.track(recording, fixes=fixes)
    words = Seen(html_report(track)).words
    assert "of 2 fixes used" in words
    assert any("do not fit the track" in doubt for doubt in trust.doubts(track))


def test_a_day_of_walking_is_a_page_of_less_than_one_and_a_half_megabytes() -> None:
    """The page opens fast, because rows beyond the resolution of a screen are omitted."""
    n = 100_000
    way_m = np.random.default_rng(0).normal(size=(n, 2)).cumsum(axis=0)
    day = replace(make_track(n, n // 2), position_m=way_m, walking_heading_rad=np.arctan2(*way_m.T))
    start_s = time.process_time()
    page = html_report(day)
    assert time.process_time() - start_s < 5.0
    assert len(page) < 1.5e6
    assert given(page)[0]["number"][-1] == day.n_steps


def test_drawing_needs_no_matplotlib() -> None:
    code = "import sys, pdr_filter.apps.report.html; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("nowhere", [np.nan, np.inf, 1e9])
def test_a_step_that_is_nowhere_on_earth_does_not_make_a_dot_of_the_others(track: Track, nowhere: float) -> None:
    position_m = track.position_m.copy()
    position_m[3] = nowhere
    data = track_data(replace(track, position_m=position_m), None, None, 1)
    assert data["number"] == [k for k in range(1, track.n_steps + 1) if k != 4]
    assert max(map(abs, data["east"])) < 1e3


def test_many_windows_are_averaged_in_groups_of_equal_duration(track: Track) -> None:
    windows = windows_of(np.arange(2.0, 202.0), np.tile(np.eye(len(CONTEXTS))[0], (200, 1)))
    long = replace(track, windows=windows, start_time_s=0.0, duration_s=200.0)
    shown = _windows(long, 20)
    assert 20 <= len(shown["start"]) <= 21
    assert all(9.0 <= end - start <= 12.0 for start, end in list(zip(shown["start"], shown["end"], strict=True))[1:-1])


def test_a_named_tile_server_is_the_only_one_that_the_page_may_ask(track: Track) -> None:
    placed, address = (
        track.placed(pdr.Origin(48.137, 11.575, turn_rad=0.0)),
        "https://{s}.tiles.example.org/{z}/{x}/{y}.png",
    )
    page = html_report(placed, tiles=address)
    assert "img-src data: https://*.tiles.example.org;" in page
    assert "this server learns where the walk was" in Seen(page).words
    assert json.loads(Seen(page).scripts[0])["origin"] == [48.137, 11.575]
    assert_self_contained(without := html_report(placed))
    assert "loads nothing from the network" in Seen(without).words
    assert "--tiles" not in Seen(html_report(track)).words  # a walk without a place on Earth
    with pytest.raises(ValueError, match=r"tiles must be a URL with \{z\}"):
        html_report(placed, tiles="https://example.org")


def test_no_ring_of_the_band_crosses_itself_which_would_be_a_hole_in_the_band(track: Track) -> None:
    turn_rad = np.random.default_rng(1).uniform(-np.pi, np.pi, track.n_steps)
    along, across = np.array([np.cos(turn_rad), np.sin(turn_rad)]).T, np.array([-np.sin(turn_rad), np.cos(turn_rad)]).T
    cov_m2 = 9.0 * along[:, :, np.newaxis] * along[:, np.newaxis] + across[:, :, np.newaxis] * across[:, np.newaxis]
    rings = [LinearRing(ring) for ring in band_rings(track.position_m, cov_m2)]
    assert [k for k, ring in enumerate(rings) if not (ring.is_simple and ring.is_ccw)] == []


def test_the_file_is_named_if_the_title_does_not_name_it(track: Track, recording: Recording) -> None:
    named = replace(recording, name="walk", source="folder/walk.zip")
    assert "File: walk.zip" not in html_report(track, named).partition("Input data")[0]
    assert "File: <bdi>other.zip</bdi>" in html_report(track, replace(named, source="folder/other.zip"))
