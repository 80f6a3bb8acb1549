"""Settings, errors and types that the server and its workers share."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

# Event for pages and programs in the types of JSON; the docstring of `apps.live.broadcast` lists the kinds.
Event = dict[str, Any]


class FixError(ValueError):
    """Error for a fix that cannot be used. It states the reason."""


class BusyError(RuntimeError):
    """Error for a message that the server has no room or no time for at present."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Tracking options of a server, which apply to all phones."""

    recipe: str = "default"
    height_m: float | None = None
    platform: str = ""  # "ios" or "android", for an app that does not say it
    max_devices: int = 64


def worker_of(device: str, n_parts: int) -> int:
    """Number of the worker that serves a device, 0 to `n_parts` - 1, from a checksum of the device name."""
    return int.from_bytes(hashlib.sha256(device.encode()).digest()[:4]) % n_parts
