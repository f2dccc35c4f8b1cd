"""The way in which pairs and decisions leave control."""

from __future__ import annotations

from collections.abc import Callable

from autoexpose_daemon.control.decision import Decision
from drivers.frames import StereoPair

Outlet = Callable[[StereoPair, Decision | None], None]
"""Takes every pair and what was decided on it (None: a newer pair arrived before that), on the control thread, and so
must return at once. One that is a context manager is open while the daemon runs."""
