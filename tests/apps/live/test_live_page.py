"""The page in a real browser: the path grows, "I am here" is taken, all can be read on a screen and on a phone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from browser import BROWSER, Browser
from PIL import Image
from serving import Quiet, Server, http_server, own_messages, sensor_logger_messages, short_walk

import pdr_filter as pdr
from pdr_filter.values import Samples
from pdr_filter.values.recording import Recording

pytestmark = pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
SESSION = "[...live.sessions.values()][0]"
NONE = "\u2013"


@pytest.fixture(scope="module")
def walk() -> Recording:
    return short_walk(80.0)


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with Server() as running:
        yield running


def test_the_path_grows_and_i_am_here_moves_it(server: Server, walk: Recording, tmp_path: Path) -> None:
    bodies = own_messages(walk, "phone", part_s=1.0)
    bodies, more = bodies[:-4], bodies[-4:-1]
    with Browser() as browser:
        browser.open(server.address)
        assert browser.value("!document.getElementById('empty').hidden")
        assert f"{server.address}/data" in browser.value("document.getElementById('address').textContent")
        for body in bodies[:30]:
            server.post(body)
        n_steps = browser.until(f"{SESSION}?.path.length > 20 && {SESSION}.path.length")
        for body in bodies[30:60]:
            server.post(body)
        browser.until(f"{SESSION}.path.length > {n_steps + 40}")
        browser.until("Number(document.getElementById('n_steps').textContent) > 60")
        assert browser.words("#where").startswith("At ")
        # who zooms still follows, who drags does not
        off = "Math.hypot(...live.map.place().map((v, k) => v - live.map.position[k])) * live.map.scale"
        browser.click("#nearer")
        browser.wheel("#map", 100, 0.2, 0.5)
        browser.until("live.map.scale < 13")
        assert browser.value(off) < 3
        browser.drag("#map", (0.5, 0.5), (0.4, 0.5))
        assert browser.value("document.getElementById('follow').getAttribute('aria-pressed')") == "false"
        assert browser.value(off) > 50
        browser.click("#follow")
        assert browser.value(off) < 3
        browser.click("#here")
        box = "document.getElementById('map')"
        place = browser.value(f"live.map.place({box}.clientWidth * 0.6, {box}.clientHeight * 0.5)")
        browser.click("#map", 0.6, 0.5)
        said = "document.getElementById('said').textContent"
        browser.until(f"{said}.endsWith('waits until the current step is complete.')")
        assert browser.value(f"{SESSION}.fixes[0].place") == pytest.approx(place, abs=0.2)
        assert browser.value("document.getElementById('here').getAttribute('aria-pressed')") == "false"
        # the same with the keyboard alone
        browser.value("document.getElementById('map').focus()")
        for key in ("h", "ArrowRight", "Enter"):
            browser.press(key)
        browser.until(f"{SESSION}.fixes.length === 2")
        for body in bodies[60:]:
            server.post(body)
        browser.until(f"{SESSION}.fixes.every(fix => fix.outcome === 'used')")
        assert browser.words("#said").endswith("of the start was used.")
        # and one that does not fit
        browser.value("setHere(0, 900)")
        for body in more:
            server.post(body)
        browser.until("document.getElementById('said').className === 'wrong'")
        assert "standard deviations from it" in browser.words("#said")
        # the phone comes back with a new session, which is shown from then on
        for body in own_messages(walk, "phone", "another")[:8]:
            server.post(body)
        browser.until("[...document.getElementById('session').selectedOptions][0].textContent.endsWith('another')")
        assert browser.value("live.sessions.size") == 2
        assert browser.complaints == []


def test_the_page_shows_nothing_of_another_phone_and_tells_the_state_of_each(walk: Recording, tmp_path: Path) -> None:
    def numbers(browser: Browser) -> list[str]:
        return browser.value("[...document.querySelectorAll('#numbers dd')].map(e => e.textContent)")

    def select(browser: Browser, device: str) -> None:
        browser.value(f"""(() => {{
            const select = document.getElementById('session');
            select.value = [...select.options].find(o => o.textContent.startsWith({device!r})).value;
            select.dispatchEvent(new Event('change'));
        }})()""")
        browser.settle()

    uuids = ("8b5937fb-2160-4825-ba40-4bc646f93839", "0ba5f3e8-a340-4c40-b9ea-95d7ed4d1132")
    with Server() as server, Browser() as browser:
        browser.open(server.address)
        for message in sensor_logger_messages(walk, *uuids, part_s=1.0)[:50]:
            server.post(message)
        for body in own_messages(walk, "ended", part_s=2.0):
            server.post(body)
        server.post(own_messages(walk, "empty")[0])
        for message in sensor_logger_messages(walk, "unsigned", ios=True)[:8]:
            server.post(message)
        browser.until("live.sessions.size === 4")
        browser.until("[...live.sessions.values()].some(s => s.about.has_ended)")
        select(browser, "phone 8b59 · ")  # and the time at which its session began
        browser.until("Number(document.getElementById('n_steps').textContent) > 60")
        assert "ahead and" in browser.words("#where")
        assert "the person's height is not known" in browser.words("#notes")
        assert "right" in browser.words("#heading") or "left" in browser.words("#heading")
        assert browser.value("getComputedStyle(document.querySelector('#map .north')).display") == "none"
        browser.shot(tmp_path / "walking.png")
        of_range = "{id: shown, kind: 'range', time_s: 9, anchor_m: [3, 4], accepted: %s}"
        for accepted, n_anchors in (("false", 0), ("true", 1), ("true", 1)):
            browser.value(f"(handlers.fix({of_range % accepted}), draw())")
            assert browser.value("document.querySelectorAll('#map .anchor').length") == n_anchors
        with_north = "{about: {frame: 'north'}}"
        words = browser.value(f"placeWords({with_north}, [-3, -28.2])")
        assert words == "3.0 m west and 28.2 m south of the start"
        # a speed of zero may be a step that is found late, but not for long
        speeds = "[1.2, 0, 0, 0].map((v, i) => ({time_s: 0.6 * i, walking_speed_mps: v}))"
        assert browser.value(f"steadySpeeds({speeds})") == [1.2, 1.2, 1.2, 0]

        select(browser, "empty")
        assert set(numbers(browser)) == {NONE}
        assert browser.words("#state") == "Waiting: 2 s of samples are needed, 0.5 s are there."
        assert [browser.words(s) for s in ("#where", "#gaps", "#notes", "#rates")] == ["", "", "", ""]
        assert browser.value("document.getElementById('charts').hidden")
        headings = "[...document.querySelectorAll('h2, caption')].filter(e => e.offsetHeight).map(e => e.textContent)"
        browser.until("!document.getElementById('server').hidden")
        assert browser.value(headings) == ["Download", "Server"]
        browser.shot(tmp_path / "empty.png")

        select(browser, "ended")
        assert browser.words("#state") == "This session has ended."
        assert browser.value("document.getElementById('state').className") == ""
        n_steps = str(pdr.track(replace(walk, meta={})).n_steps)
        browser.until(f"document.getElementById('n_steps').textContent === '{n_steps}'")
        browser.shot(tmp_path / "ended.png")

        select(browser, "unsigned")
        assert browser.words("#state").startswith("Not tracked: iOS and Android have opposite signs")
        assert browser.value("document.getElementById('state').className") == "wrong"

        select(browser, "phone 8b59")
        browser.until("document.getElementById('state').textContent.startsWith('Silent for ')")
        shown = numbers(browser)
        assert (shown[2], shown[8]) == (NONE, NONE)  # speed and delay
        assert int(shown[0]) > 60
        browser.shot(tmp_path / "silent.png")
        path = f"{SESSION}.path"
        inside = browser.value(f"""{path}.every(row => {{
            const {{ leaflet }} = live.map, size = leaflet.getSize();
            const at = leaflet.latLngToContainerPoint(live.map.at(row[1], row[2]));
            return at.x > 0 && at.y > 0 && at.x < size.x && at.y < size.y;
        }})""")
        assert inside
        browser.ask("Emulation.setDeviceMetricsOverride", width=400, height=900, deviceScaleFactor=1, mobile=False)
        browser.until("[...document.querySelectorAll('.uplot')].every(e => e.getBoundingClientRect().right <= 400)")
        assert browser.value("document.documentElement.scrollWidth") == 400
        bottom = browser.value("document.getElementById('state').getBoundingClientRect().bottom")
        assert 0 < bottom <= browser.value("document.getElementById('map').getBoundingClientRect().top")
        browser.shot(tmp_path / "narrow.png")
        # a page that is opened later knows for how long the phone has been silent
        browser.open(server.address)
        browser.until("live.sessions.size === 4")
        select(browser, "phone 8b59")
        browser.until("document.getElementById('state').textContent.startsWith('Silent for ')", 2.0)
        assert browser.value("[...live.sessions.values()].some(session => session.history.length > 0)")
        assert browser.complaints == []


@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_everything_can_be_seen_and_read(
    server: Server, walk: Recording, tmp_path: Path, width: int, dark: bool
) -> None:
    for body in own_messages(walk, f"{width} {'and a name that is wider than a phone ' * 2}", part_s=1.0)[:50]:
        server.post(body)
    with Browser() as browser:
        browser.open(server.address, width, 900, "dark" if dark else "light")
        browser.until(f"{SESSION}?.path.length > 20")
        browser.until("document.querySelectorAll('canvas').length === 3")
        browser.until("Number.parseFloat(document.getElementById('messages').textContent) > 1")
        assert browser.words("#warning") == browser.words("#refusal") == ""
        rates = "messages_per_s: 5, bytes_per_s: 5e4, answer_s: 0.012, n_refused: {503: 2}, refusal: 'p: no space'"
        browser.value(f"handlers.server({{{rates}, disk_left_bytes: 4e8, disk_left_s: 1800, is_disk_low: true}})")
        assert browser.words("#warning").startswith("The disk of the server is full in 30 min: 400 MB are left.")
        assert browser.words("#refusal") == "Refused by status: 503 (2). The last one: p: no space"
        assert browser.value("document.documentElement.scrollWidth") == width
        covered = browser.value("""
            [...document.querySelectorAll('dd, dt, button, select, #map, .uplot, a, caption')].filter(e => {
              const r = e.getBoundingClientRect();
              return r.width && (r.left < 0 || r.right > innerWidth + 0.5);
            }).map(e => e.outerHTML.slice(0, 80))""")
        assert covered == []
        unnamed = browser.value("""
            [...document.querySelectorAll('button, select, input, [tabindex]')].filter(e =>
              !(e.getAttribute('aria-label') || e.textContent.trim() || e.labels?.length)).map(e => e.outerHTML)""")
        assert unnamed == []
        assert browser.shot(tmp_path / "page.png").stat().st_size > 20_000
        background = browser.value("getComputedStyle(document.body).backgroundColor")
        assert (background == "rgb(255, 255, 255)") == (not dark)
        assert browser.complaints == []


@contextmanager
def tiles_of_one_colour(asked: list[str]) -> Iterator[str]:
    """Address of the tiles of another server, which are green."""
    picture = BytesIO()
    Image.new("RGB", (256, 256), (0x22, 0x88, 0x44)).save(picture, "PNG")

    class Handler(Quiet):
        def do_GET(self) -> None:  # noqa: N802
            asked.append(self.path)
            self.answer(picture.getvalue())

    with http_server(Handler) as port:
        yield f"http://127.0.0.1:{port}/{{z}}/{{x}}/{{y}}.png"


@pytest.mark.parametrize("named", [True, False])
def test_tiles_of_the_place_lie_below_the_path_if_somebody_names_a_source(
    walk: Recording, tmp_path: Path, named: bool
) -> None:
    time_s = np.arange(0.0, 60.0)
    latitude, longitude = 51.5, -0.1
    values = np.column_stack([latitude + 1e-5 * time_s, np.full(60, longitude), np.zeros(60), np.full(60, 5.0)])
    bodies = own_messages(replace(walk, location=Samples(time_s, values)), "outdoors", part_s=1.0)
    asked: list[str] = []
    with (
        tiles_of_one_colour(asked) as source,
        Server(*(("--tiles", source) if named else ())) as server,
        Browser() as browser,
    ):
        browser.open(server.address)
        for body in bodies[:50]:
            server.post(body)
        browser.until(f"{SESSION}?.origin && {SESSION}.path.length > 20")
        if named:
            browser.until("document.querySelector('#map .leaflet-tile-loaded')")
            owner = browser.value("document.querySelector('#map .leaflet-control-attribution').textContent")
            assert owner == "127.0.0.1"
        browser.settle()
        elsewhere = [address for address in browser.asked_for if not address.startswith((server.address, "data:"))]
        assert bool(elsewhere) == bool(asked) == named
        shot = matplotlib.image.imread(browser.shot(tmp_path / "page.png"))
        left, top = browser.value("(r => [r.left, r.top])(document.getElementById('map').getBoundingClientRect())")
        corner = shot[int(top) + 60 : int(top) + 100, int(left) + 60 : int(left) + 100, :3]
        colour = np.round(255 * np.median(corner, axis=(0, 1)))  # whatever lines of the grid are there
        np.testing.assert_array_equal(colour, [0x22, 0x88, 0x44] if named else [255, 255, 255])
        assert browser.complaints == []
    if named:
        zoom, column, row = map(int, asked[0].removesuffix(".png").split("/")[1:])
        angle = np.radians(latitude)
        assert abs(column - (longitude + 180) / 360 * 2**zoom) < 3
        assert abs(row - (1 - np.arcsinh(np.tan(angle)) / np.pi) / 2 * 2**zoom) < 3


def test_a_browser_that_has_motion_sends_it(server: Server, tmp_path: Path) -> None:
    """Events as Chromium on Android gives them: m/s2, degrees per second about z, x and y."""
    with Browser() as browser:
        browser.open(f"{server.address}/phone")
        browser.value("document.getElementById('height').value = 1.62")
        browser.click("#start")
        browser.until("document.getElementById('connection').textContent === 'connected'")
        browser.value("running.socket.send('{')")
        browser.until("document.getElementById('said').textContent.startsWith('not JSON')")
        assert browser.value("document.getElementById('said').className") == "wrong"
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
        browser.shot(tmp_path / "sender.png")
        answer = server.http.get(f"/sessions/{session['id']}/recording.zip")
        path = tmp_path / "sent.zip"
        path.write_bytes(answer.content)
        sent = pdr.read(path)
        assert not browser.value("isApple()")
        assert sent.subject.height_m == 1.62
        np.testing.assert_allclose(sent.gyroscope.values[0], [0, np.pi, np.pi / 2], atol=1e-9)
        assert browser.complaints == []
        # whose signs are of iOS
        browser.ask(
            "Emulation.setUserAgentOverride", userAgent="Mozilla/5.0 (iPhone; CPU iPhone OS 18_0 like Mac OS X)"
        )
        browser.open(f"{server.address}/phone")
        assert browser.value("isApple()")
        assert browser.value("document.getElementById('name').value") == "browser iOS"
