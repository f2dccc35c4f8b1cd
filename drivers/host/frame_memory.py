"""How the memory of frames is given back."""

from __future__ import annotations

import ctypes

_M_ARENA_MAX = -8  # of glibc's malloc.h


def share_one_heap() -> None:
    """Have all threads of this process take memory from one heap; glibc only, else nothing.

    By itself glibc gives threads heaps of their own, and each keeps the largest it ever held. A camera that is lost and
    found again gets new threads, and every return cost 6 MB (measured). To give each freed frame back to the kernel
    at once would help as well, but makes every array of a step cost page faults: the step took five times as long.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, 1)
