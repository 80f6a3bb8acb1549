"""Tokens, and limits on how much each sender may send."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

TOKEN_COOKIE = "pdr_filter_token"
# Sensor Logger sends about 0.1 MB per second with all sensors at 100 Hz. After a minute without network it sends all
# messages of this minute at once.
MAX_BODY_BYTES = 4 * 1024**2
BYTES_PER_S = 1024**2
BURST_BYTES = 16 * 1024**2
_MAX_BUCKETS = 10_000
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")


def is_loopback(host: str) -> bool:
    """Return True if a server that is bound to this host can be reached from this computer only."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def made_token(folder: Path | None) -> str:
    """Return the access token that is stored in a folder, or a new one, which is then stored there.

    Phones keep the address with the token that they were given, so a restarted server needs the same token. If `folder`
    is None, the token is new and is not stored.
    """
    path = None if folder is None else folder / "token"
    if path is not None and path.exists() and (kept := path.read_text().strip()):
        return kept
    token = secrets.token_urlsafe(12)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch(mode=0o600)
        path.write_text(token)
    return token


def is_token(token: str, given: Iterable[str | None]) -> bool:
    """Return True if one of the given texts is the access token."""
    return any(hmac.compare_digest(token.encode(), value.encode("utf-8", "replace")) for value in given if value)


def lan_address() -> str:
    """Address of this computer in its local network, or 127.0.0.1 if unknown. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # an address of documentation; for UDP it only chooses the interface
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"


@dataclass
class Rates:
    """Limit on the number of bytes that each sender may send: a token bucket that fills with time."""

    bytes_per_s: float = BYTES_PER_S
    burst_bytes: float = BURST_BYTES
    _left: dict[str, tuple[float, float]] = field(default_factory=dict[str, tuple[float, float]])

    def allows(self, who: str, n_bytes: int) -> bool:
        """Return True, and count the bytes, if the sender `who` may send `n_bytes` more now."""
        now = time.monotonic()
        left, then = self._left.pop(who, (self.burst_bytes, now))
        left = min(left + (now - then) * self.bytes_per_s, self.burst_bytes)
        allowed = n_bytes <= left
        self._left[who] = left - n_bytes * allowed, now
        while len(self._left) > _MAX_BUCKETS:
            del self._left[next(iter(self._left))]
        return allowed
