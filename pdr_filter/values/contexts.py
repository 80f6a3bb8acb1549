"""Names and order of the contexts and carrying modes."""

from __future__ import annotations

#: Order of the contexts everywhere: C1..C6 of Martinelli et al. 2018, Table I.
CONTEXTS: tuple[str, ...] = ("stationary", "walking", "upstairs", "downstairs", "sideways", "running")

#: Order of the carrying modes everywhere.
CARRYING_MODES: tuple[str, ...] = ("texting", "calling", "swinging", "pocket", "bag")
