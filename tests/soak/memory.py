"""What this process holds."""

from __future__ import annotations

import gc
import os
from collections import deque
from dataclasses import dataclass
from pathlib import Path

from imaging.python310 import Self


@dataclass(frozen=True, slots=True)
class Memory:
    """Resident bytes, and how many elements all containers that Python's collector knows of have together."""

    resident_bytes: int
    elements: int

    @classmethod
    def now(cls) -> Self:
        gc.collect()
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        containers = (each for each in gc.get_objects() if isinstance(each, list | dict | set | deque))
        return cls(pages * os.sysconf("SC_PAGESIZE"), sum(map(len, containers)))
