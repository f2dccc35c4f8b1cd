"""Finding the cameras that answer, with the id by which Aravis opens each."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from drivers.aravis.introspection import Aravis
from imaging.errors import CameraNotFoundError

FRESH_S = 2.0
"""A search takes a second: the second camera of a rig is found by the search for the first."""
OPENING = threading.Lock()
"""One camera at a time is searched for and opened. Aravis keeps one device list for the process, and two cameras whose
descriptions were parsed at the same time came up with broken node maps (0.8.26, once in six tries)."""
Transport = Literal["gige", "usb3"]
_TRANSPORTS: dict[str, Transport] = {"GigEVision": "gige", "USB3Vision": "usb3"}


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that answered the search; Aravis opens it by its `id`."""

    serial: str
    vendor: str
    model: str
    transport: Transport
    address: str
    id: str


log = logging.getLogger(__name__)

_found: list[FoundCamera] = []
_passed_over: set[str] = set()
_found_s = float("-inf")


def find_cameras() -> list[FoundCamera]:
    """Search every interface for cameras, which takes about a second."""
    with OPENING:
        return _search()


def _search() -> list[FoundCamera]:
    global _found, _found_s  # noqa: PLW0603  like Aravis' own list, one per process
    Aravis.update_device_list()
    found = (_described(index) for index in range(Aravis.get_n_devices()))
    _found = [camera for camera in found if camera is not None]
    _found_s = time.monotonic()
    return _found


def _described(index: int) -> FoundCamera | None:
    """A device of Aravis' list; None if it is of another kind, or calls itself something that is not UTF-8."""
    transport = _TRANSPORTS.get(Aravis.get_device_protocol(index))
    if transport is None:
        return None
    address = Aravis.get_device_address(index)
    try:
        return FoundCamera(
            serial=Aravis.get_device_serial_nbr(index),
            vendor=Aravis.get_device_vendor(index),
            model=Aravis.get_device_model(index),
            transport=transport,
            address=address,
            id=Aravis.get_device_id(index),
        )
    except UnicodeDecodeError:
        if address not in _passed_over:
            _passed_over.add(address)
            log.warning("the camera at %s is passed over: its vendor, model or serial is not UTF-8", address)
        return None


def find_camera(serial: str) -> FoundCamera:
    """The camera with that serial, from a recent search or a new one; raises CameraNotFoundError."""
    with OPENING:
        recent = _found if time.monotonic() - _found_s < FRESH_S else []
        for camera in itertools.chain(recent, _searched()):
            if camera.serial == serial:
                return camera
        others = ", ".join(sorted(f'"{camera.serial}"' for camera in _found)) or "none"
    raise CameraNotFoundError(f'no camera with serial "{serial}" answers; cameras that do: {others}')


def _searched() -> Iterator[FoundCamera]:
    """A new search, made only when its first camera is asked for."""
    yield from _search()
