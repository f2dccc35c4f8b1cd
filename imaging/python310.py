"""Parts of the standard library of 3.11 that Python 3.10, that of Ubuntu 22.04, lacks; to be removed with 3.10."""

from __future__ import annotations

import ctypes
import sys
from concurrent.futures import TimeoutError as FutureTimeoutError  # not the built-in one before 3.11
from datetime import timezone

if sys.version_info >= (3, 11):
    from enum import StrEnum
    from math import exp2
    from typing import Self
else:
    from enum import Enum

    from typing_extensions import Self

    class StrEnum(str, Enum):
        """Members are strings, and are shown as strings."""

        __str__ = str.__str__

    exp2 = ctypes.CDLL("libm.so.6").exp2  # math.pow(2.0, x) differs in the last bit, and replay would
    exp2.argtypes, exp2.restype = [ctypes.c_double], ctypes.c_double


UTC = timezone.utc

__all__ = ["UTC", "FutureTimeoutError", "Self", "StrEnum", "exp2"]
