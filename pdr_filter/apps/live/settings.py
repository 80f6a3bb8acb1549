"""Settings, errors and types that the server and its workers share."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from pdr_filter.values.recording import Subject

_UNKNOWN = Subject()
# Event for pages and programs in the types of JSON; the docstring of `apps.live.broadcast` lists the kinds.
Event = dict[str, Any]


class FixError(ValueError):
    """Error for a fix that cannot be used. It states the reason."""


class BusyError(RuntimeError):
    """Error for a message that the server has no room or no time for at present."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Tracking options of a server, and what is known about the person and placement of one phone (`of_phone`)."""

    recipe: str = "default"
    height_m: float | None = None  # height of people without an entry in `heights_m`
    platform: str = ""  # "ios" or "android", for an app that does not say it
    max_devices: int = 64
    heights_m: tuple[
        tuple[str, float], ...
    ] = ()  # heights of people, by the first letters of the names of their phones
    subject: Subject = _UNKNOWN
    placement: str = ""

    def of_phone(self, device: str, meta: Mapping[str, Any]) -> Settings:
        """Return the settings for a phone that also sends the meta data `meta` (see `messages.Message`).

        The height is that of the longest name in `heights_m` with which the name of the phone begins, otherwise that of
        the phone, otherwise `height_m`.
        """
        named = {name: height_m for name, height_m in self.heights_m if device.startswith(name)}
        subject = {**self.meta.get("subject", {}), **meta.get("subject", {})}
        known: dict[str, Any] = {"height_m": self.height_m, **subject}
        if named:
            known["height_m"] = named[max(named, key=len)]
        return replace(self, subject=Subject(**known), placement=meta.get("placement", self.placement))

    @property
    def meta(self) -> dict[str, Any]:
        """Known meta data of a recording of this phone."""
        subject = {name: value for name, value in asdict(self.subject).items() if value is not None}
        return {name: value for name, value in (("subject", subject), ("placement", self.placement)) if value}


def worker_of(device: str, n_parts: int) -> int:
    """Number of the worker that serves a device, 0 to `n_parts` - 1, from a checksum of the device name."""
    return int.from_bytes(hashlib.sha256(device.encode()).digest()[:4]) % n_parts
