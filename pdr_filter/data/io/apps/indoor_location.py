"""indoor-location-competition 2.0: one text file for each walk, tab-separated, a type in every line.

Layout after github.com/location-competition/indoor-location-competition-20: `unix time in ms`, `TYPE_...`, values in
Android's units and sign; comment lines (`#`) name site, floor and phone. `TYPE_WAYPOINT` is a point of the floor map in
metres, marked by the surveyor; `TYPE_WIFI` has name, address, dBm, MHz and when it was last heard. Other types
(beacons, uncalibrated values) are ignored.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from pdr_filter.data.io.apps.tagged_lines import TaggedLog, rotation_vector_quaternion
from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.files.archive import open_members
from pdr_filter.data.io.text_table import Layout
from pdr_filter.data.io.wifi_rows import heard_s, lines_of_log
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording

STREAM = {
    "TYPE_ACCELEROMETER": "accelerometer",
    "TYPE_GYROSCOPE": "gyroscope",
    "TYPE_MAGNETIC_FIELD": "magnetometer",
    "TYPE_ROTATION_VECTOR": "attitude",
}
LAYOUTS = {
    **dict.fromkeys(STREAM, Layout((2, 3, 4), 0, "\t")),
    "TYPE_WAYPOINT": Layout((2, 3), 0, "\t"),
    "TYPE_WIFI": Layout((1, 2, 3, 4), 0, "\t"),  # as rewritten: reported, address, dBm, MHz, heard
}
_WIFI = rb"^(\d{10,16})\tTYPE_WIFI\t.*\t(ADDRESS)\t(-?\d{1,4})\t(\d{1,6})\t(\d{1,16})\r?$"


def is_indoor_location(head: bytes) -> bool:
    """Return True if a text begins like a file of the Indoor Location Competition, judged by its first bytes."""
    return re.search(rb"(?m)^\d{10,16}\tTYPE_[A-Z_]+\t", head) is not None


def read_indoor_location(path: str | Path) -> Recording:
    """Return the recording in a text file of the competition; waypoints become `truth.waypoints`, in map metres."""
    path = Path(path)
    parsed = Parsed(path, "indoor-location-competition 2.0")
    with open_members(path) as members:
        log = TaggedLog(members, "#")
        tables, n_others = log.tables(LAYOUTS, 1, parsed.notes, {"TYPE_WIFI": partial(lines_of_log, _WIFI, b"\t")})
    force = tables.get("TYPE_ACCELEROMETER")
    if force is None or len(force) == 0:
        found = ", ".join(tables) or "none"
        raise RecordingError(f"{log.where}: no TYPE_ACCELEROMETER lines (found: {found}); take a walk that has them")
    zero_ms = int(force.whole[0])
    time_s = {tag: (table.whole - zero_ms).astype(np.float64) * 1e-3 for tag, table in tables.items()}
    for tag, stream in STREAM.items():
        if tag in tables:
            values = tables[tag].values
            values = rotation_vector_quaternion(values) if stream == "attitude" else values
            parsed.streams[stream] = (time_s[tag], values)
    header = log.header_values("\t")
    if "TYPE_WAYPOINT" in tables:
        points_m = tables["TYPE_WAYPOINT"].values
        parsed.truth["waypoints"] = {
            "time_s": time_s["TYPE_WAYPOINT"],
            "east_m": points_m[:, 0],
            "north_m": points_m[:, 1],
            "floor": np.full(len(points_m), _floor_number(header.get("FloorName", ""))),
        }
        parsed.meta["truth"] = "points of the floor map that the surveyor marked; its north is not known"
    if "TYPE_WIFI" in tables:
        wifi = tables["TYPE_WIFI"].values
        times_s = heard_s(time_s["TYPE_WIFI"], (wifi[:, 3] - zero_ms) * 1e-3, parsed.notes)
        parsed.wifi = (times_s, wifi[:, :3])
    parsed.set_device(header.get("Brand"), header.get("Model"))
    parsed.meta |= {key: header[key] for key in ("SiteID", "SiteName", "FloorName") if key in header}
    parsed.meta["epoch_ms"] = zero_ms
    parsed.found.append(
        "accelerometer m/s2, gyroscope rad/s, magnetometer uT, Android's sign, as Android delivers them"
    )
    if n_others > len(log.header):
        parsed.found.append(f"{n_others - len(log.header)} lines of other types ignored")
    parsed.clock = f"unix milliseconds of the phone, in whole milliseconds; time zero is {zero_ms} ms"
    return parsed.recording()


def _floor_number(name: str) -> float:
    """Return the storey for the name of a floor: 0 for F1 and 1F (ground floor), -1 for B1, NaN for unknown names."""
    match = re.fullmatch(r"([FBfb])(\d{1,2})|(\d{1,2})([FBfb])", name.strip())
    if match is None:
        return float("nan")
    letter, number = (match[1] or match[4]).upper(), int(match[2] or match[3])
    return float(number - 1 if letter == "F" else -number)
