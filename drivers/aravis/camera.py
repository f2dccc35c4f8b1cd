"""A camera opened through Aravis: its stream of frames and the writing of its settings."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from drivers.aravis.discovery import FoundCamera
from drivers.aravis.introspection import Aravis, GLib, genicam_xml
from drivers.aravis.nodes import AravisNodes
from drivers.aravis.stream import DroppedFrames, create_stream, row_padding_bytes
from drivers.camera import CameraDescription, ClockReading, IncompleteFrame, RefusedPackets
from drivers.genicam.dialect import find_dialect, switch_auto_off, switch_gamma_off
from drivers.genicam.features import apply_features
from drivers.genicam.image_format import (
    choose_pixel_format,
    decode_pixels,
    frame_size,
    send_low_byte_first,
    set_binning,
    switch_white_balance_off,
)
from drivers.genicam.metadata import SettingLedger, enable_chunks
from drivers.genicam.nodes import fixed_selectors, unlock
from drivers.genicam.timeline import FrameTimeline, find_clock
from drivers.genicam.trigger import SOFTWARE_TRIGGER, action_queue, arm_trigger, timing_limitations
from drivers.host.network import ActionSender
from drivers.ptp import PtpNodes
from drivers.setup import ACTION_KEYS, CameraSetup
from imaging.errors import (
    CameraBusyError,
    CameraError,
    CameraLostError,
    ConfigurationError,
    NodeError,
    UnsupportedCameraError,
)
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource
from imaging.pixels import Pixels, light_samples

SPARSE = 8
"""One row and column in this many is enough to see the brightness change."""
_HOLES = (
    Aravis.BufferStatus.TIMEOUT,
    Aravis.BufferStatus.MISSING_PACKETS,
    Aravis.BufferStatus.WRONG_PACKET_ID,
    Aravis.BufferStatus.SIZE_MISMATCH,
)
_HOST_STAMPS = (
    "its time stamps have no unit, as GevTimestampTickFrequency reads 0: its frames are placed by their arrival, late "
    "by readout and transfer"
)
_log = logging.getLogger(__name__)


class AravisCamera:
    """An opened camera (see `drivers.camera.Camera`); made by `open_camera`."""

    def __init__(self, found: FoundCamera, camera: Any, nodes: AravisNodes, setup: CameraSetup) -> None:
        self._camera = camera
        self._nodes = nodes
        self._frames = threading.Lock()
        self._closed = threading.Event()
        if nodes.exists("AcquisitionStop"):
            nodes.call("stop acquisition", camera.stop_acquisition)
        unlock(nodes)
        switch_auto_off(nodes)  # so that nothing locks, or overwrites, what is set
        switch_white_balance_off(nodes, setup.pixel_format)
        apply_features(nodes, setup)
        switch_auto_off(nodes)
        # First: a camera that cannot expose fails for that.
        self._dialect = find_dialect(nodes, setup.gain_scale, setup.exposure_count_us)
        self._pixel_format = choose_pixel_format(nodes, setup.pixel_format)
        send_low_byte_first(nodes, self._pixel_format)
        of_colours = switch_white_balance_off(nodes, self._pixel_format)
        set_binning(nodes, setup.binning)
        if setup.trigger.mode == "ptp" and found.transport != "gige":
            raise ConfigurationError(
                f"camera {found.serial} is on USB3 Vision, where there is no PTP: choose another trigger.mode"
            )
        of_trigger = arm_trigger(nodes, setup.trigger)
        self._ptp = PtpNodes(nodes) if setup.trigger.mode == "ptp" else None  # before the clock: it changes its ticks
        of_ptp = () if self._ptp is None else self._ptp.limitations
        of_gamma = switch_gamma_off(nodes)
        gain_node = None if self._dialect.gain is None else self._dialect.gain.node
        self._chunk_nodes, of_chunks = enable_chunks(nodes, gain_node)
        self._clock, of_clock = find_clock(nodes)
        # Without a tick frequency Aravis stamps frames with the host's time, when their first packet arrives.
        self._host_stamps = camera.is_gv_device() and not camera.get_device().get_timestamp_tick_frequency()
        if self._ptp is not None and (self._clock is None or self._host_stamps):
            raise UnsupportedCameraError(
                f"camera {found.serial}: it has no TimestampLatch, and so its PTP time cannot be read: choose another "
                "trigger.mode"
            )
        of_timing = timing_limitations(nodes, setup.trigger)
        of_stamps = (_HOST_STAMPS,) if self._host_stamps else ()
        of_camera = (*of_trigger, *of_ptp, *of_timing, *of_gamma, *of_colours, *of_chunks, *of_clock, *of_stamps)
        limitations = (*self._dialect.limitations, *of_camera)
        self._description = CameraDescription(
            found.vendor,
            found.model,
            found.serial,
            limitations,
            self._pixel_format,
            gain_node,
            frame_size(nodes),
            1 if self._ptp is None else action_queue(nodes),
        )
        self._limits = self._dialect.limits(nodes)
        self._setting: ExposureSetting | None = self._dialect.settle(nodes, self._limits)
        self._ledger = SettingLedger(self._setting)
        self._timeline = FrameTimeline(
            None if setup.trigger.rate_hz is None else 1e9 / setup.trigger.rate_hz,
            None if self._clock is None or self._host_stamps else self._clock.read(),
            1.0 if self._clock is None else self._clock.tick_ns,
            stamped=not self._host_stamps,
        )
        self._unreadable = False
        self._stream, self._guard = create_stream(camera, nodes, setup)
        self._dropped = DroppedFrames(found.serial)
        self._chunks = camera.create_chunk_parser()
        self._actions = None if self._ptp is None else _action_sender(found)
        # The handler runs on a thread of Aravis and must never hold the last reference to the camera, only the event.
        lost = nodes.silent
        self._control_lost = camera.get_device().connect("control-lost", lambda _device: lost.set())
        for fixed in fixed_selectors(nodes):
            _log.info("camera %s: %s", found.serial, fixed)

    @property
    def description(self) -> CameraDescription:
        """The camera's identity and limitations."""
        return self._description

    @property
    def description_xml(self) -> str:
        """Its GenICam description."""
        return genicam_xml(self._camera.get_device())

    @property
    def limits(self) -> ExposureLimits:
        """Bounds and increments of exposure time and gain, as found when the camera was opened."""
        return self._limits

    def start(self) -> None:
        """Start acquisition."""
        self._check_present()
        self._nodes.call("start acquisition", self._camera.start_acquisition)

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """Wait for the next frame; None if none arrives within `timeout_s`."""
        with self._frames:
            self._check_present()
            buffer = self._stream.timeout_pop_buffer(int(timeout_s * 1e6))
            if buffer is None:
                self._dropped.waited(self._stream)
                return None
            self._dropped.arrived(self._stream)
            arrival_time_ns = time.monotonic_ns()
            try:
                return self._read(buffer, arrival_time_ns)
            finally:
                buffer.set_timestamp(0)  # still 0 if the next frame in this buffer arrives without its leader
                self._stream.push_buffer(buffer)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write what differs from the last setting read back, and return what the nodes read back."""
        self._check_present()
        present, self._setting = self._setting, None  # unknown if a node refuses half-way
        try:
            with self._nodes.unchecked():
                self._setting = self._dialect.write(self._nodes, setting, present)
        except (NodeError, CameraBusyError):
            self._record_what_was_taken()
            raise
        self._ledger.record(time.monotonic_ns(), self._setting)
        return self._setting

    def _record_what_was_taken(self) -> None:
        """Note what the nodes hold after a refusal, if they say: one may have changed, and frames are taken with it."""
        with contextlib.suppress(CameraError):
            held = self._dialect.read(self._nodes)
            if held.is_physical:
                self._ledger.record(time.monotonic_ns(), held)

    def trigger(self) -> None:
        """Take a frame now."""
        self._check_present()
        with self._nodes.unchecked():  # a check would be a round trip, and delay it by that
            self._nodes.execute(SOFTWARE_TRIGGER)

    def schedule(self, device_time_ns: int) -> None:
        """Take a frame when the camera's clock shows this; NodeError if it cannot be sent, or an earlier one failed."""
        self._check_present()
        assert self._actions is not None
        serial = self._description.serial
        try:
            refused = self._actions.send(ACTION_KEYS, device_time_ns)
        except OSError as error:
            raise NodeError(f"camera {serial}: no action command could be sent: {error.strerror or error}") from None
        if refused is not None:
            raise NodeError(f"camera {serial} refused a scheduled action: {refused}")

    def latch_clock(self) -> ClockReading | None:
        """Measure again how the camera's clock maps to the host's, and whether PTP synchronises it."""
        self._check_present()
        state = None if self._ptp is None else self._ptp.read()
        if self._clock is None:
            return None
        offset_ns = self._clock.read()
        if not self._host_stamps:
            self._timeline.read(offset_ns)
        return None if state is None else ClockReading(offset_ns, state)

    def refused_packets(self) -> RefusedPackets | None:
        """What was sent to its stream since the last call and looked foreign; None: nothing."""
        self._check_present()
        return None if self._guard is None else self._guard.refused()

    def close(self) -> None:
        """Stop acquisition, release control and free everything; waits for a `next_frame` in progress.

        A camera that does not answer delays this by 5 to 10 s: Aravis says goodbye and waits for the answers.
        """
        self._closed.set()
        with self._frames:
            if self._camera is None:
                return
            device = self._camera.get_device()
            device.disconnect(self._control_lost)
            if self._nodes.exists("AcquisitionStop"):
                self._closing_step("stop acquisition", self._camera.stop_acquisition)
            if self._camera.is_gv_device():
                self._closing_step("release control", device.leave_control)
            if self._actions is not None:
                self._actions.close()
            if self._guard is not None:
                self._guard.close()
            self._nodes.release()
            # The stream first: its thread must end while the device still exists.
            self._chunks = self._stream = None
            self._camera = None

    def _closing_step(self, action: str, function: Callable[[], object]) -> None:
        """One step of closing, skipped once the camera is silent: each would block for seconds."""
        if self._nodes.silent.is_set():
            return
        try:
            self._nodes.call(action, function)
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
            return None  # cleared by a stop
        stamp_ns = buffer.get_timestamp()
        if status in _HOLES and not stamp_ns:
            return None  # its leader was lost, and with it its id: the gap in the ids will show it
        said = None if status in _HOLES else self._read_chunks(buffer)
        exposure_ns = round(1e3 * (said or self._ledger.setting_at(arrival_time_ns)).exposure_time_us)
        placed = self._timeline.place(buffer.get_frame_id(), stamp_ns, arrival_time_ns, exposure_ns)
        if status in _HOLES or placed.host_time_ns is None:
            return placed.incomplete
        try:
            width, height = buffer.get_image_width(), buffer.get_image_height()
            pixels = decode_pixels(
                buffer.get_data(),
                buffer.get_image_pixel_format(),
                width,
                height,
                self._pixel_format,
                has_chunks=buffer.has_chunks(),
                row_padding_bytes=row_padding_bytes(buffer),
            )
        except ValueError as error:
            if not self._unreadable:
                _log.warning(
                    "camera %s: frames cannot be read, the first is %d: %s",
                    self._description.serial,
                    placed.frame_id,
                    error,
                )
            self._unreadable = True
            return placed.incomplete
        setting, source = self._taken_with(said, pixels, placed.host_time_ns)
        return Frame(
            pixels,
            self._pixel_format.bit_depth,
            placed.frame_id,
            placed.device_time_ns,
            placed.host_time_ns,
            arrival_time_ns,
            setting,
            source,
            self._pixel_format.layout,
            placed.by_arrival,
            placed.clock_trouble,
        )

    def _taken_with(
        self, said: ExposureSetting | None, pixels: Pixels, host_time_ns: int
    ) -> tuple[ExposureSetting, SettingSource]:
        if said is not None:
            return said, "chunk"
        samples = light_samples(pixels, self._pixel_format.layout)
        self._ledger.observe(host_time_ns, float(samples[::SPARSE, ::SPARSE].mean()))
        return self._ledger.setting_at(host_time_ns), "ledger"

    def _read_chunks(self, buffer: Any) -> ExposureSetting | None:
        """The setting in a frame's own chunks; None if it carries none, or an impossible one."""
        chunks = self._chunk_nodes
        if chunks is None or not buffer.has_chunks():
            return None
        try:
            exposure_time_us = self._chunks.get_float_value(buffer, chunks.exposure_time) * chunks.us_per_unit
            gain_db = 0.0 if chunks.gain is None else self._read_gain_chunk(buffer, chunks.gain, chunks.gain_is_integer)
        except GLib.Error:
            return None
        setting = ExposureSetting(exposure_time_us, gain_db)
        return setting if setting.is_physical else None

    def _read_gain_chunk(self, buffer: Any, name: str, raw: bool) -> float:
        value = (self._chunks.get_integer_value if raw else self._chunks.get_float_value)(buffer, name)
        return float(value) if self._dialect.gain is None else self._dialect.gain.ours(value)


def _action_sender(found: FoundCamera) -> ActionSender:
    try:
        return ActionSender(found.address)
    except OSError as error:
        why = error.strerror or str(error)
    # Outside `except`: the traceback of its error would keep the camera open, see `open_camera`.
    raise CameraBusyError(f"camera {found.serial}: no action command could be sent: {why}")
