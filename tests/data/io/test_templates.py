"""The mapping that a refusal prints reads the file, once a person has filled in what the values do not show."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from app_files import assert_same_streams, axes, refusal, table_text, wall_clock, write_folder, write_text, write_zip
from oddities import counts, with_marks
from table_cases import FORCE, RATE, TIME_S, WALK

from pdr_filter.data.io.formats import read
from pdr_filter.data.io.tables.any_table import read_mapped
from pdr_filter.data.io.tables.column_mapping import read_mapping
from pdr_filter.values import STANDARD_GRAVITY_MPS2

N = len(TIME_S)
BOTH = "accelerometer gyroscope"
MS = {"jetzt": 1_700_000_000_000 + np.round(1000 * TIME_S)}


def unknown(force: np.ndarray = FORCE, rate: np.ndarray = RATE) -> dict[str, np.ndarray]:
    return axes("eins_%", force) | axes("zwei_%", rate)


def in_two_files(names: tuple[str, str]) -> dict[str, str]:
    tables = (table_text(MS | axes("spur_%", values)) for values in (FORCE, RATE))
    return dict(zip(names, tables, strict=True))


def empatica() -> str:
    """The time of the start, the rate, and then counts, 64 for one g."""
    rows = np.round(64 * FORCE / STANDARD_GRAVITY_MPS2).astype(int)
    return "1489661000.0, 1489661000.0, 1489661000.0\n50.0, 50.0, 50.0\n" + "".join(
        f"{x},{y},{z}\n" for x, y, z in rows
    )


def json_text() -> str:
    rows = zip(TIME_S.tolist(), FORCE.tolist(), strict=True)
    return "".join(f'{{"wann": {t}, "was": {{"i": {f[0]}, "j": {f[1]}, "k": {f[2]}}}}}\n' for t, f in rows)


Files = Callable[[], str | Mapping[str, str]]
# What a person changes in the template, the streams that come back, and the error of the values.
CASES: dict[str, tuple[Files, dict[str, str], str, float]] = {
    "columns that nobody knows": (lambda: table_text(MS | unknown()), {}, "accelerometer", 1e-6),
    "quotation marks in names": (
        lambda: table_text({f'""{k}""': v for k, v in (MS | unknown()).items()}).replace('""', '""""'),
        {},
        "accelerometer",
        1e-6,
    ),
    "names in another script": (lambda: table_text(MS | axes("\u4f60_%", FORCE)), {}, "accelerometer", 1e-6),
    "g": (lambda: table_text(MS | unknown(FORCE / STANDARD_GRAVITY_MPS2)), {}, "accelerometer", 1e-6),
    "dates": (lambda: table_text({"jetzt": wall_clock(TIME_S)} | unknown()), {}, "accelerometer", 1e-6),
    "no names, two clocks": (lambda: with_marks("", "7,{t:.4f},{f[0]},{f[1]},{f[2]}\n"), {}, "accelerometer", 1e-6),
    "no times": (lambda: table_text(unknown()), {'column = "?", unit = "s"': "rate_hz = 50"}, "accelerometer", 1e-6),
    "no times, known names": (
        lambda: table_text(axes("acc_%", FORCE) | axes("gyro_%", RATE)),
        {'column = "?", unit = "s"': "rate_hz = 50"},
        BOTH,
        1e-6,
    ),
    "no times, known names with a unit": (
        lambda: table_text(axes("acc_%", FORCE) | axes("gyro_%_dps", np.degrees(RATE))),
        {'column = "?", unit = "s"': "rate_hz = 50"},
        BOTH,
        1e-6,
    ),
    "an accelerometer under other names": (
        lambda: table_text({"t": TIME_S} | axes("f%", FORCE) | axes("gyro_%", RATE)),
        {},
        "accelerometer",
        1e-6,
    ),
    "counts": (counts, {'"?"': "16.4"}, BOTH, 5e-3),
    "start and rate in rows": (empatica, {}, "accelerometer", 2e-2),
    "accelerometer.csv": (lambda: in_two_files(("accelerometer.csv", "gyroscope.csv")), {}, "accelerometer", 1e-6),
    "two files": (lambda: in_two_files(("eins.csv", "zwei.csv")), {}, "accelerometer", 1e-6),
    "json": (lambda: {"walk.json": json_text()}, {}, "accelerometer", 1e-6),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("packed", [False, True])
