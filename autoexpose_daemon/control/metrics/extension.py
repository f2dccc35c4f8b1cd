"""The C extension, if it is built."""

from __future__ import annotations

try:
    from autoexpose_daemon.control import _native as extension
except ImportError:  # installed without a C compiler
    extension = None  # type: ignore[assignment]

__all__ = ["extension"]
