"""Opening a camera: find it, take control, set it up."""

from __future__ import annotations

import logging
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

from drivers.aravis.camera import AravisCamera, ChunkReader, FrameReader
from drivers.aravis.nodes import Aravis, AravisNodes, GLib, is_silence
from drivers.aravis.stream import create_stream, own_bytes_per_s
from drivers.camera import CameraDescription
from drivers.genicam.dialect import find_dialect, switch_auto_off, switch_gamma_off
from drivers.genicam.features import apply_features
from drivers.genicam.image_format import (
    choose_pixel_format,
    frame_size,
    send_low_byte_first,
    set_binning,
    switch_white_balance_off,
)
from drivers.genicam.metadata import SettingLedger, enable_chunks
from drivers.genicam.nodes import fixed_selectors, unlock
from drivers.genicam.timeline import FrameTimeline, find_clock
from drivers.genicam.trigger import PtpNodes, action_queue, arm_trigger, timing_limitations
from drivers.host.network import ActionSender
from drivers.setup import CameraSetup
from imaging.errors import (
    AutoexposeError,
    CameraBusyError,
    CameraLostError,
    CameraNotFoundError,
    ConfigurationError,
    UnsupportedCameraError,
)

FRESH_S = 2.0
"""A search takes a second: the second camera of a rig is found by the search for the first."""
ONE_AT_A_TIME = threading.Lock()
"""Aravis searches for one camera at a time, with one device list for the process, and parses one description at a time,
once for the nodes and once for the chunks: two at once gave broken node maps, or ended the process (0.8.26)."""
Transport = Literal["gige", "usb3"]
_TRANSPORTS: dict[str, Transport] = {"GigEVision": "gige", "USB3Vision": "usb3"}
_CLAIM_REFUSED = "Failed to claim USB interface"
"""Aravis' message when another program holds a USB3 Vision camera; the error has no code of its own."""
_NO_DESCRIPTION = "Invalid Genicam data"
"""Its message when the description arrived, but is none; it has the code of one that did not arrive."""
_HOST_STAMPS = (
    "its time stamps have no unit, as GevTimestampTickFrequency reads 0: its frames are placed by their arrival, late "
    "by readout and transfer"
)

log = logging.getLogger(__name__)

