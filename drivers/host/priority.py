"""Priority of the threads that must not be late, beside programs that take all processors."""

from __future__ import annotations

import os
import threading
from contextlib import suppress
from pathlib import Path

NICENESS = -10
_SESSION = Path("/proc/self/autogroup")


def come_first() -> None:
    """Have this thread, and those that it starts from now on, come before others, where this process may.

    It may as root, or within the limit RLIMIT_NICE. If the process leads a session, as a service does, all the session
    comes first: by default Linux divides processors among sessions, and niceness counts only within one.
    """
    thread = threading.get_native_id()
    with suppress(OSError):
        if os.getpriority(os.PRIO_PROCESS, thread) > NICENESS:  # else a filter of system calls may refuse even to ask
            os.setpriority(os.PRIO_PROCESS, thread, NICENESS)
        if os.getsid(0) == os.getpid():
            _SESSION.write_text(str(NICENESS))
