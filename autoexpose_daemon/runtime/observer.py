"""Who is told of pairs and decisions."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

from autoexpose_daemon.control.decision import Decision
from drivers.frames import StereoPair

Observer = Callable[[StereoPair, Decision | None], None]
"""Told of every pair and what was decided on it, on the control thread; None: a newer pair was there before that."""


class Outlet(AbstractContextManager[Any], Protocol):
    """An observer that is open while the daemon runs; it must take no time."""

    def __call__(self, pair: StereoPair, decision: Decision | None) -> None:
        """Take a pair, as an `Observer` does."""
