import csv
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes

from tests.studies.report import Study, StudyFigure, StudyTable
from tests.studies.run import run


def draw(axes: Axes) -> None:
    axes.plot([0.0, 1.0], [1.0, 0.0], label="a line")
    axes.set(xlabel="time, s", ylabel="distance, m")
    axes.legend()


def a_study() -> Study:
    rows = (
        {"context": "walking", "paper": 85.2, "ours": 100 / 3},
        {"context": "running", "paper": np.nan, "ours": 0.1 + 0.2},
    )
    return Study(
        name="somebody2000",
        paper="Somebody, 2000",
        tables=(
            StudyTable("Table III, simulated: recall", rows, "simulated, two walks", "nobody walked this"),
            StudyTable("Table IV: nothing", (), "the folder lacks it", "nothing to compare", 2),
        ),
        figures=(StudyFigure("Fig. 14: a line", draw, "none", "everything"),),
        notes=("one", "two"),
    )


def test_the_page_has_every_table_with_its_data_and_what_differs() -> None:
    page = a_study().to_markdown()
    assert page.startswith("# somebody2000\n\nSomebody, 2000\n")
    for part in ("## Table III, simulated: recall", "Data: simulated, two walks.", "What differs: nobody walked this"):
        assert part in page
    assert "| walking | 85.2 | 33.3 |\n| running | - | 0.3 |" in page
    assert "Data: the folder lacks it." in page
    assert "![Fig. 14: a line](fig_14.svg)" in page
    assert page.endswith("## Notes\n\n- one\n- two\n")


def test_files_are_named_after_the_number_of_the_table(tmp_path: Path) -> None:
    written = a_study().save(tmp_path / "new" / "folder")
    assert [p.name for p in written] == ["somebody2000.md", "table_iii_simulated.csv", "table_iv.csv", "fig_14.svg"]
    assert all(p.is_file() for p in written)
    assert written[0].read_text(encoding="utf-8") == a_study().to_markdown()


def test_csv_files_have_all_digits(tmp_path: Path) -> None:
    study = a_study()
    study.save(tmp_path)
    with (tmp_path / "table_iii_simulated.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [list(row) for row in rows] == [["context", "paper", "ours"]] * 2
    for row, expected in zip(rows, study.tables[0].rows, strict=True):
        assert row["context"] == expected["context"]
        np.testing.assert_array_equal(float(row["ours"]), expected["ours"])
        np.testing.assert_array_equal(float(row["paper"]), expected["paper"])


def test_the_same_figure_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = (a_study().save(tmp_path / name)[-1].read_bytes() for name in ("a", "b"))
    assert first == second
    assert b"distance, m" in first  # text stays text
    assert b"<image" not in first  # and lines lines


def test_a_missing_folder_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("sys.argv", ["martinelli2018", "nowhere"])
    with pytest.raises(SystemExit):
        run(lambda _: a_study())
    assert "nowhere is no folder" in capsys.readouterr().err
