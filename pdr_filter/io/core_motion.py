"""CoreMotion tables such as those of MotionSense: CSV with attitude, gravity, rotation rate and user acceleration.

Layout after the data set's own description (github.com/mmalekzadeh/motion-sense) and Apple's CMDeviceMotion: columns in
any order, gravity and user acceleration in g with Apple's sign, 50 Hz without a time column (docs/formats.md). The
attitude turns the sensor frame into a world with z up: R = Rz(yaw) Rx(pitch) Ry(roll).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdr_filter.io import limits
from pdr_filter.io.archive import open_members
from pdr_filter.io.assemble import Parsed
from pdr_filter.io.describe import median_norm
from pdr_filter.io.errors import RecordingError
from pdr_filter.io.recording import Recording
from pdr_filter.io.table import TextTable, find_separator, header_fields
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray

RATE_HZ = 50.0
GROUPS = {
    **{name: (f"{name}.x", f"{name}.y", f"{name}.z") for name in ("gravity", "userAcceleration", "rotationRate")},
    "attitude": ("attitude.roll", "attitude.pitch", "attitude.yaw"),
}
TIME_NAMES = ("time", "time_s", "timestamp")


def looks_like(header: str) -> bool:
    """Whether the header line of a CSV file names gravity and user acceleration of CoreMotion."""
    return {"gravity.x", "userAcceleration.x"} <= set(header_fields(header, find_separator(header)))


def read_core_motion(path: str | Path) -> Recording:
    """Return the recording in a CSV file of CoreMotion values.

    RecordingError if gravity or user acceleration is missing, or gravity is not in g.
    """
    path = Path(path)
    parsed = Parsed(path, "CoreMotion table")
    with open_members(path) as members:
        name = members.only_text()
        table = TextTable(members.blocks(name), members.where(name))
        groups = [group for group, names in GROUPS.items() if all(table.fields.count(name) == 1 for name in names)]
        for group in ("gravity", "userAcceleration"):  # needed
            table.places(GROUPS[group])
        time_name = next((name for name in TIME_NAMES if table.fields.count(name) == 1), None)
        names = [name for group in groups for name in GROUPS[group]]
        rows = table.parse(table.places([*names, *([time_name] if time_name else [])]), parsed.notes)
    values = {group: rows.values[:, 3 * i : 3 * i + 3] for i, group in enumerate(groups)}
    if time_name:
        time_s = rows.values[:, -1]
        parsed.clock = f"column {time_name}, taken as seconds"
    else:
        time_s = np.arange(len(rows)) / RATE_HZ
        parsed.requested_hz = dict.fromkeys(("accelerometer", "gyroscope", "attitude"), RATE_HZ)
        parsed.clock = f"no time column: row number divided by {RATE_HZ:g} Hz"
    gravity_g = median_norm(values["gravity"])
    if len(rows) and not limits.GRAVITY_RANGE_G[0] <= gravity_g <= limits.GRAVITY_RANGE_G[1]:
        raise RecordingError(
            f"{table.where}: median |gravity| is {gravity_g:.4g}, but CoreMotion counts in g, so it must be 1; "
            "read it with format='generic_csv' and say the unit"
        )
    force_mps2 = -STANDARD_GRAVITY_MPS2 * (values["gravity"] + values["userAcceleration"])
    parsed.streams["accelerometer"] = (time_s, force_mps2)
    parsed.found.append("accelerometer: -9.80665 (gravity + userAcceleration), from g with iOS's sign")
    if "rotationRate" in values:
        parsed.streams["gyroscope"] = (time_s, values["rotationRate"])
        parsed.found.append("gyroscope: rotationRate, rad/s, sign as it is")
    if "attitude" in values:
        parsed.streams["attitude"] = (time_s, quaternion_of(*values["attitude"].T))
    return parsed.recording()


def quaternion_of(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Quaternions wxyz, sensor to world with z up, of CoreMotion's angles: R = Rz(yaw) Rx(pitch) Ry(roll)."""
    with np.errstate(invalid="ignore"):
        cr, sr = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
        cp, sp = np.cos(pitch_rad / 2), np.sin(pitch_rad / 2)
        cy, sy = np.cos(yaw_rad / 2), np.sin(yaw_rad / 2)
    # q_z(yaw) q_x(pitch) = (cy cp, cy sp, sy sp, sy cp); times q_y(roll) = (cr, 0, sr, 0)
    return np.column_stack(
        [
            cy * cp * cr - sy * sp * sr,
            cy * sp * cr - sy * cp * sr,
            sy * sp * cr + cy * cp * sr,
            sy * cp * cr + cy * sp * sr,
        ]
    )
