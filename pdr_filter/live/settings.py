"""What the server and its workers agree on."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

# What there is to show, as JSON has it: docs/live.md lists them.
Event = dict[str, Any]


class FixError(ValueError):
    """A fix that cannot be used; the words say why."""


class BusyError(RuntimeError):
    """No room for another phone."""


@dataclass(frozen=True, slots=True)
class Settings:
    """How phones are tracked."""

    recipe: str = "default"
    height_m: float | None = None
    platform: str = ""  # "ios" or "android", for an app that does not say it
    max_devices: int = 64


def part_of(device: str, n_parts: int) -> int:
    """Which of so many workers a device belongs to."""
    return int.from_bytes(hashlib.sha256(device.encode()).digest()[:4]) % n_parts
