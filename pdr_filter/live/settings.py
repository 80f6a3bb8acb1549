"""Settings, errors and types that the server and its workers share."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

# Event for pages and programs in the types of JSON; docs/live.md lists the kinds.
Event = dict[str, Any]


class FixError(ValueError):
    """A fix that cannot be used, with the reason."""


class BusyError(RuntimeError):
    """No room or no time for a message at present."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Options for tracking, which all phones share."""

    recipe: str = "default"
    height_m: float | None = None
    platform: str = ""  # "ios" or "android", for an app that does not say it
    max_devices: int = 64


def part_of(device: str, n_parts: int) -> int:
    """Number of the worker that serves a device."""
    return int.from_bytes(hashlib.sha256(device.encode()).digest()[:4]) % n_parts
