"""A headless Chromium that a test drives: opens a page, points, clicks, looks, over the DevTools protocol."""

from __future__ import annotations

import atexit
import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "chrome-headless-shell")
BROWSER = next((path for name in NAMES if (path := shutil.which(name))), "")
OPTIONS = (
    "--headless",
    "--no-sandbox",  # Chromium refuses root otherwise, which is what containers have
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--ignore-certificate-errors",
    # whatever is asked for, nothing leaves the machine
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
    "--remote-debugging-pipe",
)

# Of the keys that a page may know by their codes.
KEY_CODES = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "+": 187, "-": 189}


class Chromium:
    """A browser that runs. Messages are JSON with a zero byte behind, which Chromium reads at 3 and writes at 4."""

    def __init__(self) -> None:
        self._number, self._rest = 0, b""
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        to_browser, self._write = os.pipe()
        self._read, from_browser = os.pipe()
        program = [BROWSER, *OPTIONS, f"--user-data-dir={self._profile.name}", "about:blank"]
        # The shell puts the pipes where Chromium looks for them; sh knows no numbers above nine.
        shell = ["bash", "-c", f'exec "$@" 3<&{to_browser} 4>&{from_browser}', "bash", *program]
        self._process = subprocess.Popen(
            shell, pass_fds=(to_browser, from_browser), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(to_browser)
        os.close(from_browser)
        atexit.register(self._end)

    def _end(self) -> None:
        os.close(self._write)
        os.close(self._read)
        self._process.terminate()
        self._process.wait(10)

    def send(self, message: dict[str, Any]) -> int:
        """Number of the message, which its answer has as `id`."""
        self._number += 1
        os.write(self._write, json.dumps(message | {"id": self._number}).encode() + b"\0")
        return self._number

    def next(self) -> dict[str, Any]:
        """What it says next."""
        while b"\0" not in self._rest:
            part = os.read(self._read, 1 << 20)
            if not part:
                raise RuntimeError("Chromium has ended")
            self._rest += part
        text, _, self._rest = self._rest.partition(b"\0")
        return json.loads(text)


chromium = cache(Chromium)  # one for each process: it takes a second to start


class Browser:
    """One page, which shares no cookie, storage or file with other pages."""

    def __init__(self) -> None:
        self.complaints: list[str] = []
        self.asked_for: list[str] = []  # addresses
        self._session = ""
        self._context = self.ask("Target.createBrowserContext")["browserContextId"]
        page = self.ask("Target.createTarget", url="about:blank", browserContextId=self._context)["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def __enter__(self) -> Browser:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._session = ""
        self.ask("Target.disposeBrowserContext", browserContextId=self._context)

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command; what the page complains about and asks for meanwhile is kept."""
        of_page = {"sessionId": self._session} if self._session else {}
        number = chromium().send({"method": method, "params": parameters, **of_page})
        while True:
            message = chromium().next()
            if message.get("id") == number:
                if "error" in message:
                    raise RuntimeError(message["error"]["message"])
                return message["result"]
            if message.get("sessionId") == self._session:  # nothing of the page before
                self._heard(message.get("method"), message.get("params", {}))

    def _heard(self, what: str | None, content: dict[str, Any]) -> None:
        if what == "Runtime.exceptionThrown":
            self.complaints.append(str(content["exceptionDetails"].get("exception", {}).get("description")))
        elif what == "Runtime.consoleAPICalled":
            self.complaints.append(f"{content['type']}: {content['args']}")
        elif what == "Log.entryAdded":
            self.complaints.append(content["entry"]["text"])
        elif what == "Network.requestWillBeSent":
            self.asked_for.append(content["request"]["url"])

    def open(self, page: Path | str, width: int = 1280, height: int = 900, theme: str = "light") -> None:
        """Go to a file or an address, on a screen so large; what was noted of the page before is forgotten."""
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        media = {"prefers-color-scheme": theme, "prefers-reduced-motion": "reduce"}
        self.ask("Emulation.setEmulatedMedia", features=[{"name": n, "value": v} for n, v in media.items()])
        self.complaints, self.asked_for = [], []
        self.ask("Page.navigate", url=page if isinstance(page, str) else page.as_uri())
        self.until("document.readyState === 'complete'")
        self.settle()

    def settle(self) -> None:
        """Wait until what a page draws in its next frame is drawn."""
        self.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def value(self, expression: str) -> Any:
        """Of an expression in the page."""
        answer = self.ask("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(str(answer["exceptionDetails"]))
        return answer["result"].get("value")

    def until(self, expression: str, timeout_s: float = 60.0) -> Any:
        """Wait until an expression is true."""
        end = time.monotonic() + timeout_s
        while not (value := self.value(expression)):
            if time.monotonic() > end:
                raise TimeoutError(f"never true: {expression}")
            time.sleep(0.02)
        return value

    def words(self, selector: str) -> str:
        """Text of the first element."""
        return self.value(f"document.querySelector({selector!r}).innerText")

    def _place(self, selector: str, x: float, y: float) -> dict[str, float]:
        """Of a part of an element's width and height, which is scrolled to."""
        left, top, width, height = self.value(
            f"(() => {{ const e = document.querySelector({selector!r}); e.scrollIntoView({{block: 'center'}});"
            "const r = e.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
        )
        return {"x": left + x * width, "y": top + y * height}

    def hover(self, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """Move the mouse onto an element."""
        self.ask("Input.dispatchMouseEvent", type="mouseMoved", **self._place(selector, x, y))
        self.settle()

    def click(self, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """Press and release the mouse on an element, at this part of its width and height."""
        self.drag(selector, (x, y), (x, y))

    def drag(self, selector: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press the mouse at one part of an element's width and height and release it at another."""
        a, b = self._place(selector, *start), self._place(selector, *end)
        press: dict[str, Any] = {"button": "left", "clickCount": 1}
        self.ask("Input.dispatchMouseEvent", type="mousePressed", **press, **a)
        if start != end:
            for share in (0.5, 1.0):
                place = {k: a[k] + share * (b[k] - a[k]) for k in a}
                self.ask("Input.dispatchMouseEvent", type="mouseMoved", button="left", buttons=1, **place)
        self.ask("Input.dispatchMouseEvent", type="mouseReleased", **press, **b)
        self.settle()

    def wheel(self, selector: str, down: float, x: float = 0.5, y: float = 0.5) -> None:
        """Turn the wheel over an element, at this part of its width and height."""
        place = self._place(selector, x, y)
        self.ask("Input.dispatchMouseEvent", type="mouseWheel", deltaX=0, deltaY=down, **place)
        self.settle()

    def press(self, key: str) -> None:
        """Press a key."""
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=kind, key=key, windowsVirtualKeyCode=KEY_CODES.get(key, 0))
        self.settle()

    def picture(self, selector: str) -> bytes:
        """An element as it is seen, as PNG."""
        self._place(selector, 0, 0)
        box = self.value(
            f"(r => ({{x: r.left + scrollX, y: r.top + scrollY, width: r.width, height: r.height}}))"
            f"(document.querySelector({selector!r}).getBoundingClientRect())"
        )
        return base64.b64decode(self.ask("Page.captureScreenshot", clip={**box, "scale": 1})["data"])

    def shot(self, path: Path, is_whole: bool = True) -> Path:
        """A picture of the whole page, or of its first screen."""
        self.value("scrollTo(0, 0)")
        size = self.ask("Page.getLayoutMetrics")["cssContentSize" if is_whole else "cssLayoutViewport"]
        size = {
            "width": size.get("width", size.get("clientWidth")),
            "height": size.get("height", size.get("clientHeight")),
        }
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        data = self.ask("Page.captureScreenshot", captureBeyondViewport=True, clip=clip)["data"]
        path.write_bytes(base64.b64decode(data))
        return path

    def printed(self, path: Path) -> Path:
        """The page as PDF."""
        path.write_bytes(base64.b64decode(self.ask("Page.printToPDF", printBackground=True)["data"]))
        return path
