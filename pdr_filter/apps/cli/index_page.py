"""Index page of the tracks in a folder, with a row and links to picture, report and table for each track."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from pdr_filter.apps.cli import console
from pdr_filter.values.safe_files import write_text
from pdr_filter.values.sanitise import printable

if TYPE_CHECKING:
    from pdr_filter.tracking.track import Track

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Tracks</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2em auto; max-width: 70em; padding: 0 1em;
  color: #222; background: #fff }}
table {{ border-collapse: collapse }}
td, th {{ padding: .4em .8em; text-align: right; border-bottom: 1px solid #8884; vertical-align: top }}
td {{ white-space: nowrap }}
td:first-child, th:first-child, td:last-child {{ text-align: left; overflow-wrap: anywhere; white-space: normal }}
li {{ overflow-wrap: anywhere }}
img {{ width: 12em; display: block }}
@media (max-width: 50em) {{
  body {{ font-size: 12px }}
  td, th {{ padding: .3em .25em }}
  td:first-child {{ min-width: 7.5em }}
  td:nth-child(5), th:nth-child(5) {{ display: none }}
  img {{ width: 6em }}
}}
@media (prefers-color-scheme: dark) {{ body {{ color: #ddd; background: #16181c }} a {{ color: #8bf }} }}
</style></head><body>
<h1>{n}</h1>
<table><tr><th>recording</th><th>steps</th><th>distance</th><th>± at the end</th><th>duration</th><th></th></tr>
{rows}
</table>
<p>{caption}</p>
{failed}
</body></html>
"""


def write_index(tracks: Mapping[str, Track], failed: Mapping[Path, str], path: Path) -> Path:
    """Write the index page and return its path.

    `tracks` has the tracks by the names of their files without suffix. `failed` has the reason for each recording that
    could not be tracked.
    """
    from pdr_filter.values import how_many

    rows = "\n".join(_row(name, track) for name, track in tracks.items())
    reasons = "".join(f"<li>{_text(reason)}</li>" for reason in failed.values())
    failures = f"<h2>{len(failed)} could not be tracked</h2><ul>{reasons}</ul>" if failed else ""
    return write_text(
        path, _PAGE.format(n=how_many(len(tracks), "track"), rows=rows, caption=console.STD_CAPTION, failed=failures)
    )


def _row(name: str, track: Track) -> str:
    summary = track.summary()
    file = quote(name)
    std = f"{summary['end_std_m']:.1f} m" if track.n_steps else ""
    return (
        f'<tr><td><a href="{file}.html">{_text(track.name)}</a></td><td>{track.n_steps}</td>'
        f"<td>{track.how_far}</td><td>{std}</td><td>{track.duration_s:.0f} s</td>"
        f'<td><a href="{file}.png"><img src="{file}.png" alt="the track"></a><a href="{file}.csv">table</a></td></tr>'
    )


def _text(text: str) -> str:
    return escape(printable(text))
