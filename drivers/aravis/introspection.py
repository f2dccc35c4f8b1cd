"""The only file that imports `gi`: Aravis and GLib, through GObject introspection."""

from __future__ import annotations

import ctypes
from typing import Any

import gi

from imaging.errors import AutoexposeError

try:
    gi.require_version("Aravis", "0.8")
except ValueError:
    _others = ", ".join(gi.Repository.get_default().enumerate_versions("Aravis"))
    raise AutoexposeError(
        f"Aravis 0.8 is not installed{f', only {_others}' if _others else ''}: apt install gir1.2-aravis-0.8"
    ) from None
from gi.repository import Aravis, GLib

__all__ = ["Aravis", "GLib", "genicam_xml"]


def genicam_xml(device: Any) -> str:
    """The GenICam description of a device.

    Aravis 0.8.26 gives it with its length and no terminator, but PyGObject takes it for terminated text, and reads
    whatever memory follows, so it is read without PyGObject.
    """
    function = ctypes.CDLL("libaravis-0.8.so.0").arv_device_get_genicam_xml
    function.restype, function.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
    size = ctypes.c_size_t()
    text = function(hash(device), ctypes.byref(size))  # PyGObject's hash is the address
    return ctypes.string_at(text, size.value).decode("utf-8", "replace") if text else ""
