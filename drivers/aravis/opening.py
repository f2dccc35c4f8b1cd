"""Opening a camera: finding it, insisting on control, setting it up."""

from __future__ import annotations

import time
from typing import Any

from drivers.aravis.camera import AravisCamera
from drivers.aravis.discovery import OPENING, FoundCamera, find_camera
from drivers.aravis.introspection import Aravis, GLib
from drivers.aravis.nodes import AravisNodes
from drivers.errors import AutoexposeError, CameraBusyError, CameraNotFoundError
from drivers.setup import CameraSetup

CONTROL_PATIENCE_S = 4.0
"""A camera keeps a killed controller for its heartbeat timeout, 3 s as a rule."""
CONTROL_RETRY_S = 0.2


def open_camera(serial: str, setup: CameraSetup) -> AravisCamera:
    """Open a camera, take control of it and set it up; it is stopped until `AravisCamera.start`.

    Raises
    ------
    CameraNotFoundError, CameraBusyError, CameraLostError
        Worth another try later.
    ConfigurationError, UnsupportedCameraError, NodeError
        The setup does not fit this camera; the message says what to change.
    """
    found = find_camera(serial)
    try:
        return _set_up(found, setup)
    except AutoexposeError as error:
        # The frames of a traceback hold the camera open, and in control, for as long as someone keeps the error.
        raise error.with_traceback(None) from None


def _set_up(found: FoundCamera, setup: CameraSetup) -> AravisCamera:
    try:
        with OPENING:
            camera = Aravis.Camera.new(found.id)
    except GLib.Error as error:
        raise CameraNotFoundError(f"camera {found.serial} was seen but could not be opened: {error.message}") from None
    _take_control(camera, found.serial)
    with OPENING:
        return AravisCamera(found, camera, AravisNodes(camera.get_device(), found.serial), setup)


def _take_control(camera: Any, serial: str) -> None:
    """A GigE Vision camera opens for anyone, without a word on who controls it: insist. USB3 claims are exclusive."""
    if not camera.is_gv_device():
        return
    device = camera.get_device()
    deadline_s = time.monotonic() + CONTROL_PATIENCE_S
    while not device.is_controller():
        try:
            device.take_control()
        except GLib.Error as error:
            if time.monotonic() > deadline_s:
                raise CameraBusyError(
                    f"camera {serial} is controlled by another program ({error.message}); close that one"
                ) from None
            time.sleep(CONTROL_RETRY_S)
