"""Conversion of published data sets to recordings with person, labels and ground truth.

Each function takes the folder of the raw files.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from pdr_filter.data.io.apps.indoor_location import read_indoor_location
from pdr_filter.data.io.files.archive import json_object
from pdr_filter.data.io.folders import recordings_in
from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_any_table
from pdr_filter.values import BoolArray, FloatArray, Table, limits, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Recording, Truth
from pdr_filter.values.safe_files import read_small
from pdr_filter.values.samples import Samples

_MIN_LEG_M = 5.0
# Corridors are parallel to the axes of the plan. The landmarks of a leg along a corridor deviate by less than this,
# those of a leg round a corner by at least 9 degrees.
_MAX_OFF_RAD = np.radians(5.0)
# Deviation of the force that marks the first step. The person begins to move half a second before it.
_SWING_MPS2, _BEFORE_S, _SETTLED_S = 2.0, 0.5, 0.3
# Walk whose folder has the landmarks of the route, for walks without a file of landmarks.
_ROUTES = {
    **dict.fromkeys(("straight", "weinberg_sequences/2f", "weinberg_sequences/3f"), "weinberg_sequences/1f"),
    **dict.fromkeys(("straight_reversed", *(f"weinberg_sequences/{n}r" for n in "123")), "weinberg_sequences/5r"),
}
_ACTIVITIES = {
    **{"dws": "downstairs", "ups": "upstairs", "wlk": "walking", "jog": "running"},
    **{"sit": "stationary", "std": "stationary"},
}


# Recordings of Di Fronzo with the phone that the odd experiments have, as experiment and person.
DIFRONZO = ("exp01_user01", "exp03_user01", "exp05_user03", "exp07_user03", "exp09_user05", "exp11_user07")
_DIFRONZO_HZ = 50.0  # no times are published
_DIFRONZO_CONTEXTS = {"1": "walking", "2": "upstairs", "3": "downstairs", "4": "stationary", "5": "stationary"}

# Places of the phone in the Oxford step counter data set, as carrying mode and placement.
_OXFORD_PLACES = {
    "InHand": ("texting", "in the hand in front of the body"),
    "SwingingArm": ("swinging", "in the hand of the swinging arm"),
    "FrontPocket": ("pocket", "front trouser pocket"),
    "BackPocket": ("pocket", "back trouser pocket"),
    "NeckPouch": ("chest", "pouch hanging from the neck"),
    "Purse": ("bag", "purse"),
    "Armband": ("", "arm band on the upper arm"),
}
OXFORD = tuple(f"{place}_{n}" for place in _OXFORD_PLACES for n in (range(1, 5) if place == "InHand" else (1, 2)))
# Two contacts of the same foot are at least 0.9 s apart, twice this time.
_SWITCH_BOUNCE_S = 0.45

# Motions of the smartphone benchmark of the Tyrex team, as context, carrying mode and placement.
_TYREX_MOTIONS = {
    "AR": ("", "texting", "held upright in front of the face and pointed around (augmented reality)"),
    "BackPocket": ("walking", "pocket", "back trouser pocket"),
    "FrontPocket": ("walking", "pocket", "front trouser pocket"),
    "Phoning": ("walking", "calling", "at the ear"),
    "RunningHand": ("running", "swinging", "in the hand while running"),
    "RunningPocket": ("running", "pocket", "trouser pocket while running"),
    "Swinging": ("walking", "swinging", "in the hand of the swinging arm"),
    "Texting": ("walking", "texting", "in the hand in front of the body, reading"),
}
# Times in s of the first and the last sustained motion, from the motion capture of each recording.
TYREX = {
    "Dist_AR": (2.839858, 122.823191),
    "Dist_BackPocket": (2.280052, 121.530052),
    "Dist_FrontPocket": (3.610940, 121.444274),
    "Dist_Phoning": (3.504714, 122.621381),
    "Dist_Swinging": (3.063257, 123.046590),
    "Dist_Texting": (2.290473, 122.273807),
    "NoDist_AR": (0.015119, 119.065119),
    "NoDist_BackPocket": (0.645638, 119.462304),
    "NoDist_FrontPocket": (6.727744, 119.261078),
    "NoDist_Phoning": (0.472173, 119.255506),
    "NoDist_RunningHand": (2.663565, 122.646898),
    "NoDist_RunningPocket": (3.071485, 123.054818),
    "NoDist_Swinging": (0.488520, 119.188520),
    "NoDist_Texting": (0.000903, 118.867569),
}


def as_found(raw: Path) -> Iterator[Recording]:
    """Yield the recordings of a folder as the readers find them, without further ground truth."""
    for path in recordings_in(raw):
        yield read(path)


def humolire(raw: Path) -> Iterator[Recording]:
    """Yield the walks of HuMoLIRe, with the passed landmarks and the straight parts between them as ground truth.

    RecordingError if a walk has another number of clicks than its route has landmarks.
    """
    walks = raw / "imus" / "1"
    for references in sorted(walks.rglob("references.txt")):
        folder = references.parent
        walk = folder.relative_to(walks).as_posix()
        recording = read(folder)
        zero_s = next(_rows(folder / "accelerometer-calibrated.txt"))[1]  # start of the sensor clock
        clicked_s = np.array([row[0] for row in _rows(references)]) - zero_s
        points_m = _landmarks(walks / _ROUTES.get(walk, walk) / "keypoints.json")
        if len(points_m) != len(clicked_s) + 1:
            raise RecordingError(
                f"{references}: {len(clicked_s)} clicks and {len(points_m) - 1} landmarks, but their numbers must be "
                "equal; report this to the maintainers of pdr_filter"
            )
        time_s = np.concatenate([[_begin_s(recording)], clicked_s])
        leg_m, begin_s, end_s = np.diff(points_m, axis=0), time_s[:-1], time_s[1:]
        length_m = np.linalg.norm(leg_m, axis=1)
        off_rad = np.abs((np.arctan2(leg_m[:, 1], leg_m[:, 0]) + np.pi / 4) % (np.pi / 2) - np.pi / 4)
        straight = (length_m >= _MIN_LEG_M) & (off_rad < _MAX_OFF_RAD)
        straight[0] = False  # the start of the first leg was not clicked
        truth = Truth(
            waypoints=_waypoints(time_s, points_m, 0.0),
            segments=table(
                {
                    "start_s": begin_s[straight],
                    "end_s": end_s[straight],
                    "distance_m": length_m[straight],
                    "n_steps": np.full(int(straight.sum()), np.nan),
                }
            ),
            labels=_label(time_s[0], time_s[-1], "walking", "texting"),
        )
        meta = {
            "subject": {"id": "user1", "height_m": 1.86, "age": 24, "gender": "M"},
            "placement": "in the hand in front of the body, screen up",
            "truth": "landmarks of the floor plan, clicked when passed",
        }
        yield _named(recording, f"humolire_user1_{folder.name}", truth, meta)


def motionsense(raw: Path) -> Iterator[Recording]:
    """Yield the recordings of the first twelve people of MotionSense. Figures in the documentation are for them."""
    people = {row["code"]: row for row in _csv(raw / "data_subjects_info.csv")}
    for path in sorted(raw.rglob("sub_*.csv")):
        code, trial = path.stem.removeprefix("sub_"), path.parent.name
        person, activity = people.get(code), trial.partition("_")[0]
        if person is None or int(code) > 12 or activity not in _ACTIVITIES:
            continue
        recording = read_any_table(path)
        end_s = float(recording.accelerometer.time_s[-1])
        meta = {
            "subject": {
                "id": f"s{int(code):02d}",
                "height_m": float(person["height"]) / 100,
                "weight_kg": float(person["weight"]),
                "age": float(person["age"]),
                "gender": "M" if person["gender"] == "1" else "F",
            },
            "device": "Apple iPhone 6s",
            "placement": "front trouser pocket",
            "truth": "one activity, no positions and no steps",
        }
        truth = Truth(labels=_label(0.0, end_s, _ACTIVITIES[activity], "pocket"))
        yield _named(recording, f"motionsense_s{int(code):02d}_{trial}", truth, meta)


def difronzo(raw: Path) -> Iterator[Recording]:
    """Yield the recordings of Di Fronzo with their activities.

    Rows before both sensors have started are zero and left out. Values have the digits with which the shipped models
    were trained. The labels are rows, counted from 0.
    """
    labels = [line.split() for line in read_small(raw / "labels.txt", limits.MAX_SMALL_BYTES).decode().splitlines()]
    for trial in DIFRONZO:
        number, person = (int(part[-2:]) for part in trial.split("_"))
        force, rate = (
            np.array(list(_rows(raw / f"{sensor}_{trial}.txt")), dtype=np.float64) for sensor in ("acc", "gyro")
        )
        n_rows = min(len(force), len(rate))
        first = int(np.argmax(force[:n_rows].any(axis=1) & rate[:n_rows].any(axis=1)))
        time_s = np.arange(n_rows - first) / _DIFRONZO_HZ
        rows = [row[2:] for row in labels if row and int(row[0]) == number]
        # the end of one label is printed as 159396 instead of 15939
        spans = [(int(begin), int(end) if int(end) <= n_rows else int(end) // 10) for _, begin, end in rows]
        begin_s, end_s = (np.array(spans).T - first) / _DIFRONZO_HZ
        contexts = [_DIFRONZO_CONTEXTS[activity] for activity, _, _ in rows]
        yield Recording(
            accelerometer=Samples(time_s, force[first:n_rows].round(4)),
            gyroscope=Samples(time_s, rate[first:n_rows].round(5)),
            name=f"difronzo_user{person:02d}_exp{number:02d}",
            truth=Truth(
                labels=table(
                    {"start_s": begin_s, "end_s": end_s, "context": contexts, "carrying_mode": ["pocket"] * len(rows)}
                )
            ),
            meta={"subject": {"id": f"user{person:02d}"}, "placement": "trouser pocket, top end down"},
        )


def ms_indoor(raw: Path) -> Iterator[Recording]:
    """Yield the walks of Indoor Location Competition 2.0 that have surveyed points of the floor plan."""
    for path in sorted(raw.glob("*/path_data_files/*.txt")):
        recording = read_indoor_location(path)
        waypoints = recording.truth.waypoints
        if waypoints is None:
            continue
        begin_s, end_s = max(0.0, float(waypoints["time_s"][0])), float(waypoints["time_s"][-1])
        meta = {"placement": "held flat in front of the body"}
        truth = replace(recording.truth, labels=_label(begin_s, end_s, "walking", "texting"))
        floor = path.parent.parent.name.lower()
        yield _named(recording, f"ms_indoor_anon_site1_{floor}_{path.stem}", truth, meta)


def oxford(raw: Path) -> Iterator[Recording]:
    """Yield the walks of the Oxford step counter data set with the Pixel phone, with the steps of foot switches."""
    for walk in OXFORD:
        folder = raw / f"Pixel_Jamie_Hard_{walk}"
        force, feet = (
            np.loadtxt(read_small(folder / f"{name}.csv", limits.MAX_MEMBER_BYTES).decode().splitlines(), delimiter=",")
            for name in ("accelerometer", "stepcounter")
        )
        steps_s = _switch_closings((feet[:, 0] - force[0, 0]) / 1e9, feet[:, 1:] > 0)
        carrying_mode, placement = _OXFORD_PLACES[walk.partition("_")[0]]
        yield Recording(
            accelerometer=Samples((force[:, 0] - force[0, 0]) / 1e9, force[:, 2:]),
            name=f"oxford_jamie_pixel_hard_{walk.lower()}",
            truth=Truth(
                steps=table({"time_s": steps_s}), labels=_label(steps_s[0], steps_s[-1], "walking", carrying_mode)
            ),
            meta={
                "subject": {"id": "jamie"},
                "device": "Google Pixel",
                "placement": placement,
                "truth": "switches under both feet, read about every 0.1 s",
            },
        )


def _switch_closings(time_s: FloatArray, is_closed: BoolArray) -> FloatArray:
    """Return the times in s at which one of two foot switches closes.

    `is_closed` (N, 2) are the switches at N times. A switch that closes again soon, before the other one does, bounces
    and is left out.
    """
    found: list[tuple[float, int]] = []
    for row, foot in np.argwhere(is_closed[1:] & ~is_closed[:-1]).tolist():
        at_s = float(time_s[row + 1])
        if not (found and found[-1][1] == foot and at_s - found[-1][0] < _SWITCH_BOUNCE_S):
            found.append((at_s, foot))
    return np.array([at_s for at_s, _ in found])


def tyrex(raw: Path) -> Iterator[Recording]:
    """Yield the recordings of one person with a Nexus 5 from the smartphone benchmark of the Tyrex team.

    The labels span the motion. The positions of the motion capture are not converted.
    """
    for trial, (begin_s, end_s) in TYREX.items():
        folder = raw / f"Thibaud_Nexus5_{trial}"
        force, rate = (
            np.array(list(_rows(folder / f"{sensor}.txt"))) for sensor in ("accelerometer", "gyroscope-calibrated")
        )
        context, carrying_mode, placement = _TYREX_MOTIONS[trial.partition("_")[2]]
        yield Recording(
            accelerometer=Samples(force[:, 0] - force[0, 0], force[:, 1:]),
            gyroscope=Samples(rate[:, 0] - force[0, 0], rate[:, 1:]),
            name=f"tyrex_thibaud_nexus5_{trial.lower()}",
            truth=Truth(labels=_label(begin_s, end_s, context, carrying_mode)),
            meta={"subject": {"id": "thibaud"}, "device": "LG Nexus 5", "placement": placement},
        )


def humolire_plan(raw: Path) -> dict[str, Any]:
    """Return the walls of the floor of HuMoLIRe, in metres in the frame of the landmarks.

    The source has pixels of a picture of height 915, with y downwards.
    """
    path = raw / "maps" / "map_data.json"
    content = json_object(read_small(path, limits.MAX_WHOLE_BYTES), str(path))
    scale_m = float(content["scale"])

    def at(node: dict[str, float]) -> list[float]:
        return [round(scale_m * node["x"], 3), round(scale_m * (915 - node["y"]), 3)]

    walls = [[at(link["node0"]), at(link["node1"])] for link in cast("list[dict[str, Any]]", content["links"])]
    features = [
        {
            "type": "Feature",
            "properties": {"type": "wall"},
            "geometry": {"type": "LineString", "coordinates": wall},
        }
        for wall in walls
    ]
    frame = "metres, x east_m and y north_m of the waypoints of humolire; north not known"
    return {"type": "FeatureCollection", "properties": {"frame": frame}, "features": features}


def _named(recording: Recording, name: str, truth: Truth, meta: dict[str, Any]) -> Recording:
    """Return the recording with another name, ground truth and additional metadata."""
    return replace(recording, name=name, truth=truth, meta={**recording.meta, **meta})


def _waypoints(time_s: FloatArray, points_m: FloatArray, floor: float) -> Table:
    """Return a table of waypoints on one floor."""
    east_m, north_m = points_m.T
    return table({"time_s": time_s, "east_m": east_m, "north_m": north_m, "floor": np.full(len(time_s), floor)})


def _label(begin_s: float, end_s: float, context: str, carrying_mode: str) -> Table:
    """Return a table of labels with one row: context and carrying mode between two times in s."""
    row = {"start_s": begin_s, "end_s": end_s, "context": context, "carrying_mode": carrying_mode}
    return table({name: [value] for name, value in row.items()})


def _begin_s(recording: Recording) -> float:
    """Return the time in s at which the person begins to move: half a second before the force first swings.

    The result is 0 if the force never swings by more than 2 m/s2.
    """
    force = recording.accelerometer
    swing = np.abs(np.linalg.norm(force.values, axis=1) - np.median(np.linalg.norm(force.values, axis=1)))
    moving = (swing > _SWING_MPS2) & (force.time_s > _SETTLED_S)
    return max(0.0, float(force.time_s[np.argmax(moving)]) - _BEFORE_S)


def _landmarks(path: Path) -> FloatArray:
    """Return the starting position and the landmarks in the order of the route, (N, 2)."""
    content = json_object(read_small(path, limits.MAX_SMALL_BYTES), str(path))
    points = [content["starting_position"], *(content[str(i)] for i in range(int(content["count"])))]
    return np.array([[point["x"], point["y"]] for point in points], dtype=float)


def _rows(path: Path) -> Iterator[list[float]]:
    """Iterate over the lines of a text file that begin with a digit or a sign, as lists of numbers."""
    lines = read_small(path, limits.MAX_MEMBER_BYTES).decode("utf-8", "replace").splitlines()
    return (list(map(float, line.split())) for line in lines if line[:1].isdigit() or line[:1] == "-")


def _csv(path: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file."""
    return list(csv.DictReader(read_small(path, limits.MAX_SMALL_BYTES).decode("utf-8-sig").splitlines()))
