"""Command `pdr-filter convert`: guessed mapping with its evidence, recording, and protection of existing files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import refusal, succeed

from pdr_filter.data.io.formats import read

TIME_S = np.arange(0.0, 6.0, 0.02)


def a_table(folder: Path, header: str = "time,gFx,gFy,gFz") -> Path:
    rows = "".join(f"{t:.3f},0.0,0.1,{0.99 + 0.001 * (i % 7)}\n" for i, t in enumerate(TIME_S.tolist()))
    (folder / "walk.csv").write_text(f"{header}\n{rows}")
    return folder / "walk.csv"


def test_the_guess_is_shown_with_its_evidence_and_written_with_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    done = succeed("convert", a_table(tmp_path))
    assert "read as table of Physics Toolbox" in done.stdout
    assert "its constant part is 0.99" in done.stdout
    assert "50.0 Hz delivered" in done.stdout
    assert "nothing in the file shows its sign" in done.stdout
    written = read(tmp_path / "walk_recording.zip")
    np.testing.assert_allclose(written.accelerometer.values[:, 2], 9.80665 * 0.993, rtol=0.01)
    assert (tmp_path / "walk_recording.toml").read_text() in done.stdout
    assert not list((tmp_path / "here").iterdir())


def test_a_mapping_that_was_corrected_is_obeyed_and_nothing_is_overwritten(tmp_path: Path) -> None:
    table = a_table(tmp_path)
    out = tmp_path / "first.zip"
    succeed("convert", table, "--out", out)
    before = out.read_bytes()
    assert "already exists, and convert does not overwrite files" in refusal("convert", table, "--out", out)
    assert out.read_bytes() == before
    mapping = tmp_path / "mine.toml"
    mapping.write_text((tmp_path / "first.toml").read_text().replace("sign = 1", "sign = -1"))
    turned = tmp_path / "second.zip"
    succeed("convert", table, "--map", mapping, "--out", turned)
    np.testing.assert_array_equal(read(turned).accelerometer.values, -read(out).accelerometer.values)
    assert not (tmp_path / "second.toml").exists()


def test_a_folder_of_several_recordings_is_refused_with_their_names(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / "walks" / name).mkdir(parents=True)
        a_table(tmp_path / "walks" / name)
    assert "holds 2 recordings (a, b)" in refusal("convert", tmp_path / "walks", "--out", tmp_path / "a.zip")
    succeed("convert", tmp_path / "walks" / "a", "--out", tmp_path / "a.zip")


def test_the_platform_sets_the_sign_and_an_unknown_sign_is_reported(tmp_path: Path) -> None:
    table = a_table(tmp_path, "time,ax,ay,az")
    assert "nothing shows its sign" in refusal("convert", table, "--out", tmp_path / "a.zip")
    assert not (tmp_path / "a.zip").exists()
    for platform, sign in (("ios", -1), ("android", 1)):
        out = tmp_path / f"{platform}.zip"
        succeed("convert", table, "--platform", platform, "--out", out)
        assert np.sign(read(out).accelerometer.values[:, 2]).mean() == sign


def test_files_that_were_cut_in_time_are_joined_in_any_order(tmp_path: Path) -> None:
    halves = TIME_S[:150], TIME_S[150:]
    for name, part_s in zip("ab", halves, strict=True):
        rows = "".join(f"{1_700_000_000_000 + round(1000 * t)},0.0,0.1,0.99\n" for t in part_s.tolist())
        (tmp_path / f"{name}.csv").write_text(f"timestamp,gFx,gFy,gFz\n{rows}")
    succeed("convert", tmp_path / "b.csv", tmp_path / "a.csv", "--out", tmp_path / "joined.zip")
    np.testing.assert_allclose(read(tmp_path / "joined.zip").accelerometer.time_s, TIME_S, atol=1e-6)
    assert (tmp_path / "joined.toml").read_text().startswith('time = { column = "timestamp", unit = "ms" }')
    # a mapping that does not fit each file is not written, which is said
    renamed, recording = tmp_path / "c.csv", tmp_path / "d.zip"
    renamed.write_text((tmp_path / "b.csv").read_text().replace("timestamp", "time_ms"))
    succeed("convert", tmp_path / "b.csv", "--out", recording)
    for other in (renamed, recording):
        out = tmp_path / f"with_{other.stem}.zip"
        said = succeed("convert", tmp_path / "a.csv", other, "--out", out).stderr
        assert "no column mapping was written, because none fits each of the 2 files" in said
        assert out.exists()
        assert not out.with_suffix(".toml").exists()
    assert "begins 3.0 s before the end" in refusal("convert", tmp_path / "a.csv", tmp_path / "a.csv")
