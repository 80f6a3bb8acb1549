"""GetSensorData (LOPSI, CAR-CSIC) and the logs of the IPIN competitions: one text file, a type in every line.

Layout after the header that the app writes into each log (surprising cases in docs/robustness.md):

- `ACCE;AppTimestamp(s);SensorTimestamp(s);Acc_X(m/s^2);Acc_Y(m/s^2);Acc_Z(m/s^2);Accuracy(integer)`, others likewise;
  AHRS holds pitch, roll, yaw in degrees and the vector part of the rotation vector.
- `POSI;Timestamp(s);Counter;Latitude(degrees);Longitude(degrees);floor ID;Building ID` is on the app's clock.
- The sensor's time is right for integration; the app's jitters, but is common to all types. So a stream keeps its
  sensor's intervals and is moved as a whole to the app's clock.
"""

from __future__ import annotations

import math
import re
from functools import partial
from pathlib import Path

import numpy as np

from pdr_filter.data.io.apps.tagged_lines import TaggedLog, rotation_vector_quaternion
from pdr_filter.data.io.assemble import Parsed
from pdr_filter.data.io.describe import median_norm
from pdr_filter.data.io.files.archive import open_members, read_toml
from pdr_filter.data.io.text_table import Layout, NumberTable
from pdr_filter.data.io.wifi_rows import heard_s, lines_of_log
from pdr_filter.values import STANDARD_GRAVITY_MPS2, FloatArray, limits
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording
from pdr_filter.values.safe_files import beside

# First the time of the app and of the sensor, then the values.
LAYOUTS = {
    **dict.fromkeys(("ACCE", "GYRO", "MAGN"), Layout((1, 2, 3, 4, 5), separator=";")),
    **dict.fromkeys(("PRES", "LIGH", "PROX"), Layout((1, 2, 3), separator=";")),
    "AHRS": Layout((1, 2, 6, 7, 8), separator=";"),
    "GNSS": Layout((1, 2, 3, 4, 5, 7), separator=";"),
    "POSI": Layout((1, 3, 4, 5, 6), separator=";"),
    "WIFI": Layout((0, 1, 2, 3, 4), separator=";"),  # as rewritten: time of the app and sensor, address, dBm, MHz
}
# WIFI;AppTimestamp(s);SensorTimestamp(s);Name_SSID;MAC_BSSID;RSS(dBm), and in newer logs the frequency.
_WIFI = rb"^WIFI;([-+.\d]{1,30});([-+.\d]{1,30});.*;(ADDRESS);(-?\d{1,4})(?:;(\d{1,6}))?;?\r?$"
STREAM = {
    "ACCE": "accelerometer",
    "GYRO": "gyroscope",
    "MAGN": "magnetometer",
    "PRES": "barometer",
    "LIGH": "light",
    "PROX": "proximity",
    "AHRS": "attitude",
}
# The rates of the two clocks differ by less: the app's time jitters by 0.1 s at both ends of some seconds.
CLOCKS_AGREE = 0.02
SHORTEST_CHECKED_S = 20.0
# Sensors of one phone whose offset to the app's clock differs by less are on one clock: their lateness differs.
ONE_CLOCK_S = 0.5


def is_get_sensor_data(head: bytes) -> bool:
    """Return True if a text begins like a log of GetSensorData, judged by its first bytes."""
    return re.search(rb"(?m)^(ACCE|GYRO|MAGN|POSI|AHRS);[-+\d.]+;", head) is not None or b"'ACCE;AppTimestamp" in head


def read_get_sensor_data(path: str | Path) -> Recording:
    """Return the recording in a log of GetSensorData; reference positions become `truth.waypoints`.

    RecordingError if the values contradict the declared unit, or the clocks of app and sensor each other.
    """
    path = Path(path)
    parsed = Parsed(path, "GetSensorData")
    with open_members(path) as members:
        log = TaggedLog(members, "%")
        where = log.where
        _check_columns(log.header, where)
        tables, _ = log.tables(LAYOUTS, 0, parsed.notes, {"WIFI": partial(lines_of_log, _WIFI, b";")})
    if "ACCE" not in tables:
        raise RecordingError(
            f"{where}: no ACCE lines (found: {', '.join(tables) or 'none'}); record the accelerometer, too"
        )
    about = log.header_values()
    parsed.set_device(about.get("Manufacturer"), about.get("Model"))
    version = next((line for line in log.header if line.startswith("Version")), "")
    parsed.source += f", {version[:60]}" if version else ""
    offset_s = _clock_offset_s(tables["ACCE"].values, "ACCE", where, parsed.notes)
    for tag, stream in STREAM.items():
        if tag in tables:
            time_s = _times(tables[tag], tag, offset_s, where, parsed.notes)
            values = tables[tag].values[:, 2:]
            parsed.streams[stream] = (time_s, rotation_vector_quaternion(values) if tag == "AHRS" else values)
    _check_unit(parsed, where)
    if "GNSS" in tables:  # with satellite time as sensor time
        parsed.streams["location"] = (tables["GNSS"].values[:, 0], tables["GNSS"].values[:, 2:])
    if "WIFI" in tables:
        app_s, sensor_s, *_ = tables["WIFI"].values.T
        parsed.wifi = (heard_s(app_s, sensor_s + offset_s, parsed.notes), tables["WIFI"].values[:, 2:])
    if "POSI" in tables:
        _read_positions(tables["POSI"].values, parsed)
    parsed.clock = (
        "intervals of each sensor's own clock, moved to the app's clock; reference positions are on the app's clock"
    )
    return parsed.recording()


