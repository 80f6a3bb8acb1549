"""Real files of phone apps, as their owners left them: read or refused correctly, steps, units and axes.

usage: python -m tests.benchmarks.app_files [--files FOLDER]

`Gravity` is the constant part of the accelerometer, which is 1 if its unit is right; `turning` is how far gravity turns
in the phone against what the gyroscope says, which is 1 if unit and axes of both agree, where it can be seen.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pdr_filter as pdr
from pdr_filter.data.io.describe import reading_report
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.tables.column_values import constant_part, turning
from pdr_filter.values import STANDARD_GRAVITY_MPS2
from pdr_filter.values.errors import RecordingError
from tests.benchmarks.common import DATA, ROOT, Tables, run


@dataclass(frozen=True)
class Known:
    """What is right for a file."""

    path: str
    app: str  # how the report names it
    steps: str = ""  # counted by the walker, or what is known of the walk
    refusal: str = ""  # words of the right reason; empty if it must be read
    reason: str = ""  # the same, for people


FILES = (
    Known("sensor_logger/walk_with_gps_android_1_12.zip", "Sensor Logger", "a walk of 12 min"),
    Known("sensor_logger/handled_20_s_ios.zip", "Sensor Logger", "0, handled"),
    Known("sensor_logger/accelerometer_only.zip", "Sensor Logger", "some seconds"),
    Known("sensor_logger/export.json", "Sensor Logger", "8 s"),
    Known("sensor_logger/http_push.json", "Sensor Logger", "", "put all messages", "one message of many"),
    Known("sensor_logger/without_metadata", "Sensor Logger", "", "names no platform", "no platform, without gravity"),
    Known("phyphox/45_steps", "phyphox", "45"),
    Known("phyphox/157_steps", "phyphox", "157"),
    Known("phyphox/closed_loop_with_gps", "phyphox", "a closed loop"),
    Known("phyphox/gait_lab", "phyphox", "walking"),
    Known("phyphox/columns_t_x_y_z", "table", "walking"),
    Known("phyphox/columns_timestamps", "table", "", "does not increase", "times rounded to three digits, 4 Hz"),
    Known("phyphox/linear_acceleration_only", "phyphox", "", "nobody walks", "without gravity, nobody walks"),
    Known("androsensor/data.csv", "AndroSensor", "", "a rate of 2 Hz", "2 Hz"),
    Known("androsensor/record.csv", "AndroSensor", "", "a rate of 2 Hz", "2 Hz"),
    Known("hyperimu/with_timestamp.csv", "HyperIMU", "3 s, shaken"),
    Known("hyperimu/without_timestamp.csv", "HyperIMU", "1 s"),
    Known("physics_toolbox/blank_first_line_g.csv", "Physics Toolbox", "in the hand"),
    Known("physics_toolbox/clock_times_pocket.csv", "Physics Toolbox", "in a pocket"),
    Known("physics_toolbox/hand_114.csv", "Physics Toolbox", "in the hand, without gravity"),
    Known("matlab_mobile/80_steps_pocket.csv", "MATLAB Mobile", "80"),
    Known("matlab_mobile/80_steps_pocket.mat", "MATLAB Mobile", "80"),
    Known("matlab_mobile/250_steps_hand.csv", "MATLAB Mobile", "250"),
    Known("matlab_mobile/250_steps_hand.mat", "MATLAB Mobile", "250"),
    Known("sensorlog_hcu/EightExperiment.zip", "table", "a figure of eight"),
    Known("senslogs/Nexus5_Dist_AR.zip", "senslogs", "hardly any"),
    Known("other/data.xlsx", "table", "walking"),
    Known("other/two_csv_of_an_android_logger.zip", "table", "none, at rest"),
)


@dataclass(frozen=True)
class Row:
    """What came of a file."""

    what: str
    is_right: bool
    steps: str = ""
    gravity: str = ""
    turning: str = ""

    def cells(self, known: Known) -> list[str]:
        """A row of the table."""
        right = "yes" if self.is_right else "NO"
        return [known.path, known.app, self.what, right, self.steps, known.steps, self.gravity, self.turning]


def row_of(known: Known, folder: Path, with_steps: bool = True) -> Row:
    """What comes of a file, and whether that is right."""
    path = folder / known.path
    one = recordings_in(path) == [path]
    try:
        recording = pdr.read(path)
    except RecordingError as error:
        words = str(error)
        # A refusal is right if it gives the reason and never asks for what is there or calls the file a broken zip.
        is_right = (
            bool(known.refusal) and known.refusal in words and "not a zip" not in words and "add that" not in words
        )
        return Row(f"refused: {known.reason}", is_right)
    force, gyroscope = recording.accelerometer, recording.gyroscope
    gravity = constant_part(force.time_s, force.values) / STANDARD_GRAVITY_MPS2
    factor = None
    if gyroscope is not None:
        factor = turning(force.time_s, force.values, gyroscope.time_s, gyroscope.values)
    is_right = not known.refusal and known.app in reading_report(recording).source and one and 0.7 < gravity < 1.4
    steps = str(pdr.track(recording).n_steps) if with_steps else ""
    return Row("read", is_right, steps, f"{gravity:.2f}", "" if factor is None else f"{factor:.2f}")


def app_files(tables: Tables, arguments: argparse.Namespace) -> None:
    """One row for each file."""
    found = [row_of(known, arguments.files) for known in FILES]
    rows = [row.cells(known) for row, known in zip(found, FILES, strict=True)]
    columns = ["file", "app", "what happens", "right", "steps", "walker's count", "gravity", "turning"]
    n_right = sum(row.is_right for row in found)
    about = f"{n_right} of {len(rows)} files are read or refused correctly."
    tables.write("app_files", columns, rows, about)


_LONGEST = 300


def shown(sentence: str) -> str:
    """A sentence as a cell, cut behind a word."""
    words = sentence.partition("\n")[0].replace("|", "/")
    return words if len(words) <= _LONGEST else f"{words[:_LONGEST].rpartition(' ')[0]} ..."


def odd_tables(tables: Tables, arguments: argparse.Namespace) -> None:
    """Write for each kind of odd table how the reader treats it, and its note."""
    sys.path.insert(0, str(ROOT / "tests" / "data" / "io"))
    from oddities import ODDITIES

    rows: list[list[str]] = []
    for oddity in ODDITIES:
        with tempfile.TemporaryDirectory() as folder:
            rows.append([oddity.kind, oddity.done, shown(oddity.sentence(oddity.write(Path(folder))))])
    tables.write("oddities", ["kind of oddity", "treatment", "note or refusal"], rows)


if __name__ == "__main__":
    run(__doc__, app_files, odd_tables, files=DATA.parent / "app_files")
