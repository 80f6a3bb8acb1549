"""A test that names a data set needs this one alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from data_folder import DataSets


@pytest.mark.parametrize("ci", ["", "true"])
def test_a_missing_data_set_skips_the_test_that_names_it_and_fails_it_in_ci(
    ci: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CI", ci)
    walk = tmp_path / "humolire" / "walk.zip"
    walk.parent.mkdir()
    walk.touch()
    (tmp_path / "oxiod").mkdir()  # an interrupted download can leave an empty folder
    data_dir = DataSets(tmp_path)
    assert data_dir / "humolire" / "walk.zip" == data_dir / "humolire/walk.zip" == walk
    for missing in ("oxiod", "tyrex", "tyrex/walk.zip"):
        with pytest.raises(pytest.fail.Exception if ci else pytest.skip.Exception, match=missing[:5]):
            _ = data_dir / missing
