"""The HTML page of a track: complete, self-contained, and safe whatever is in a recording."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

import pdr_filter as pdr
from pdr_filter.io.describe import reading_report
from pdr_filter.io.recording import Recording
from pdr_filter.report import palette, trust
from pdr_filter.report.html import html_report, write_report
from pdr_filter.tracks import Track
from pdr_filter.values import CONTEXTS, Fix, FloorPassage, PositionFix

HOSTILE = '<script>alert(\'x\')</script>"><img src=x onerror="alert(1)">&amp;\x00\x1b\u202e\udc80 ]]>'


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
def page(track: Track, recording: Recording) -> str:
    return html_report(track, recording)


class Seen(HTMLParser):
    """What an HTML parser finds, with the text as a reader sees it."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.words = ""
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        self.words += data


def tree(page: str) -> ET.Element:
    """The page as XML: every tag closed, every text escaped."""
    return ET.fromstring(page.removeprefix("<!DOCTYPE html>\n"))


def pictures(page: str) -> list[ET.Element]:
    return list(tree(page).iter("svg"))


def points(shape: ET.Element) -> np.ndarray:
    return np.array([[float(v) for v in pair.split(",")] for pair in shape.attrib["points"].split()])


def ellipse_place(shape: ET.Element) -> tuple[float, float, float]:
    found = re.fullmatch(r"translate\((\S+) (\S+)\) rotate\((\S+)\)", shape.attrib["transform"])
    assert found is not None
    x, y, angle = (float(v) for v in found.groups())
    return x, y, angle


# --- complete --------------------------------------------------------------------------------------------------------


def test_the_page_has_every_part_and_is_well_formed(page: str) -> None:
    titles = [h.text for h in tree(page).iter("h2")]
    assert titles == [
        "Where not to trust it",
        "Way",
        "Contexts over time",
        "Walking speed",
        "Step lengths",
        "How it was read",
    ]
    assert len(pictures(page)) == 4


def test_the_way_is_drawn_to_scale_with_north_up(page: str, track: Track) -> None:
    line = points(next(pictures(page)[0].iter("polyline")))
    way_m = np.vstack([np.zeros((1, 2)), track.position_m])
    assert len(line) == len(way_m)
    # x = a + s east, y = b - s north with one s: solved for here, whatever the margins are.
    matrix = np.vstack(
        [
            np.column_stack([np.ones(len(way_m)), np.zeros(len(way_m)), way_m[:, 0]]),
            np.column_stack([np.zeros(len(way_m)), np.ones(len(way_m)), -way_m[:, 1]]),
        ]
    )
    (_, _, scale), *_ = np.linalg.lstsq(matrix, line.T.ravel(), rcond=None)
    residual = matrix @ np.linalg.lstsq(matrix, line.T.ravel(), rcond=None)[0] - line.T.ravel()
    assert scale > 0
    assert np.abs(residual).max() < 0.1  # coordinates have one decimal


def test_every_step_has_the_colour_of_its_context(page: str, track: Track) -> None:
    dark, *coloured = pictures(page)[0].iter("polyline")
    assert dark.attrib["stroke"] == palette.INK
    drawn = [(len(points(line)) - 1, line.attrib["stroke"]) for line in coloured]
    colours = [colour for n, colour in drawn for _ in range(n)]
    assert colours == [palette.COLOURS[i] for i in track.context_prob.argmax(axis=1)]


def test_a_walk_over_storeys_has_a_profile_and_their_colours(track: Track) -> None:
    floor = np.where(np.arange(track.n_steps) < 100, 0, -1)
    change = FloorPassage(60.0, 70.0, 0, -1, "lift")
    page = html_report(replace(track, height_m=3.0 * floor, floor=floor, floor_passages=(change,)))
    assert [h.text for h in tree(page).iter("h2")][1:4] == ["Way", "Height", "Contexts over time"]
    assert "60 to 70 s: from floor 0 to floor -1, by lift" in Seen(page).words
    colours = palette.floor_colours([0, -1])
    for picture, n_lines in ((pictures(page)[0], 3), (pictures(page)[1], 2)):
        lines = list(picture.iter("polyline"))
        assert len(lines) == n_lines
        assert [line.attrib["stroke"] for line in lines[-2:]] == [colours[0], colours[-1]]
    profile = np.vstack([points(line) for line in pictures(page)[1].iter("polyline")])
    assert profile[0, 1] < profile[-1, 1]  # pixels grow downwards


