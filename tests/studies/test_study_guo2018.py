from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pdr_filter.evaluate.classification import accuracy, kappa, macro_recall, precision
from pdr_filter.evaluate.steps import count_error_percent
from tests.studies import guo2018 as guo


def test_table_3_gives_its_accuracy_kappa_precision_and_recall() -> None:
    c = guo._CONFUSION
    for score, printed in zip(
        (accuracy(c), kappa(c), precision(c).mean(), macro_recall(c)), guo._SCORES.values(), strict=True
    ):
        assert 100 * score == pytest.approx(printed, abs=0.005)


def test_the_percentages_of_steps_are_of_totals() -> None:
    for pose, (true, found) in guo._STEPS.items():
        of_totals = 100 - abs(float(count_error_percent(sum(found), sum(true))))
        assert of_totals == pytest.approx(guo._COUNTED_PERCENT[pose], abs=0.011)


@pytest.mark.recordings
def test_a_real_walk_on_known_legs_has_its_speed(data_dir: Path, tmp_path: Path) -> None:
    (tmp_path / "humolire").mkdir()
    for name in ("1f", "2f"):
        path = data_dir / "humolire" / f"humolire_user1_{name}.zip"
        (tmp_path / "humolire" / path.name).symlink_to(path)
    walks = guo.real_walks(tmp_path)
    assert len(walks) == 2
    true = np.array([w.true_mps for w in walks])
    np.testing.assert_allclose(guo.speeds_mps(walks, walks), true, rtol=0.06)
