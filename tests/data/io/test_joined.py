"""Recordings that were cut in time are joined to the whole one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from app_files import assert_same_streams, axes, on_one_clock, table_text, write_text

import pdr_filter as pdr
from pdr_filter.values import Wifi, table
from pdr_filter.values.errors import RecordingError
from pdr_filter.values.recording import Truth

EPOCH_S = 1_700_000_000.0


def whole() -> pdr.Recording:
    walk = on_one_clock(pdr.simulate.simulate([pdr.simulate.Leg("walking", distance_m=20.0)], rate_hz=50.0))
    wifi = Wifi([1.0, 9.0], [11, 12], [-50.0, -60.0], [2412.0, 2412.0])
    return replace(walk, wifi=wifi, meta={**walk.meta, "epoch_s": EPOCH_S})


def part(walk: pdr.Recording, begin_s: float, end_s: float) -> pdr.Recording:
    """The samples, Wi-Fi and true steps from one time to another, on a clock that begins there."""

    def cut(samples: pdr.Samples) -> pdr.Samples:
        is_in = (samples.time_s >= (begin_s or -1.0)) & (samples.time_s < end_s)
        return pdr.Samples(samples.time_s[is_in] - begin_s, samples.values[is_in])

    heard = (walk.wifi.time_s >= begin_s) & (walk.wifi.time_s < end_s)
    columns = (walk.wifi.bssid, walk.wifi.rssi_dbm, walk.wifi.frequency_mhz)
    steps = walk.truth.steps
    is_in = (steps["time_s"] >= begin_s) & (steps["time_s"] < end_s)
    return replace(
        walk,
        **{name: cut(samples) for name, samples in walk.streams.items()},
        wifi=Wifi(walk.wifi.time_s[heard] - begin_s, *(column[heard] for column in columns)),
        truth=Truth(steps=table({"time_s": steps["time_s"][is_in] - begin_s})),
        meta={**walk.meta, "epoch_s": EPOCH_S + begin_s},
    )


def test_parts_in_any_order_are_the_whole_with_its_wifi_and_truth(tmp_path: Path) -> None:
    walk = whole()
    paths = [
        part(walk, begin_s, end_s).save(tmp_path / f"{begin_s}.zip")
        for begin_s, end_s in ((5.0, 9.0), (9.0, 99.0), (0.0, 5.0))
    ]
    joined = pdr.read(paths)
    assert_same_streams(joined, walk, "accelerometer gyroscope magnetometer", time_s=2e-6, rtol=1e-6)
    np.testing.assert_allclose(joined.wifi.time_s, walk.wifi.time_s, atol=1e-6)
    np.testing.assert_allclose(joined.truth.steps["time_s"], walk.truth.steps["time_s"], atol=2e-6)
    assert joined.epoch_s == EPOCH_S
    assert pdr.track(joined).n_steps == pdr.track(walk).n_steps


def of_phone(values: list[float]) -> pdr.Samples:
    return pdr.Samples([1.0, 4.0], [[value] for value in values])


@pytest.mark.parametrize(("later", "n_steps"), [([2.0, 7.0], 16), ([11.0, 16.0], 16)], ids=["reset", "continues"])
def test_steps_heading_and_annotations_of_parts_are_those_of_the_whole(
    tmp_path: Path, later: list[float], n_steps: int
) -> None:
    walk = whole()
    paths = [
        replace(
            part(walk, begin_s, end_s),
            meta={"epoch_s": EPOCH_S + begin_s} | marks,
            phone_step_count=of_phone(counts),
            phone_heading=of_phone(headings),
        ).save(tmp_path / f"{begin_s}.zip")
        for begin_s, end_s, counts, headings, marks in (
            (5.0, 99.0, later, [0.2, 0.3], {"annotations": [{"time_s": 2.5, "text": "b"}]}),
            (0.0, 5.0, [4.0, 9.0], [0.1, 0.2], {"annotations": [{"time_s": 1.5, "text": "a"}]}),
        )
    ]
    joined = pdr.read(paths)
    assert joined.phone_steps == n_steps
    assert joined.phone_heading.values[:, 0].tolist() == [0.1, 0.2, 0.2, 0.3]
    assert joined.meta["annotations"] == [{"time_s": 1.5, "text": "a"}, {"time_s": 7.5, "text": "b"}]
    uncounted = replace(part(walk, 5.0, 99.0), meta={"epoch_s": EPOCH_S + 5.0}).save(tmp_path / "uncounted.zip")
    assert pdr.read([paths[1], uncounted]).phone_steps is None


def test_parts_that_overlap_or_have_no_unix_time_are_refused(tmp_path: Path) -> None:
    walk = whole()
    first, late = (part(walk, *span).save(tmp_path / f"{span[0]}.zip") for span in ((0.0, 6.0), (3.0, 9.0)))
    with pytest.raises(RecordingError, match=r"begins 3\.0 s before the end of .*; read them one by one"):
        pdr.read([first, late])
    columns = {"time": walk.accelerometer.time_s} | axes("acc%", walk.accelerometer.values)
    without = write_text(tmp_path / "walk.csv", table_text(columns))
    with pytest.raises(RecordingError, match=r"walk\.csv: its times are not since 1970"):
        pdr.read([first, without])
    with pytest.raises(ValueError, match="no recordings to join"):
        pdr.read([])