def test_ellipses_have_the_axes_and_the_direction_of_the_covariance(track: Track) -> None:
    # 30 degrees from east towards north; deviations of 4 m along and 1 m across.
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    cov_m2 = np.tile(turn @ np.diag([16.0, 1.0]) @ turn.T, (track.n_steps, 1, 1))
    picture = pictures(html_report(replace(track, position_cov_m2=cov_m2)))[0]
    ellipses = list(picture.iter("ellipse"))
    line = points(next(picture.iter("polyline")))
    way_m = np.vstack([np.zeros((1, 2)), track.position_m])
    pixels_per_m = np.ptp(line[:, 0]) / np.ptp(way_m[:, 0])
    assert 4 <= len(ellipses) <= 9
    for ellipse in ellipses:
        x, y, turned_deg = ellipse_place(ellipse)
        assert float(ellipse.attrib["rx"]) == pytest.approx(4 * 2.4477 * pixels_per_m, rel=0.01)
        assert float(ellipse.attrib["ry"]) == pytest.approx(1 * 2.4477 * pixels_per_m, rel=0.01)
        assert turned_deg % 180 == pytest.approx(150.0, abs=0.1)  # SVG turns clockwise: y grows downwards
        assert np.hypot(*(line - [x, y]).T).min() < 0.2
    assert ellipse_place(ellipses[-1])[:2] == pytest.approx(tuple(line[-1]), abs=0.11)


def test_everything_drawn_is_inside_its_picture(page: str) -> None:
    for picture in pictures(page):
        width, height = (float(v) for v in picture.attrib["viewBox"].split()[2:])
        for shape in [*picture.iter("polyline"), *picture.iter("polygon")]:
            inside = points(shape)
            assert (inside >= 0).all()
            assert (inside <= [width, height]).all()
        for ellipse in picture.iter("ellipse"):
            x, y, _ = ellipse_place(ellipse)
            assert 0 < x < width
            assert 0 < y < height
        for rect in picture.iter("rect"):
            assert 0 <= float(rect.attrib["y"]) <= float(rect.attrib["y"]) + float(rect.attrib["height"]) <= height


def test_contexts_fill_their_share_of_the_picture(page: str, track: Track) -> None:
    """Area of each colour: probability over time, by the shoelace formula of rectangles."""
    picture = pictures(page)[1]
    area = dict.fromkeys(CONTEXTS, 0.0)
    for path in picture.iter("path"):
        title = path.findtext("title")
        if title in area:
            boxes = re.findall(r"M(\S+?) (\S+?)H(\S+?)V(\S+?)H", path.attrib["d"])
            area[title] = sum((float(c) - float(a)) * (float(b) - float(d)) for a, b, c, d in boxes)
    starts = np.concatenate([[track.start_time_s], track.windows.time_s[:-1]])
    seconds = np.minimum(track.windows.time_s - starts, 2.0) @ track.windows.context_prob
    share = np.array([area[name] for name in CONTEXTS]) / sum(area.values())
    assert share == pytest.approx(seconds / seconds.sum(), abs=0.01)


def test_speed_is_broken_between_bouts_and_its_band_is_about_it(track: Track) -> None:
    gap = np.where(np.arange(track.n_steps) < 100, 0.0, 60.0)
    even_s = 0.5 * np.arange(1, track.n_steps + 1) + gap
    changed = replace(track, time_s=even_s, duration_s=even_s[-1])
    picture = pictures(html_report(changed))[2]
    lines, bands = list(picture.iter("polyline")), list(picture.iter("polygon"))
    assert [len(points(line)) for line in lines] == [100, track.n_steps - 100]
    for line, band in zip(lines, bands, strict=True):
        middle, edge = points(line), points(band)
        low, high = edge[: len(middle)], edge[len(middle) :][::-1]
        assert (high[:, 1] <= middle[:, 1]).all()
        assert (low[:, 1] >= middle[:, 1]).all()
        assert (high[:, 1] < low[:, 1]).all()


