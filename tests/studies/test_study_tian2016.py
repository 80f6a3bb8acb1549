import numpy as np

from tests.studies.tian2016 import TRANS, Carried


def test_what_was_said_last_holds_on_and_the_mode_most_often_said_wins() -> None:
    said = Carried(np.arange(7.0), ["HOLDING", TRANS, TRANS, "POCKET", "POCKET", TRANS, TRANS])
    assert said.within(3.5, 4.5) == ["POCKET", "POCKET"]
    assert said.most(0.0, 6.0) == "POCKET"
    assert said.most(5.0, 6.0) == TRANS
