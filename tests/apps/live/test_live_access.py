"""How much each sender may send."""

from __future__ import annotations

from pdr_filter.apps.live.access import Rates


def test_what_is_refused_does_not_count_and_each_sender_has_its_own_bounds() -> None:
    rates = Rates(bytes_per_s=0.0, burst_bytes=20.0)
    assert [rates.allows("one", n) for n in (15, 15, 5, 1)] == [True, False, True, False]
    assert rates.allows("other", 20)
