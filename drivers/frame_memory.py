"""How the memory of frames is given back."""

from __future__ import annotations

import ctypes

_M_MMAP_THRESHOLD = -3  # of glibc's malloc.h
_LARGE_BYTES = 128 << 10


def return_freed_frames() -> None:
    """Have this process give the memory of each freed frame back to the kernel at once; glibc only, else nothing.

    By itself glibc learns from the first freed frame to keep such memory, in a pool for each thread. A camera that is
    lost and found again gets new threads, and every return then cost 6 MB (measured), for as long as the process lives.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BYTES)
