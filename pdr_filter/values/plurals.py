"""Numbers with nouns for messages."""

from __future__ import annotations


def how_many(n: int, one: str, many: str = "") -> str:
    """Return a number with its noun: "1 gap", "2 gaps", "1,204 steps".

    >>> how_many(1, "fix", "fixes"), how_many(1204, "step")
    ('1 fix', '1,204 steps')
    """
    return f"{n:,} {one if n == 1 else many or one + 's'}"


def how_often(n: int) -> str:
    """Return a number of repetitions as text: "once", "twice", "3 times".

    >>> how_often(1), how_often(2), how_often(3)
    ('once', 'twice', '3 times')
    """
    return {1: "once", 2: "twice"}.get(n, how_many(n, "time"))