_passed_over: set[str] = set()


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that answered the search; Aravis opens it by its `id`."""

    serial: str
    vendor: str
    model: str
    transport: Transport
    address: str
    id: str


_found: list[FoundCamera] = []
_searched_s = _found_s = float("-inf")
"""When the last search began and ended."""


def find_cameras() -> list[FoundCamera]:
    """Search every interface for cameras, which takes about a second; in order of their serial numbers."""
    with ONE_AT_A_TIME:
        return _search()


def find_camera(serial: str) -> FoundCamera:
    """The camera with that serial, from a recent search or a new one; raises CameraNotFoundError."""
    asked_s = time.monotonic()
    with ONE_AT_A_TIME:
        camera = _among_found(serial)
        is_fresh = time.monotonic() - _found_s < FRESH_S
        others_searched = _searched_s >= asked_s  # while this waited: several cameras of a rig may be away
        is_known = camera is not None and is_fresh
        if not (is_known or others_searched):
            _search()
            camera = _among_found(serial)
        if camera is not None:
            return camera
        others = ", ".join(sorted(f'"{camera.serial}"' for camera in _found)) or "none"
    raise CameraNotFoundError(f'no camera with serial "{serial}" answers; cameras that do: {others}')


def _among_found(serial: str) -> FoundCamera | None:
    return next((camera for camera in _found if camera.serial == serial), None)


def _search() -> list[FoundCamera]:
    global _found, _found_s, _searched_s  # noqa: PLW0603  like Aravis' own list, one per process
    _searched_s = time.monotonic()
    Aravis.update_device_list()
    found = (_described(index) for index in range(Aravis.get_n_devices()))
    _found = sorted((camera for camera in found if camera is not None), key=lambda camera: camera.serial)
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


def open_camera(serial: str, setup: CameraSetup) -> AravisCamera:
    """Open a camera, take control of it and set it up; it is stopped until `AravisCamera.start`.

    Raises CameraNotFoundError, CameraBusyError, CameraLostError: try again later; ConfigurationError,
    UnsupportedCameraError, NodeError: the setup does not fit this camera, or the camera cannot be driven: trying again
    does not help.
    """
    found, nodes = find_camera(serial), None
    try:
        nodes = _controlled(found)
        return set_up(nodes, found, setup)
    except AutoexposeError as error:
        if nodes is not None:
            nodes.release()
        # What the frames of its traceback hold would keep the camera open, and controlled, for as long as the error is.
        traceback.clear_frames(error.__traceback__)
        raise


@contextmanager
def open_nodes(serial: str) -> Iterator[AravisNodes]:
    """Open a camera for its nodes alone, as it is, with its acquisition stopped; closed when the block ends.

    Raises CameraNotFoundError, CameraBusyError, CameraLostError: try again later.
    """
    nodes = _controlled(find_camera(serial))
    try:
        nodes.stop_acquisition()
        yield nodes
    finally:
        nodes.release()


def _controlled(found: FoundCamera) -> AravisNodes:
    """The nodes of the camera, opened and controlled by us."""
    try:
        with ONE_AT_A_TIME:
            camera = Aravis.Camera.new(found.id)
    except GLib.Error as error:
        if _CLAIM_REFUSED in error.message:
            raise _busy(found.serial) from None
        if _NO_DESCRIPTION in error.message:
            raise UnsupportedCameraError(f"camera {found.serial}: its GenICam description cannot be read") from None
        raise CameraNotFoundError(f"camera {found.serial} was seen but could not be opened: {error.message}") from None
    _take_control(camera, found.serial)
    return AravisNodes(camera, found.serial)


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


def set_up(nodes: AravisNodes, found: FoundCamera, setup: CameraSetup) -> AravisCamera:
    """Set everything that decides what its frames are; raises as `open_camera` does."""
    serial, trigger = found.serial, setup.trigger
    nodes.stop_acquisition()
    unlock(nodes)
    switch_auto_off(nodes)  # so that nothing locks, or overwrites, what is set
    switch_white_balance_off(nodes, setup.pixel_format)
    apply_features(nodes, setup)
    switch_auto_off(nodes)
    # First: a camera that cannot expose fails for that.
    dialect = find_dialect(nodes, setup.gain_scale, setup.exposure_count_us, setup.offset_stops)
    pixel_format = choose_pixel_format(nodes, setup.pixel_format)
    send_low_byte_first(nodes, pixel_format)
    limitations = [*dialect.limitations]
    of_colours = switch_white_balance_off(nodes, pixel_format)
    set_binning(nodes, setup.binning)
    if trigger.mode == "ptp" and found.transport != "gige":
        raise ConfigurationError(
            f"camera {serial} is on USB3 Vision, where there is no PTP: choose another trigger.mode"
        )
    limitations += arm_trigger(nodes, trigger)
    ptp = PtpNodes(nodes) if trigger.mode == "ptp" else None  # before the clock: it changes its ticks
    limitations += () if ptp is None else ptp.limitations
    limitations += timing_limitations(nodes, trigger)
    limitations += (*switch_gamma_off(nodes), *of_colours)
    gain_node = None if dialect.gain is None else dialect.gain.node
    chunk_nodes, of_chunks = enable_chunks(nodes, gain_node)
    clock, of_clock = find_clock(nodes)
    # Without a tick frequency Aravis stamps frames with the host's time, when their first packet arrives.
    host_stamps = nodes.camera.is_gv_device() and not nodes.device.get_timestamp_tick_frequency()
    if ptp is not None and (clock is None or host_stamps):
        raise UnsupportedCameraError(
            f"camera {serial}: it has no TimestampLatch, and so its PTP time cannot be read: choose another "
            "trigger.mode"
        )
    limitations += (*of_chunks, *of_clock, *((_HOST_STAMPS,) if host_stamps else ()))
    limits = dialect.limits(nodes)
    setting = dialect.settle(nodes, limits)
    timeline = FrameTimeline(
        None if trigger.rate_hz is None else 1e9 / trigger.rate_hz,
        None if clock is None or host_stamps else clock.read(),
        1.0 if clock is None else clock.tick_ns,
        stamped=not host_stamps,
    )
    stream = create_stream(nodes, setup)
    chunks = None
    if chunk_nodes is not None:
        with ONE_AT_A_TIME:
            parser = nodes.camera.create_chunk_parser()
        chunks = ChunkReader(parser, chunk_nodes, dialect.gain)
    queue = 1 if ptp is None else action_queue(nodes)
    size = frame_size(nodes)
    for fixed in fixed_selectors(nodes):
        log.info("camera %s: %s", serial, fixed)
    speed = own_bytes_per_s(nodes)
    return AravisCamera(
        nodes,
        CameraDescription(
            found.vendor,
            found.model,
            serial,
            tuple(limitations),
            pixel_format,
            gain_node,
            size,
            queue,
            None if speed is None else 8e-6 * speed,
        ),
        limits=limits,
        dialect=dialect,
        setting=setting,
        stream=stream,
        frames=FrameReader(serial, pixel_format, SettingLedger(setting), timeline, chunks),
        clock=clock,
        ptp=ptp,
        actions=None if ptp is None else _action_sender(found),
    )


def _action_sender(found: FoundCamera) -> ActionSender:
    try:
        return ActionSender(found.address)
    except OSError as error:
        why = error.strerror or str(error)
        raise CameraBusyError(f"camera {found.serial}: no action command could be sent: {why}") from None
