"""The only file that imports `gi`: Aravis and GLib, through GObject introspection."""

from __future__ import annotations

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402

__all__ = ["Aravis", "GLib"]
