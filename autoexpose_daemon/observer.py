"""Who is told of the steps of control."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

from autoexpose_daemon.control.decision import Decision
from drivers.frames import StereoPair

Observer = Callable[[StereoPair, Decision], None]
"""Called on the control thread."""


class Outlet(AbstractContextManager[Any], Protocol):
    """An observer that is open while the daemon runs; it must take no time."""

    def __call__(self, pair: StereoPair, decision: Decision) -> None:
        """Take a step, on the control thread."""
