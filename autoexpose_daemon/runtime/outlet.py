"""How pairs and decisions leave control."""

from __future__ import annotations

from collections.abc import Callable

from autoexpose_daemon.control.decision import Decision
from imaging.frames import StereoPair

Outlet = Callable[[StereoPair, Decision | None], None]
"""Called with every pair and the decision on it (None: a newer pair arrived first), on the control thread, so it must
return at once. One that is a context manager is open while the daemon runs."""