def _check_columns(header: list[str], where: str) -> None:
    """Refuse a log whose header states a single time per line, because all other columns are then shifted."""
    for line in header:
        declared = re.search(r"'ACCE;([^']*)'", line)
        if declared and "SensorTimestamp" not in declared[1]:
            raise RecordingError(
                f"{where}: ACCE lines have no SensorTimestamp (header: {declared[1][:60]!r}); "
                "log with version 2 of the app, or read it with format='generic_csv'"
            )


def _clock_offset_s(values: FloatArray, tag: str, where: str, notes: list[str]) -> float:
    """Return the median difference of app time and sensor time in s, or NaN if it is unknown.

    `values` (N, d) begin with both times. RecordingError if the rates of the two clocks differ.
    """
    known = np.isfinite(values[:, :2]).all(axis=1)
    app_s, sensor_s = values[known, 0], values[known, 1]
    if len(app_s) < 2:
        return math.nan
    if np.ptp(sensor_s) == 0:
        notes.append(f"{tag}: the sensor's time stands still, so the app's is used; it jitters")
        return math.nan
    span_s = float(np.ptp(app_s))
    ratio = float(np.ptp(sensor_s)) / span_s if span_s > 0 else math.inf
    if span_s > SHORTEST_CHECKED_S and abs(ratio - 1) > CLOCKS_AGREE:
        raise RecordingError(
            f"{where}: in the {tag} lines the sensor's time runs {ratio:.4g} times as fast as the app's; "
            "both are in seconds in this format, so convert the column that is not, or cut the log where a clock jumps"
        )
    return float(np.median(app_s - sensor_s))


def _times(table: NumberTable, tag: str, reference_s: float, where: str, notes: list[str]) -> FloatArray:
    own_s = _clock_offset_s(table.values, tag, where, notes) if tag != "ACCE" else reference_s
    if math.isnan(own_s):
        return table.values[:, 0]
    offset_s = reference_s if abs(own_s - reference_s) < ONE_CLOCK_S else own_s
    return table.values[:, 1] + offset_s


def _check_unit(parsed: Parsed, where: str) -> None:
    time_s, values = parsed.streams["accelerometer"]
    unit = _unit_beside(parsed.path)
    median = median_norm(values)
    if unit == "g":
        parsed.streams["accelerometer"] = (time_s, values * STANDARD_GRAVITY_MPS2)
        parsed.found.append("accelerometer: g, as the TOML file beside the log says, although the log declares m/s^2")
    elif unit == "" and limits.G_RANGE[0] <= median <= limits.G_RANGE[1]:
        raise RecordingError(
            f"{where}: ACCE lines should be in m/s^2, but the median |a| is {median:.4g}, which looks like g; if so, "
            f'write accelerometer_unit = "g" into {parsed.path.with_suffix(".toml").name} beside it'
        )
    else:
        parsed.found.append(f"accelerometer: m/s2, Android's sign; median {median:.2f}")


def _unit_beside(path: Path) -> str:
    """Return the unit of the accelerometer, "g" or "m/s2", in the TOML file of the log, or ""."""
    toml = beside(path, path.with_suffix(".toml").name)
    if path.is_dir() or toml == path or not toml.is_file():
        return ""
    unit = read_toml(toml).get("accelerometer_unit", "")
    if unit not in ("", "g", "m/s2"):
        raise RecordingError(f'{toml}: accelerometer_unit is {unit!r}; write "g" or "m/s2"')
    return unit


def _read_positions(values: FloatArray, parsed: Parsed) -> None:
    """Store the reference positions in `parsed`, as metres east and north of the first valid one."""
    import pymap3d

    known = np.isfinite(values[:, :3]).all(axis=1) & (np.abs(values[:, 1]) <= 90) & (np.abs(values[:, 2]) <= 180)
    if not known.all():
        parsed.notes.append(f"POSI: {int((~known).sum())} positions are no latitude and longitude, left out")
    values = values[known]
    if len(values) == 0:
        return
    origin = (float(values[0, 1]), float(values[0, 2]))
    east_m, north_m, _ = pymap3d.geodetic2enu(values[:, 1], values[:, 2], 0.0, *origin, 0.0)
    parsed.truth["waypoints"] = {
        "time_s": values[:, 0],
        "east_m": np.asarray(east_m, dtype=float),
        "north_m": np.asarray(north_m, dtype=float),
        "floor": values[:, 3],
    }
    parsed.meta["origin"] = {"latitude_deg": origin[0], "longitude_deg": origin[1]}
    parsed.meta["truth"] = "reference positions that the surveyor marked (POSI lines), on the app's clock"
