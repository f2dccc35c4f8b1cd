"""Lines of the log about what goes on for long or comes again and again."""

from __future__ import annotations

from collections.abc import Hashable


class Seldom:
    """Says when it is time for a line about a thing: at its first, and then once in `pause_s` at most."""

    def __init__(self, pause_s: float) -> None:
        self._pause_ns = pause_s * 1e9
        self._said_ns: dict[Hashable, int] = {}

    def due(self, thing: Hashable, now_ns: int) -> bool:
        """Whether to say it now (CLOCK_MONOTONIC); it counts as said then. There are few things, and they are kept."""
        said_ns = self._said_ns.get(thing)
        if said_ns is not None and now_ns - said_ns < self._pause_ns:
            return False
        self._said_ns[thing] = now_ns
        return True
