"""How the memory of frames is returned to the kernel."""

from __future__ import annotations

import ctypes

_M_ARENA_MAX = -8  # of glibc's malloc.h


def share_one_heap() -> None:
    """Make all threads of this process allocate from one heap (glibc only; elsewhere this does nothing).

    By default glibc gives threads heaps of their own, and each keeps the most it ever held. A camera that is lost and
    found again gets new threads, and each return cost 6 MB (measured). Returning each freed frame to the kernel at once
    would help as well, but then every array of a step costs page faults: the step took five times as long.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
