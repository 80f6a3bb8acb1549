"""Received Wi-Fi access points, addresses and scans."""

from __future__ import annotations

import numpy as np
import pytest

from pdr_filter.values import Wifi, address_text


def wifi(time_s: list[float], bssid: list[int] | None = None, rssi_dbm: list[float] | None = None) -> Wifi:
    n = len(time_s)
    return Wifi(np.array(time_s), np.array(bssid or range(n)), np.array(rssi_dbm or [-60.0] * n), np.full(n, 2412.0))


def test_a_scan_ends_at_a_pause_or_after_two_and_a_half_seconds() -> None:
    starts = [s.time_s for s in wifi([0.0, 0.3, 0.6, 1.0, 1.1]).scans()]
    np.testing.assert_allclose(starts, [0.3, 1.05])
    restless = wifi(np.arange(0.0, 6.0, 0.125).tolist()).scans()
    assert [len(s.bssid) for s in restless] == [21, 21, 6]
    assert restless[0].end_s == pytest.approx(2.5)


def test_scans_do_not_depend_on_the_order_of_the_rows() -> None:
    rng = np.random.default_rng(0)
    time_s, bssid = np.round(rng.uniform(0, 10, 40), 2), rng.integers(0, 9, 40)
    order = rng.permutation(40)
    plain, mixed = wifi(time_s.tolist(), bssid.tolist()), wifi(time_s[order].tolist(), bssid[order].tolist())
    for a, b in zip(plain.scans(), mixed.scans(), strict=True):
        np.testing.assert_array_equal(a.bssid, b.bssid)
        assert (a.end_s, a.time_s) == (b.end_s, pytest.approx(b.time_s))


def test_a_scan_has_each_access_point_once_with_its_largest_power() -> None:
    (scan,) = wifi([0.0, 0.1, 0.2], [7, 3, 7], [-80.0, -70.0, -60.0]).scans()
    np.testing.assert_array_equal(scan.bssid, [3, 7])
    np.testing.assert_array_equal(scan.rssi_dbm, [-70.0, -60.0])


def test_rows_without_time_or_power_are_in_no_scan() -> None:
    assert wifi([np.nan, 1.0], [1, 2], [-50.0, np.nan]).scans() == ()
    assert wifi([]).scans() == ()


def test_a_more_sensitive_phone_has_the_same_fingerprint() -> None:
    (scan,) = wifi([0.0, 0.1], [1, 2], [-65.0, -82.5]).scans()
    (other,) = wifi([0.0, 0.1], [1, 2], [-30.0, -65.0]).scans()
    np.testing.assert_allclose(scan.fingerprint, other.fingerprint)
    assert np.linalg.norm(scan.fingerprint) == pytest.approx(1.0)


def test_an_address_has_the_usual_notation() -> None:
    assert address_text(0x06749C2E95EA) == "06:74:9c:2e:95:ea"
