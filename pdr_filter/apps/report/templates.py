"""HTML pages from templates, which are files of this package. All of them have the layout `report/page/layout.html`.

Pages are self-contained. Their content security policy forbids the browser to load other files and to run other
scripts. uPlot draws charts, and Leaflet draws maps. Both are in `report/assets`, unchanged from npm (`.ci/vendor.py`).
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from functools import cache
from hashlib import sha256
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

_STYLES = ("report/assets/uPlot.min.css", "report/assets/leaflet.css", "report/page/page.css")
MAP_SCRIPTS = ("report/page/page.js", "report/assets/leaflet.js", "report/page/plane_map.js")


def page(name: str, scripts: Sequence[str] = MAP_SCRIPTS[:1], **values: Any) -> str:
    """Return a page from the template `name`, with scripts of these names and the styles of all pages.

    Names are those of files of `pdr_filter.apps`. Values are escaped, and control characters in them are replaced. All
    pages have a `title`. `data` are values for the scripts, and `image_source` is the only server that may be asked.
    """
    contents = [_script(script) for script in scripts]
    return (
        _environment()
        .get_template(name)
        .render(
            {"data": None, "image_source": ""} | values,
            style=Markup("\n".join(_read(style) for style in _STYLES)),
            scripts=[Markup(content) for content in contents],
            script_hashes=[f"sha256-{b64encode(sha256(c.encode()).digest()).decode()}" for c in contents],
        )
    )


def _read(name: str) -> str:
    return resources.files("pdr_filter.apps").joinpath(name).read_text(encoding="utf-8")


def _script(name: str) -> str:
    """Return a script. A vendored library is preceded by its licence text, as the licence requires."""
    folder, _, file = name.rpartition("/")
    if not folder.endswith("assets"):
        return _read(name)
    licence = _read(f"{folder}/{file.partition('.')[0]}.LICENSE.txt")
    return f"/*\n{licence}*/\n{_read(name)}"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_printable,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    return environment


def _printable(value: Any) -> Any:
    """Return a text with a replacement character for each control character, also those that change direction."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return "".join(c if c in "\t\n" or (c.isprintable() and not "\ud800" <= c <= "\udfff") else "�" for c in value)
