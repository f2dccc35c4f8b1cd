"""Cameras through Aravis: finding them, opening one by its serial number, streaming frames. The only file with `gi`."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import gi

gi.require_version("Aravis", "0.8")
from gi.repository import Aravis, GLib  # noqa: E402

from drivers.camera import CameraDescription, IncompleteFrame  # noqa: E402
from drivers.clock import find_clock  # noqa: E402
from drivers.dialect import find_dialect, switch_auto_off  # noqa: E402
from drivers.errors import (  # noqa: E402
    AutoexposeError,
    CameraBusyError,
    CameraError,
    CameraLostError,
    CameraNotFoundError,
    NodeError,
)
from drivers.exposure import ExposureLimits, ExposureSetting  # noqa: E402
from drivers.frames import Frame  # noqa: E402
from drivers.image_format import choose_pixel_format, decode_pixels, set_binning  # noqa: E402
from drivers.metadata import FrameIdUnwrapper, SettingLedger, enable_chunks  # noqa: E402
from drivers.setup import CameraSetup  # noqa: E402
from drivers.trigger import arm_trigger  # noqa: E402

BUFFERS = 16
"""A quarter of a second at 60 Hz: longer than any pause of the reading thread worth surviving."""
FRAME_RETENTION_US = 50_000
"""A GigE Vision frame still incomplete so long after its last packet is given up; frames behind it wait until then."""
CONTROL_PATIENCE_S = 4.0
"""A camera keeps a killed controller for its heartbeat timeout, 3 s as a rule."""
CONTROL_RETRY_S = 0.2

Transport = Literal["gige", "usb3"]
_TRANSPORTS: dict[str, Transport] = {"GigEVision": "gige", "USB3Vision": "usb3"}
FRESH_S = 2.0
"""A search takes a second: the second camera of a rig is opened from what the search for the first one found."""
_opening = threading.Lock()
"""One camera at a time is searched for and opened. Aravis keeps one device list for the process, and two cameras whose
descriptions were parsed at the same time came up with broken node maps (0.8.26, once in six tries)."""
_SILENCE = (Aravis.DeviceError.TIMEOUT, Aravis.DeviceError.NOT_CONNECTED)
_HOLES = (
    Aravis.BufferStatus.TIMEOUT,
    Aravis.BufferStatus.MISSING_PACKETS,
    Aravis.BufferStatus.WRONG_PACKET_ID,
    Aravis.BufferStatus.SIZE_MISMATCH,
)
_log = logging.getLogger(__name__)
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that answered the search; `id` is the name that Aravis opens it by."""

    serial: str
    vendor: str
    model: str
    transport: Transport
    address: str
    id: str


_found: list[FoundCamera] = []
_found_s = float("-inf")


def find_cameras() -> list[FoundCamera]:
    """Search every interface for cameras, which takes about a second."""
    with _opening:
        return _search()


def _search() -> list[FoundCamera]:
    global _found, _found_s  # noqa: PLW0603  beside Aravis' own list, which is one for the process too
    Aravis.update_device_list()
    _found = [
        FoundCamera(
            serial=Aravis.get_device_serial_nbr(index),
            vendor=Aravis.get_device_vendor(index),
            model=Aravis.get_device_model(index),
            transport=_TRANSPORTS[Aravis.get_device_protocol(index)],
            address=Aravis.get_device_address(index),
            id=Aravis.get_device_id(index),
        )
        for index in range(Aravis.get_n_devices())
        if Aravis.get_device_protocol(index) in _TRANSPORTS
    ]
    _found_s = time.monotonic()
    return _found


def _find(serial: str) -> FoundCamera:
    with _opening:
        recent = _found if time.monotonic() - _found_s < FRESH_S else []
        for camera in itertools.chain(recent, _searched()):
            if camera.serial == serial:
                return camera
        others = ", ".join(sorted(camera.serial for camera in _found)) or "none"
    raise CameraNotFoundError(f"no camera with serial {serial} answers; cameras that do: {others}")


def _searched() -> Iterator[FoundCamera]:
    """A new search, made only when it is asked for its first camera."""
    yield from _search()


