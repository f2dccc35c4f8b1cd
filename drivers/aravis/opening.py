"""Opening a camera: find it, take control, set it up."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.aravis.camera import AravisCamera
from drivers.aravis.discovery import OPENING, FoundCamera, find_camera
from drivers.aravis.introspection import Aravis, GLib
from drivers.aravis.nodes import AravisNodes, is_silence
from drivers.setup import CameraSetup
from imaging.errors import (
    AutoexposeError,
    CameraBusyError,
    CameraLostError,
    CameraNotFoundError,
    UnsupportedCameraError,
)

_CLAIM_REFUSED = "Failed to claim USB interface"
"""Aravis' message when another program holds a USB3 Vision camera; the error has no code of its own."""
_NO_DESCRIPTION = "Invalid Genicam data"
"""Its message when the description arrived, but is none; it has the code of one that did not arrive."""


def open_camera(serial: str, setup: CameraSetup) -> AravisCamera:
    """Open a camera, take control of it and set it up; it is stopped until `AravisCamera.start`.

    Raises
    ------
    CameraNotFoundError, CameraBusyError, CameraLostError
        Try again later.
    ConfigurationError, UnsupportedCameraError, NodeError
        The setup does not fit this camera, or the camera cannot be driven: trying again does not help.
    """
    found = find_camera(serial)
    try:
        return _set_up(found, setup)
    except AutoexposeError as error:
        # The frames of a traceback keep the camera open, and controlled, for as long as the error is kept.
        raise error.with_traceback(None) from None


@contextmanager
def open_nodes(serial: str) -> Iterator[AravisNodes]:
    """Open a camera for its nodes alone, as it is, with its acquisition stopped; closed when the block ends.

    Raises
    ------
    CameraNotFoundError, CameraBusyError, CameraLostError
        Try again later.
    """
    camera = _controlled(find_camera(serial))
    nodes = AravisNodes(camera.get_device(), serial)
    try:
        if nodes.exists("AcquisitionStop"):
            nodes.call("stop acquisition", camera.stop_acquisition)
        yield nodes
    finally:
        if camera.is_gv_device() and not nodes.silent.is_set():
            nodes.call("release control", camera.get_device().leave_control)
        nodes.release()


def _set_up(found: FoundCamera, setup: CameraSetup) -> AravisCamera:
    camera = _controlled(found)
    with OPENING:
        return AravisCamera(found, camera, AravisNodes(camera.get_device(), found.serial), setup)


def _controlled(found: FoundCamera) -> Any:
    """The opened Aravis camera, controlled by us."""
    try:
        with OPENING:
            camera = Aravis.Camera.new(found.id)
    except GLib.Error as error:
        if _CLAIM_REFUSED in error.message:
            raise _busy(found.serial) from None
        if _NO_DESCRIPTION in error.message:
            raise UnsupportedCameraError(f"camera {found.serial}: its GenICam description cannot be read") from None
        raise CameraNotFoundError(f"camera {found.serial} was seen but could not be opened: {error.message}") from None
    _take_control(camera, found.serial)
    return camera


def _take_control(camera: Any, serial: str) -> None:
    """A GigE Vision camera opens even while another program controls it. USB3 claims are exclusive.

    A camera stays with a killed controller for its heartbeat timeout, usually 3 s: after a CameraBusyError, try again.
    """
    device = camera.get_device()
    if not camera.is_gv_device() or device.is_controller():
        return
    try:
        device.take_control()
    except GLib.Error as error:
        if is_silence(error):
            raise CameraLostError(f"camera {serial} was found but does not answer any more") from None
        raise _busy(serial) from None


def _busy(serial: str) -> CameraBusyError:
    return CameraBusyError(f"camera {serial} is controlled by another program; close that one")
