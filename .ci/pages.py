"""Open each page of a built documentation in headless Chromium, at the width of a phone, and check what a reader sees.

Usage: python .ci/pages.py docs/_build/html

A page fails if its console shows an error, a formula is not typeset, a link within the documentation leads nowhere, or
the page is wider than 390 px. Pages of single objects (api/) are made from one template and have no formulas in most
cases: one in ten is opened. Their links are all checked. Without Chromium nothing is checked.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from browser import BROWSER, Browser

WIDTH = 390
# Not typeset: no picture of the formula, an error of MathJax, or a command that it shows in red because it is unknown.
FAILED_FORMULAS = """
(async () => {
  if (window.MathJax?.startup) await MathJax.startup.promise.catch(() => null);
  return [...document.querySelectorAll("span.math, div.math")].filter(formula =>
    !formula.querySelector("mjx-container svg") || formula.querySelector(
      '[data-mml-node="merror"], [data-mjx-error], [fill="red"]')
  ).map(formula => formula.textContent.trim().slice(0, 60));
})()"""
# In the theme, a box of its own scrolls if something in the text is too wide.
SEEN_WIDTH = "Math.max(...[document.documentElement, ...document.querySelectorAll('.content')].map(e => e.scrollWidth))"


class _Page(HTMLParser):
    """The targets of links and files, and the anchors, of one page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.links |= {value for name in ("href", "src") if (value := values.get(name))}
        self.anchors |= {value for name in ("id", "name") if (value := values.get(name))}


def broken_links(folder: Path) -> list[str]:
    """Return one line for each link within the documentation whose file or anchor does not exist."""
    pages = {path.resolve(): _Page(path) for path in sorted(folder.rglob("*.html"))}
    found: list[str] = []
    for path, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            is_there = target.exists()
            if is_there and parts.fragment and target in pages:
                is_there = unquote(parts.fragment) in pages[target].anchors
            if not is_there:
                found.append(f"{path.relative_to(folder.resolve())}: broken link {link}")
    return found


def problems_of(page: Path, browser: Browser) -> list[str]:
    """Return one line for each problem of a page as it is seen in the browser."""
    browser.open(page, width=WIDTH)
    formulas = browser.value(FAILED_FORMULAS)
    found = [f"formula not typeset: {formula}" for formula in formulas]
    found += [f"console: {complaint}" for complaint in browser.complaints]
    width = browser.value(SEEN_WIDTH)
    return found + ([f"{width} px wide instead of {WIDTH}"] if width > WIDTH else [])


def problems(folder: Path) -> list[str]:
    """Return one line for each problem of the pages in a folder."""
    objects = sorted((folder / "api").glob("*.html"))
    pages = [path for path in sorted(folder.rglob("*.html")) if path not in set(objects)] + objects[::10]
    found = broken_links(folder)
    with Browser() as browser:
        for page in pages:
            found += [f"{page.relative_to(folder)}: {problem}" for problem in problems_of(page.resolve(), browser)]
    return found


if __name__ == "__main__":
    lines = problems(Path(sys.argv[1])) if BROWSER else []
    if lines:
        sys.exit("\n".join(lines))