def open_camera(serial: str, setup: CameraSetup) -> AravisCamera:
    """Open a camera, take control of it and set it up; it is stopped until `AravisCamera.start`.

    Raises
    ------
    CameraNotFoundError, CameraBusyError, CameraLostError
        Worth another try later.
    ConfigurationError, UnsupportedCameraError, NodeError
        The setup does not fit this camera; the message says what to change.
    """
    found = _find(serial)
    try:
        return _set_up(found, setup)
    except AutoexposeError as error:
        # The frames of a traceback hold the camera open, and in control, for as long as someone keeps the error.
        raise error.with_traceback(None) from None


def _set_up(found: FoundCamera, setup: CameraSetup) -> AravisCamera:
    try:
        with _opening:
            camera = Aravis.Camera.new(found.id)
    except GLib.Error as error:
        raise CameraNotFoundError(f"camera {found.serial} was seen but could not be opened: {error.message}") from None
    _take_control(camera, found.serial)
    with _opening:
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


class AravisNodes:
    """The node map of an Aravis device (see `drivers.nodes.NodeMap`), its errors in this project's words."""

    def __init__(self, device: Any, serial: str) -> None:
        self._device = device
        self.serial = serial
        self.silent = threading.Event()
        """Set once a request was left without an answer: the camera is lost."""
        device.set_range_check_policy(Aravis.RangeCheckPolicy.ENABLE)
        device.set_access_check_policy(Aravis.AccessCheckPolicy.ENABLE)
        device.set_register_cache_policy(Aravis.RegisterCachePolicy.DISABLE)

    def release(self) -> None:
        """Let go of the device, so that what still refers to these nodes (a traceback) does not keep it open."""
        self._device = None

    def call(self, doing: str, function: Callable[..., T], *arguments: object) -> T:
        """Call into Aravis; `doing` completes the sentence "camera S: could not ..."."""
        try:
            return function(*arguments)
        except GLib.Error as error:
            failure = self._told(error, doing)
        del function  # it holds the device, and the traceback would hold it
        try:
            raise failure
        finally:
            del failure  # it would hold this frame, the frame it, and the garbage collector block on a dead camera

    def _told(self, error: GLib.Error, doing: str) -> CameraError:
        if any(error.matches(Aravis.device_error_quark(), code) for code in _SILENCE):
            self.silent.set()
            return CameraLostError(f"camera {self.serial} does not answer: could not {doing}")
        return NodeError(f"camera {self.serial}: could not {doing}: {error.message}")

    def available(self, name: str) -> bool:
        """Whether the camera has this feature and offers it at present."""
        node = self._device.get_feature(name)
        if node is None or isinstance(node, Aravis.GcCategory):
            return False
        return bool(self.call(f"look for {name}", self._device.is_feature_available, name))

    def is_float(self, name: str) -> bool:
        """Whether the feature is there and holds a floating-point number."""
        return isinstance(self._device.get_feature(name), Aravis.GcFloat) and self.available(name)

    def unit(self, name: str) -> str | None:
        """The unit that a floating-point feature declares."""
        return self._device.get_feature(name).get_unit() or None

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries an enumeration offers at present."""
        if not isinstance(self._device.get_feature(name), Aravis.GcEnumeration) or not self.available(name):
            return ()
        names = self._device.dup_available_enumeration_feature_values_as_strings
        return tuple(self.call(f"list the entries of {name}", names, name))

    def float_bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value."""
        bounds = self.call(f"read the bounds of {name}", self._device.get_float_feature_bounds, name)
        return bounds.min, bounds.max

    def float_increment(self, name: str) -> float:
        """The declared increment; Aravis gives an error, or the least positive float, when none is declared."""
        try:
            increment: float = self._device.get_float_feature_increment(name)
        except GLib.Error as error:
            if error.matches(Aravis.gc_error_quark(), Aravis.GcError.PROPERTY_NOT_DEFINED):
                return 0.0
            raise self._told(error, f"read the increment of {name}") from None
        return increment if increment > 1e-9 else 0.0

    def integer_bounds(self, name: str) -> tuple[int, int]:
        """Least and greatest value."""
        bounds = self.call(f"read the bounds of {name}", self._device.get_integer_feature_bounds, name)
        return bounds.min, bounds.max

    def read_float(self, name: str) -> float:
        """Value of a floating-point feature."""
        return float(self.call(f"read {name}", self._device.get_float_feature_value, name))

    def write_float(self, name: str, value: float) -> None:
        """Write a floating-point feature."""
        self.call(f"set {name} to {value:g}", self._device.set_float_feature_value, name, value)

    def read_integer(self, name: str) -> int:
        """Value of an integer feature."""
        return int(self.call(f"read {name}", self._device.get_integer_feature_value, name))

    def write_integer(self, name: str, value: int) -> None:
        """Write an integer feature."""
        self.call(f"set {name} to {value}", self._device.set_integer_feature_value, name, value)

    def write_boolean(self, name: str, value: bool) -> None:
        """Write a boolean feature."""
        self.call(f"set {name} to {value}", self._device.set_boolean_feature_value, name, value)

    def read_entry(self, name: str) -> str:
        """The entry an enumeration stands at."""
        return str(self.call(f"read {name}", self._device.get_string_feature_value, name))

    def write_entry(self, name: str, entry: str) -> None:
        """Choose an entry of an enumeration."""
        self.call(f"set {name} to {entry}", self._device.set_string_feature_value, name, entry)

    def execute(self, name: str) -> None:
        """Execute a command feature."""
        self.call(f"execute {name}", self._device.execute_command, name)