def test_the_bars_of_the_step_lengths_count_every_step(page: str, track: Track) -> None:
    titles = [rect.findtext("title") or "" for rect in pictures(page)[3].iter("rect")]
    counted = [int(t.split()[0]) for t in titles]
    edges = [tuple(float(v) for v in re.findall(r"\d+\.\d+", t)) for t in titles]
    assert sum(counted) == track.n_steps
    for n, (low, high) in zip(counted, edges, strict=True):
        assert n == ((track.step_length_m >= low) & (track.step_length_m < high)).sum()


def test_doubts_and_notes_are_all_there(recording: Recording) -> None:
    blind = replace(recording, gyroscope=None, notes=("the clock was set back once",))
    track = pdr.track(blind)
    words = Seen(html_report(track, blind)).words
    doubts = trust.doubts(track)
    assert doubts
    assert all(doubt in words for doubt in doubts)
    assert "The clock was set back once." in words
    assert words.count("lock was set back once") == 1
    assert "Nothing odd" not in words


def test_the_reading_report_is_all_there(page: str, recording: Recording) -> None:
    words = Seen(page).words
    report = reading_report(recording)
    assert report.source in words
    assert report.clock in words
    assert all(found in words for found in report.found)
    for stream in report.streams:
        assert stream.name in words
        assert f"{stream.n_samples:,}" in words
    assert "How it was read" not in Seen(html_report(pdr.track(recording))).words


# --- self-contained and safe -----------------------------------------------------------------------------------------


def assert_self_contained(page: str) -> None:
    seen = Seen(page)
    assert not {"script", "link", "iframe", "object", "embed", "img", "image", "use", "base", "form"} & set(seen.tags)
    assert not [a for a in seen.attributes if a[1] in ("src", "href", "xlink:href", "srcset", "action", "data")]
    assert not [a for a in seen.attributes if a[1].startswith("on")]
    style = re.findall(r"<style>(.*?)</style>", page, re.DOTALL)
    assert not re.search(r"url\(|@import", "".join(style))
    policy = [value for tag, name, value in seen.attributes if (tag, name) == ("meta", "content")]
    assert any("default-src 'none'" in value for value in policy)


def test_the_page_loads_nothing_and_names_no_address(page: str) -> None:
    assert_self_contained(page)
    assert not re.search(r"https?:|//\w|javascript:|data:", page)


def test_hostile_names_and_notes_are_only_text(track: Track, recording: Recording, tmp_path: Path) -> None:
    meta = {"reading": {"source": HOSTILE, "found": [HOSTILE], "clock": HOSTILE}}
    bad_track = replace(track, name=HOSTILE, notes=(HOSTILE,), weighting=HOSTILE)
    bad_recording = replace(recording, name=HOSTILE, source=HOSTILE, notes=(HOSTILE + "2",), meta=meta)
    page = html_report(bad_track, bad_recording)
    assert_self_contained(page)
    kinds = set(Seen(html_report(track, recording)).tags)
    assert set(Seen(page).tags) == kinds
    assert tree(page).findtext("head/title") == HOSTILE.translate(dict.fromkeys([0, 0x1B, 0x202E, 0xDC80], "�"))
    path = write_report(bad_track, tmp_path / "deep" / "page.html", bad_recording)
    assert path.read_text(encoding="utf-8") == page


def test_a_recording_without_steps_has_a_page(recording: Recording) -> None:
    still = recording.accelerometer.time_s < 4.0
    cut = pdr.Samples(recording.accelerometer.time_s[still], recording.accelerometer.values[still])
    short = Recording("rest", accelerometer=cut)
    page = html_report(pdr.track(short), short)
    assert_self_contained(page)
    words = Seen(page).words
    assert "0 steps" in words
    assert "nothing to draw" in words
    tree(page)


