import numpy as np
import pytest

from pdr_filter.evaluate.distance import distance_scores
from tests.studies.martinelli2018 import TABLE_V
from tests.studies.weightings import bias_and_spread, over_people


def test_a_constant_brings_the_paper_s_hc_below_its_wc() -> None:
    gain = np.mean(TABLE_V["wc"]) - np.mean(TABLE_V["hc"])
    corrected = np.array(TABLE_V["hc"]) + gain
    assert gain == pytest.approx(4.5, abs=0.05)
    assert bias_and_spread(list(corrected))[0] == "4.60"
    assert distance_scores(corrected).rmse_percent < distance_scores(TABLE_V["wc"]).rmse_percent


def test_walks_of_one_person_count_once_and_missing_errors_do_not() -> None:
    assert over_people([2.0, -4.0, 5.0, np.nan], ["a", "a", "b", "c"]) == "4.0 ± 12.7"
    assert over_people([np.nan], ["a"]) == "-"
    assert over_people([-3.0], ["a"]) == "3.0"