class AravisCamera:
    """An opened camera (see `drivers.camera.Camera`); made by `open_camera`."""

    def __init__(self, found: FoundCamera, camera: Any, nodes: AravisNodes, setup: CameraSetup) -> None:
        self._camera = camera
        self._nodes = nodes
        self._frames = threading.Lock()
        self._closed = threading.Event()
        nodes.call("stop acquisition", camera.stop_acquisition)
        choose_pixel_format(nodes, setup.pixel_format)
        set_binning(nodes, setup.binning)
        switch_auto_off(nodes)
        trigger_lacks = arm_trigger(nodes, setup.trigger)
        self._dialect = find_dialect(nodes)
        self._chunked, chunk_lacks = enable_chunks(nodes, self._dialect.gain_node is not None)
        self._clock, clock_lacks = find_clock(nodes)
        lacks = (*self._dialect.lacks, *trigger_lacks, *chunk_lacks, *clock_lacks)
        self._description = CameraDescription(found.vendor, found.model, found.serial, lacks)
        self._limits = self._dialect.limits(nodes)
        self._setting: ExposureSetting | None = self._dialect.read(nodes)
        self._ledger = SettingLedger(self._setting)
        self._frame_ids = FrameIdUnwrapper()
        self._unreadable = False
        self._stream = _create_stream(camera, nodes, setup)
        self._chunks = camera.create_chunk_parser()
        # The handler runs on a thread of Aravis and must never be the last to hold the camera: it knows the event only.
        lost = nodes.silent
        self._control_lost = camera.get_device().connect("control-lost", lambda _device: lost.set())

    @property
    def description(self) -> CameraDescription:
        """Who the camera is, and what it lacks."""
        return self._description

    @property
    def limits(self) -> ExposureLimits:
        """Bounds and increments of exposure time and gain, as found when the camera was opened."""
        return self._limits

    def start(self) -> None:
        """Start acquisition."""
        self._check_present()
        self._nodes.call("start acquisition", self._camera.start_acquisition)

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """Wait for the next frame; None when none came within `timeout_s`."""
        with self._frames:
            self._check_present()
            buffer = self._stream.timeout_pop_buffer(int(timeout_s * 1e6))
            if buffer is None:
                return None
            arrival_time_ns = time.monotonic_ns()
            try:
                return self._read(buffer, arrival_time_ns)
            finally:
                buffer.set_timestamp(0)  # shows whether the next frame in this buffer brought its leader
                self._stream.push_buffer(buffer)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write what differs from the last setting read back, and return what the nodes read back now."""
        self._check_present()
        present, self._setting = self._setting, None  # unknown, should a node refuse half-way
        self._setting = self._dialect.write(self._nodes, setting, present)
        self._ledger.record(time.monotonic_ns(), self._setting)
        return self._setting

    def latch_clock(self) -> None:
        """Measure anew how the camera's clock maps to the host's."""
        self._check_present()
        self._clock.latch()

    def close(self) -> None:
        """Stop acquisition, give control back and free everything; waits for a `next_frame` under way.

        A camera that does not answer holds this up for 5 to 10 s: Aravis tells it goodbye and awaits the answers.
        """
        self._closed.set()
        with self._frames:
            if self._camera is None:
                return
            device = self._camera.get_device()
            device.disconnect(self._control_lost)
            self._part("stop acquisition", self._camera.stop_acquisition)
            if self._camera.is_gv_device():
                self._part("give control back", device.leave_control)
            self._nodes.release()
            # The stream first: its thread ends while the device is still there to be told.
            self._chunks = self._stream = None
            self._camera = None

    def _part(self, doing: str, function: Callable[[], object]) -> None:
        """One step of parting, left out once the camera is silent: each would block for seconds."""
        if self._nodes.silent.is_set():
            return
        try:
            self._nodes.call(doing, function)
        except CameraError as error:
            _log.warning("%s", error)

    def _check_present(self) -> None:
        if self._closed.is_set():
            raise CameraLostError(f"camera {self._description.serial} is closed")
        if self._nodes.silent.is_set():
            raise CameraLostError(f"camera {self._description.serial} does not answer any more")

    def _read(self, buffer: Any, arrival_time_ns: int) -> Frame | IncompleteFrame | None:
        status = buffer.get_status()
        if status != Aravis.BufferStatus.SUCCESS and status not in _HOLES:
            return None  # emptied by a stop
        device_time_ns = buffer.get_timestamp()
        if status in _HOLES and not device_time_ns:
            return None  # its leader is among what was lost, and with it its number: the gap in the ids tells of it
        frame_id = self._frame_ids.unwrap(buffer.get_frame_id())
        host_time_ns = self._clock.host_time_ns(device_time_ns, arrival_time_ns)
        if status in _HOLES:
            return IncompleteFrame(frame_id, host_time_ns)
        try:
            width, height = buffer.get_image_width(), buffer.get_image_height()
            pixels, bit_depth = decode_pixels(buffer.get_data(), buffer.get_image_pixel_format(), width, height)
            setting = self._read_setting(buffer) if self._chunked else self._ledger.setting_at(host_time_ns)
        except (ValueError, GLib.Error) as error:
            if not self._unreadable:
                _log.warning(
                    "camera %s: frames cannot be read, the first is %d: %s", self._description.serial, frame_id, error
                )
            self._unreadable = True
            return IncompleteFrame(frame_id, host_time_ns)
        return Frame(pixels, bit_depth, frame_id, device_time_ns, host_time_ns, arrival_time_ns, setting)

    def _read_setting(self, buffer: Any) -> ExposureSetting:
        exposure_time_us = self._chunks.get_float_value(buffer, "ChunkExposureTime")
        if self._dialect.gain_node is None:
            return ExposureSetting(exposure_time_us, 0.0)
        return ExposureSetting(exposure_time_us, self._chunks.get_float_value(buffer, "ChunkGain"))


def _create_stream(camera: Any, nodes: AravisNodes, setup: CameraSetup) -> Any:
    """The stream with its pool of buffers, made once chunks and format are set, as they decide the payload's size."""
    if camera.is_gv_device():
        # The kernel hands packet sockets over in 5 ms blocks; a plain socket is quicker.
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        if setup.packet_size_bytes is None:
            nodes.call("find the packet size", camera.gv_auto_packet_size)
        else:
            nodes.call("set the packet size", camera.gv_set_packet_size, setup.packet_size_bytes)
    stream = nodes.call("open the stream", camera.create_stream, None, None)
    if camera.is_gv_device():
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", setup.socket_buffer_bytes)
        stream.set_property("packet-timeout", int(setup.packet_timeout_ms * 1e3))
        stream.set_property("frame-retention", FRAME_RETENTION_US)
    payload_bytes = nodes.call("read the payload size", camera.get_payload)
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(payload_bytes))
    return stream
