"""The page in a real browser: the path grows, "I am here" is taken, all can be read on a screen and on a phone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import BROWSER, Browser
from serving import Server, own_messages, short_walk

import pdr_filter as pdr
from pdr_filter.io.recording import Recording

pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
SESSION = "[...live.sessions.values()][0]"


@pytest.fixture(scope="module")
def walk() -> Recording:
    return short_walk(80.0)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


def test_the_path_grows_and_i_am_here_moves_it(server: Server, walk: Recording, tmp_path: Path) -> None:
    bodies = own_messages(walk, "phone")
    bodies, more = bodies[:-8], bodies[-8:-1]
    with Browser(tmp_path) as browser:
        browser.open(server.address)
        assert browser.value("!document.getElementById('empty').hidden")
        assert f"{server.address}/data" in browser.value("document.getElementById('address').textContent")
        for body in bodies[:60]:
            server.post(body)
        n_steps = browser.until(f"{SESSION}?.path.length > 20 && {SESSION}.path.length")
        for body in bodies[60:120]:
            server.post(body)
        browser.until(f"{SESSION}.path.length > {n_steps + 40}")
        browser.until("Number(document.getElementById('n_steps').textContent) > 60")
        browser.click("#here")
        size = "[live.map.canvas.clientWidth, live.map.canvas.clientHeight]"
        place = browser.value(f"live.map.place({size}[0] * 0.6, {size}[1] * 0.5)")
        browser.click("#map", 0.6, 0.5)
        browser.until("document.getElementById('said').textContent.endsWith('waits for the step that it falls into.')")
        assert browser.value(f"{SESSION}.fixes[0].place") == pytest.approx(place, abs=0.2)
        assert browser.value("document.getElementById('here').getAttribute('aria-pressed')") == "false"
        # the same with the keyboard alone
        browser.value("document.getElementById('map').focus()")
        for key in ("h", "ArrowRight", "Enter"):
            browser.press(key)
        browser.until(f"{SESSION}.fixes.length === 2")
        for body in bodies[120:]:
            server.post(body)
        browser.until(f"{SESSION}.fixes.every(fix => fix.outcome === 'used')")
        assert browser.words("#said").endswith("north was used.")
        # and one that does not fit
        browser.value("setHere(0, 900)")
        for body in more:
            server.post(body)
        browser.until("document.getElementById('said').className === 'wrong'")
        assert "standard deviations from it" in browser.words("#said")
        assert browser.complaints == []


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_everything_can_be_seen_and_read(
    server: Server, walk: Recording, tmp_path: Path, width: int, dark: bool
) -> None:
    for body in own_messages(walk, f"wide {width}")[:100]:
        server.post(body)
    with Browser(tmp_path) as browser:
        browser.open(server.address, width, 900, "dark" if dark else "light")
        browser.until(f"{SESSION}?.path.length > 20")
        browser.until("document.querySelectorAll('canvas').length === 3")
        assert browser.value("document.documentElement.scrollWidth") == width
        covered = browser.value("""
            [...document.querySelectorAll('dd, dt, button, select, canvas, a, caption')].filter(e => {
              const r = e.getBoundingClientRect();
              return r.width && (r.left < 0 || r.right > innerWidth + 0.5);
            }).map(e => e.outerHTML.slice(0, 80))""")
        assert covered == []
        unnamed = browser.value("""
            [...document.querySelectorAll('button, select, input, canvas[tabindex]')].filter(e =>
              !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map(e => e.outerHTML)""")
        assert unnamed == []
        assert browser.shot(tmp_path / "page.png").stat().st_size > 20_000
        background = browser.value("getComputedStyle(document.body).backgroundColor")
        assert (background == "rgb(255, 255, 255)") == (not dark)
        assert browser.complaints == []


def test_a_browser_that_has_motion_sends_it(server: Server, tmp_path: Path) -> None:
    """Events as Chromium on Android gives them: m/s2, degrees per second about z, x and y."""
    with Browser(tmp_path) as browser:
        browser.open(f"{server.address}/phone")
        browser.click("#start")
        browser.until("document.getElementById('connection').textContent === 'connected'")
        browser.value("""
            new Promise(done => {
              let n = 0;
              const timer = setInterval(() => {
                dispatchEvent(new DeviceMotionEvent('devicemotion', {
                  accelerationIncludingGravity: {x: 0.1, y: 0.2, z: 9.8},
                  rotationRate: {alpha: 90, beta: 0, gamma: 180},
                }));
                if (++n > 250) { clearInterval(timer); done(); }
              }, 10);
            })""")
        browser.click("#start")
        browser.until("document.getElementById('said').textContent.endsWith('sent')")
        time.sleep(2.5)  # until it is on the disk
        sessions = server.http.get("/sessions").json()["sessions"]
        (session,) = [s for s in sessions if s["device"].startswith("browser")]
        assert session["force"] == "accelerometer, as it is"
        answer = server.http.get(f"/sessions/{session['id']}/recording.zip")
        path = tmp_path / "sent.zip"
        path.write_bytes(answer.content)
        sent = pdr.read(path)
        assert sent.gyroscope is not None
        np.testing.assert_allclose(sent.gyroscope.values[0], [0, np.pi, np.pi / 2], atol=1e-9)
        assert browser.complaints == []