def test_a_template_reads_its_file_when_it_is_filled_in(tmp_path: Path, case: str, packed: bool) -> None:
    files, changes, streams, rtol = CASES[case]
    content = files()
    content = {"walk.csv": content} if isinstance(content, str) else content
    path = write_folder(tmp_path / "walk", content)
    if packed:
        path = write_zip(tmp_path / "walk.zip", content)
    elif len(content) == 1:
        path = path / next(iter(content))
    message = refusal(path)
    assert f"pdr-filter convert {path} --map MAP.toml:\n" in message
    is_alone = path.suffix in (".csv", ".json")
    assert ("save it as walk.toml beside the file" in message) == is_alone
    text = message.partition("MAP.toml:\n")[2].partition("\n(read as")[0]
    assert 'sign = "?"' in text
    text = text.replace('sign = "?"', "sign = 1")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    assert "?" not in text
    found = read_mapped(path, read_mapping(write_text(tmp_path / "map.toml", text)))
    assert_same_streams(found, WALK, streams, time_s=3e-2, rtol=rtol)
    if is_alone:
        write_text(path.with_suffix(".toml"), text)
        assert_same_streams(read(path), WALK, streams, time_s=3e-2, rtol=rtol)


@pytest.mark.parametrize("names", ["a_%_u w_%", "acc_%_u ang_%"])
@pytest.mark.parametrize(("unit", "scale"), [("g", STANDARD_GRAVITY_MPS2), ("m/s2", 1.0)])
def test_columns_whose_names_share_a_word_are_the_accelerometer(
    tmp_path: Path, names: str, unit: str, scale: float
) -> None:
    """More names have one length if an axis of the gyroscope takes the place of the first one."""
    of_force, of_rate = names.split()
    sides = ("rechts", "vorn", "hoch")
    force = {of_force.replace("%", side): FORCE[:, i] / scale for i, side in enumerate(sides)}
    rate = {of_rate.replace("%", side): RATE[:, i] + 0.1 for i, side in enumerate(sides)}
    message = refusal(write_text(tmp_path / "walk.csv", table_text(MS | force | rate)))
    assert f"accelerometer = {{ columns = {list(force)}, unit = '{unit}'".replace("'", '"') in message


@pytest.mark.parametrize("scale", [4096 / STANDARD_GRAVITY_MPS2, 1.0])
def test_without_names_the_columns_behind_the_clock_are_the_accelerometer(tmp_path: Path, scale: float) -> None:
    """The first axis is level, and the next column, a gyroscope that turns, is as constant."""
    force = scale * np.column_stack([0 * TIME_S, FORCE[:, 1:]])
    text = table_text({"jetzt": 1000 * TIME_S} | axes("eins_%", force) | axes("zwei_%", RATE + 0.1 * scale))
    message = refusal(write_text(tmp_path / "walk.csv", text.partition("\n")[2]))
    assert 'accelerometer = { columns = ["column 2", "column 3", "column 4"]' in message


def test_a_template_that_is_given_as_it_stands_is_refused_with_what_is_missing(tmp_path: Path) -> None:
    path = write_text(tmp_path / "walk.csv", counts())
    template = refusal(path).partition("MAP.toml:\n")[2]
    write_text(tmp_path / "walk.toml", template)
    assert "[accelerometer] sign is '?'; write 1, or -1 if a phone lying face up reads negative on z" in refusal(path)
    write_text(tmp_path / "walk.toml", template.replace('sign = "?"', "sign = 1"))
    assert "counts_per_unit is '?'; write the positive number" in refusal(path)


def test_the_scale_of_a_gyroscope_that_counts_is_the_one_by_which_gravity_turns(tmp_path: Path) -> None:
    """The phone turns about an axis across gravity, a degree each second, and counts 131 for it."""
    time_s = np.arange(0.0, 60.0, 0.02)
    angle = np.radians(30.0) * np.sin(2 * np.pi * time_s / 20.0)
    rate = np.radians(30.0) * 2 * np.pi / 20.0 * np.cos(2 * np.pi * time_s / 20.0)
    up = np.column_stack([np.zeros_like(angle), np.sin(angle), np.cos(angle)])
    force = axes("Ac%", np.round(16384 * up))
    turns = np.column_stack([rate, 0 * rate, 0 * rate])
    text = table_text({"millis": 1000 * time_s} | force | axes("Gy%", np.round(131 * np.degrees(turns))))
    message = refusal(write_text(tmp_path / "walk.csv", text))
    assert re.search(r'accelerometer = .*"Acz"\], unit = "g", counts_per_unit = 16384, sign = "\?"', message)
    assert re.search(r'gyroscope = .*"Gyz"\], unit = "deg/s", counts_per_unit = 131 ', message)
