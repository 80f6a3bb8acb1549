"""Conversion of Wi-Fi rows: addresses as integers, times of reception, and removal of unusable rows.

Addresses become numbers before parsing, so that a table of Wi-Fi is one of numbers like any other.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

import numpy as np

from pdr_filter.values import FloatArray, Wifi

# Six bytes as people write them, or the 40 digits by which published data sets hide them.
_ADDRESS = rb"(?:[0-9A-Fa-f]{2}(?::[0-9A-Fa-f]{2}){5}|[0-9A-Fa-f]{40})"
_ANY_ADDRESS = re.compile(rb"(?<![0-9A-Fa-f:])" + _ADDRESS + rb"(?![0-9A-Fa-f:])")
LARGEST_ADDRESS = 2**48 - 1
# dBm of what a phone can hear: nothing sends more than 30, and thermal noise is at -101 in the narrowest channel.
RSSI_RANGE_DBM = (-120.0, 30.0)
# A phone reports what it heard within some seconds. Longer ago is another clock, or an entry that nobody deleted.
LONGEST_REPORT_S = 60.0
CLOCKS_AGREE_S = 1.0  # times that apps write jitter by some tenths of a second


def with_whole_addresses(blocks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the blocks of text with the address of each access point as a decimal number, of its first 48 bits."""
    for block in blocks:
        yield _ANY_ADDRESS.sub(_whole, block)


def lines_of_log(pattern: bytes, separator: bytes, lines: bytes) -> bytes:
    """Return the numbers in the log lines that match a pattern, as lines of text with `separator` between them.

    `pattern` has a group for each number, and ADDRESS in place of the address, which becomes a decimal number. A
    pattern is needed because names of networks may contain separators and quotes.
    """
    found = re.finditer(pattern.replace(b"ADDRESS", _ADDRESS), lines, re.MULTILINE)
    rows = (separator.join(_ANY_ADDRESS.sub(_whole, group or b"") for group in match.groups()) for match in found)
    return b"".join(row + b"\n" for row in rows)


def heard_s(reported_s: FloatArray, claimed_s: FloatArray, notes: list[str]) -> FloatArray:
    """Return the times (N,) in s at which the phone received the signals of access points.

    The phone reported them at `reported_s`, and states times of reception, `claimed_s`. These are used if the median
    report is 1 s before to 60 s after them, otherwise the times of the reports, with a note.
    """
    late_s = reported_s - claimed_s
    median_s = float(np.nanmedian(late_s)) if np.isfinite(late_s).any() else np.nan
    if -CLOCKS_AGREE_S <= median_s <= LONGEST_REPORT_S:
        return claimed_s
    if len(late_s):
        notes.append("wifi: times of hearing are not on the clock of the reports, so those of the reports are used")
    return reported_s


def wifi_of(time_s: FloatArray, rows: FloatArray, where: str, notes: list[str]) -> Wifi | None:
    """Return the Wi-Fi scans from times (N,) and rows (N, 3) of address, dBm and MHz, or None if no row is usable.

    Rows without time, address or power are left out with a note, and so are repeated receptions without one.
    """
    bssid, rssi_dbm, frequency_mhz = rows.T
    whole = (bssid >= 0) & (bssid <= LARGEST_ADDRESS) & (bssid == np.floor(bssid))
    low, high = RSSI_RANGE_DBM
    usable = np.isfinite(time_s) & whole & (rssi_dbm >= low) & (rssi_dbm <= high)
    if not usable.all():
        notes.append(f"{where}: {int((~usable).sum())} rows without a time, an address or a power in dBm left out")
    index = np.flatnonzero(usable)
    _, first = np.unique(np.column_stack([time_s[index], bssid[index]]), axis=0, return_index=True)
    index = index[np.sort(first)]
    if len(index) == 0:
        return None
    return Wifi(time_s[index], bssid[index].astype(np.int64), rssi_dbm[index], frequency_mhz[index])


def _whole(match: re.Match[bytes]) -> bytes:
    return str(int(match[0].replace(b":", b"")[:12], 16)).encode()
