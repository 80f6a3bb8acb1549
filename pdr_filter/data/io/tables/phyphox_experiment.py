"""phyphox (iOS, Android): wall clock, pauses and phone, which the app writes into the folder `meta` beside its tables.

`any_table` reads the tables. `apps.live.sources.Phyphox` reads from a phone whose remote access is on. Layout after the
app's export code (github.com/phyphox/phyphox-android, DataExport.java). Time is in seconds of the experiment, which
stands still while it is paused.
"""

from __future__ import annotations

import math
from pathlib import PurePosixPath

from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.files.archive import Members
from pdr_filter.data.io.text_table import header_fields, to_number
from pdr_filter.values import how_often


def read_experiment(members: Members, parsed: Parsed) -> None:
    """Add start, pauses (time.csv), phone model and app version (device.csv) of a phyphox export to `parsed`."""
    names = {PurePosixPath(name).name: name for name in members.names if PurePosixPath(name).parent.name == "meta"}
    if not {"time.csv", "device.csv"} & names.keys():
        return
    parsed.clock = "seconds of the experiment"
    for row in _meta_rows(members, names, "time.csv"):
        if len(row) >= 3 and row[0] == "START" and "epoch_s" not in parsed.meta:
            begun_s, epoch_s = (to_number(field.replace(",", ".")) for field in row[1:3])
            if begun_s is not None and epoch_s is not None and math.isfinite(begun_s + epoch_s):
                parsed.meta["epoch_s"] = epoch_s - begun_s
                parsed.clock = f"seconds of the experiment, which began at {epoch_s:.3f} s since 1970"
    pauses = sum(row[:1] == ["PAUSE"] for row in _meta_rows(members, names, "time.csv"))
    if pauses > 1:
        parsed.notes.append(f"the experiment was paused {how_often(pauses - 1)}; its clock stood still meanwhile")
    about = {row[0]: row[1] for row in _meta_rows(members, names, "device.csv") if len(row) >= 2}
    parsed.set_device(about.get("deviceManufacturer"), about.get("deviceModel"))
    if about.get("version"):
        parsed.source = f"phyphox {about['version'][:40]}"


def _meta_rows(members: Members, names: dict[str, str], name: str) -> list[list[str]]:
    if name not in names:
        return []
    lines = members.small(names[name]).decode("utf-8", "replace").splitlines()
    separator = next((s for s in ("\t", ";", ",") if lines and f'"{s}' in lines[0]), ",")
    return [header_fields(line, separator) for line in lines[1:1000]]
