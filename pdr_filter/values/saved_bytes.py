"""Compression of saved values: text in two parts, and numbers by the bytes in which they differ.

zlib finds repeated text only within 32 KiB. The text of a configuration and that of a state are therefore compressed
one after the other, each with the same part of an example as preset dictionary. The names of classes and fields then
take nearly no space.

The last bits of measured numbers are random and cannot be compressed. Successive values of a signal differ little, so
that the first bytes of the differences of their bit patterns are nearly all zero. Small arrays, such as covariances,
often repeat numbers.
"""

from __future__ import annotations

import zlib
from functools import lru_cache
from pathlib import Path

import numpy as np

# Text of a saved filter, whose numbers are omitted. It must never change: filters since format 11 are compressed with
# it.
_EXAMPLE = Path(__file__).with_name("saved_example.txt")
# Begin of the second part of the text: the state of a filter, after its configuration.
_STATE = b'"state": '
_WINDOW_BYTES = 1 << 15
_N = 8  # bytes of a number


@lru_cache(maxsize=1)
def _dictionaries() -> tuple[bytes, bytes]:
    config, state = _in_two_parts(_EXAMPLE.read_bytes())
    return config[-_WINDOW_BYTES:], state[-_WINDOW_BYTES:]


def _in_two_parts(text: bytes) -> tuple[bytes, bytes]:
    before, mark, after = text.partition(_STATE)
    return before, mark + after


def compressed(text: bytes, arrays: bytes, signals: bytes) -> bytes:
    """Return the bytes from which `decompressed` restores a text and the bytes of small arrays and of signals."""
    config, state = _in_two_parts(text)
    of_config, of_state = _dictionaries()
    streams = (
        # Level 3 is as fast as level 1 here, because it finds longer matches in the dictionary.
        (config, zlib.compressobj(3, zdict=of_config)),
        (state, zlib.compressobj(3, zdict=of_state)),
        (arrays, zlib.compressobj(3)),
        # Signals repeat no sequences, and looking for them would take most of the time.
        (_by_differences(signals), zlib.compressobj(1, strategy=zlib.Z_RLE)),
    )
    return b"".join(part for content, deflater in streams for part in (deflater.compress(content), deflater.flush()))


def decompressed(blob: bytes, max_bytes: int) -> tuple[bytes, bytes]:
    """Return the text, and the bytes of small arrays followed by those of signals.

    ValueError or zlib.error for other bytes than those of `compressed`. Before format 11 there was one stream, with a
    line feed between text and arrays.
    """
    of_config, of_state = _dictionaries()
    config, rest = _inflated(blob, max_bytes, of_config)
    if not rest:
        text, _, arrays = config.partition(b"\n")
        return text, arrays
    state, rest = _inflated(rest, max_bytes - len(config), of_state)
    arrays, rest = _inflated(rest, max_bytes - len(config) - len(state))
    signals, rest = _inflated(rest, max_bytes - len(config) - len(state) - len(arrays))
    if rest:
        raise ValueError("followed by other data")
    return config + state, arrays + _from_differences(signals)


def _inflated(blob: bytes, max_bytes: int, dictionary: bytes = b"") -> tuple[bytes, bytes]:
    """Return the content of the first stream, and the bytes after this stream."""
    inflater = zlib.decompressobj(zdict=dictionary)
    content = inflater.decompress(blob, max(max_bytes, 1))  # zlib takes 0 for no limit
    if inflater.unconsumed_tail or not inflater.eof:
        raise ValueError("incomplete, or too large")
    return content, inflater.unused_data


def _by_differences(signals: bytes) -> bytes:
    """Return the differences of successive 64-bit integers, the lowest byte of all of them first.

    The sign of a difference is its last bit (zigzag code), so that small ones of either sign begin with zeros.
    """
    numbers = np.frombuffer(signals, "<i8").astype(np.int64, copy=False)
    differences = np.diff(numbers, prepend=0)
    unsigned = (differences << 1) ^ (differences >> 63)
    return unsigned.astype("<i8", copy=False).view(np.uint8).reshape(-1, _N).T.tobytes()


def _from_differences(columns: bytes) -> bytes:
    stored = np.frombuffer(columns, np.uint8).reshape(_N, -1).T.copy().view("<u8")[:, 0]
    unsigned = stored.astype(np.uint64, copy=False)
    differences = (unsigned >> np.uint64(1)).view(np.int64) ^ -(unsigned & np.uint64(1)).view(np.int64)
    return np.cumsum(differences).astype("<i8", copy=False).tobytes()