def test_a_single_step_has_a_page(track: Track) -> None:
    per_step = ("time_s", "position_m", "position_cov_m2", "step_length_m", "walking_heading_rad", "step_speed_mps")
    per_step += (
        "step_speed_std_mps",
        "smoothed_speed_mps",
        "smoothed_speed_std_mps",
        "context_prob",
        "mode_prob",
        "steps",
    )
    one = replace(track, **{name: getattr(track, name)[:1] for name in per_step})
    page = html_report(one)
    assert "1 step " in Seen(page).words
    assert len(pictures(page)) == 4


def test_the_page_says_in_which_frame_the_way_is_drawn_and_how_sure_its_end_is(track: Track) -> None:
    placed = track.placed((48.137, 11.575))
    words = Seen(html_report(placed)).words
    assert placed.about_frame in words
    assert placed.how_sure in words


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_numbers_that_mean_nothing_are_left_out(track: Track, value: float) -> None:
    position_m, cov_m2, speed = track.position_m.copy(), track.position_cov_m2.copy(), track.smoothed_speed_mps.copy()
    position_m[50:60], cov_m2[-1], speed[10] = value, value, np.nan
    page = html_report(replace(track, position_m=position_m, position_cov_m2=cov_m2, smoothed_speed_mps=speed))
    drawn = "".join(ET.tostring(picture, encoding="unicode") for picture in pictures(page))
    assert not re.search(r"\bnan\b|\binf\b|e\+\d", drawn)
    assert len(points(next(pictures(page)[0].iter("polyline")))) == track.n_steps + 1 - 10


def test_fixes_that_were_not_used_are_told(recording: Recording) -> None:
    fixes: list[Fix] = [
        PositionFix(t, np.array([e, n]), np.eye(2)) for t, e, n in [(20.0, 0.0, 22.0), (60.0, 9e3, 9e3)]
    ]
    track = pdr.track(recording, fixes=fixes)
    words = Seen(html_report(track)).words
    assert "of 2 fixes used" in words
    assert any("do not fit the track" in doubt for doubt in trust.doubts(track))


def test_a_day_of_walking_is_a_page_of_less_than_three_megabytes(track: Track) -> None:
    """Pages that browsers open at once: windows are joined into columns."""
    n = 500
    late_s = np.repeat(track.duration_s * np.arange(n), track.n_steps)
    steps = np.tile(track.steps, n)
    windows = track.windows
    many = replace(
        windows,
        time_s=np.tile(windows.time_s, n) + np.repeat(track.duration_s * np.arange(n), len(windows)),
        **{
            name: np.tile(getattr(windows, name), (n, 1) if getattr(windows, name).ndim == 2 else n)
            for name in ("context_prob", "carrying_prob", "unknown_share", "irregular_prob", "climb_rate_mps")
        },
        model=windows.model * n,
    )
    rows = ("step_length_m", "smoothed_speed_mps", "smoothed_speed_std_mps", "walking_heading_rad")
    day = replace(
        track,
        time_s=np.tile(track.time_s, n) + late_s,
        position_m=np.tile(track.position_m, (n, 1)) + late_s[:, np.newaxis] / 100,
        position_cov_m2=np.tile(track.position_cov_m2, (n, 1, 1)),
        context_prob=np.tile(track.context_prob, (n, 1)),
        mode_prob=np.tile(track.mode_prob, (n, 1)),
        **{name: np.tile(getattr(track, name), n) for name in rows},
        steps=steps.view(np.recarray),
        windows=many,
        duration_s=track.duration_s * n,
    )
    start_s = time.perf_counter()
    page = html_report(day)
    assert time.perf_counter() - start_s < 10.0
    assert len(page) < 3e6
    tree(page)


def test_drawing_needs_no_matplotlib() -> None:
    code = "import sys, pdr_filter.report.html; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
