"""A camera opened through Aravis: its frames, the writing of its settings, and its clock."""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from dataclasses import dataclass
from typing import Any

from drivers.aravis.nodes import Aravis, AravisNodes, GLib
from drivers.aravis.stream import FrameStream
from drivers.camera import CameraDescription, ClockReading, IncompleteFrame, RefusedPackets
from drivers.genicam.dialect import ExposureDialect
from drivers.genicam.image_format import decode_pixels
from drivers.genicam.metadata import ChunkNodes, SettingLedger
from drivers.genicam.nodes import Quantity, is_number
from drivers.genicam.timeline import FrameTimeline, LatchedClock
from drivers.genicam.trigger import SOFTWARE_TRIGGER, PtpNodes
from drivers.host.network import ActionSender
from drivers.setup import ACTION_KEYS
from imaging.errors import CameraBusyError, CameraError, CameraLostError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource
from imaging.pixels import PixelFormat, Pixels, light_samples

SPARSE = 8
"""One row and column in this many is enough to see the brightness change."""
_HOLES = (
    Aravis.BufferStatus.TIMEOUT,
    Aravis.BufferStatus.MISSING_PACKETS,
    Aravis.BufferStatus.WRONG_PACKET_ID,
    Aravis.BufferStatus.SIZE_MISMATCH,
)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class ChunkReader:
    """Reads the setting that a frame carries in its chunks, with the parser of Aravis; `gain` is what drives it."""

    parser: Any
    nodes: ChunkNodes
    gain: Quantity | None

    def setting(self, buffer: Any) -> ExposureSetting | None:
        """The setting in a frame's chunks; None if it carries none, or an impossible one."""
        if not buffer.has_chunks():
            return None
        try:
            time_us = self.parser.get_float_value(buffer, self.nodes.exposure_time) * self.nodes.us_per_unit
            gain_db = 0.0 if self.nodes.gain is None else self._gain_db(buffer, self.nodes.gain)
        except GLib.Error:
            return None
        setting = ExposureSetting(time_us, gain_db)
        return setting if setting.is_physical else None

    def _gain_db(self, buffer: Any, name: str) -> float:
        raw = self.nodes.gain_is_integer
        value = (self.parser.get_integer_value if raw else self.parser.get_float_value)(buffer, name)
        return float(value) if self.gain is None else self.gain.ours(value)


@dataclass(slots=True)
class FrameReader:
    """Makes frames of Aravis' buffers, each with its number, its time and the setting it was taken with.

    `pixel_format` is what the camera was set to. Without `chunks` frames carry no setting: the ledger knows it.
    """

    serial: str
    pixel_format: PixelFormat
    ledger: SettingLedger
    timeline: FrameTimeline
    chunks: ChunkReader | None
    unreadable: bool = False

    def read(self, buffer: Any, arrival_time_ns: int) -> Frame | IncompleteFrame | None:
        """The frame in a buffer; None if nothing is known of it."""
        holes = buffer.get_status() in _HOLES
        if not holes and buffer.get_status() != Aravis.BufferStatus.SUCCESS:
            return None  # cleared by a stop
        stamp_ns = buffer.get_timestamp()
        if holes and not stamp_ns:
            return None  # its leader was lost, and with it its id: the gap in the ids will show it
        said = None if holes or self.chunks is None else self.chunks.setting(buffer)
        exposure_ns = round(1e3 * (said or self.ledger.setting_at(arrival_time_ns)).exposure_time_us)
        placed = self.timeline.place(buffer.get_frame_id(), stamp_ns, arrival_time_ns, exposure_ns)
        if holes or placed.host_time_ns is None:
            return placed.incomplete
        try:
            pixels = self._pixels(buffer)
        except ValueError as error:
            if not self.unreadable:
                what = f"frames cannot be read, the first is {placed.frame_id}"
                _log.warning("camera %s: %s: %s", self.serial, what, error)
            self.unreadable = True
            return placed.incomplete
        setting, source = self._taken_with(said, pixels, placed.host_time_ns)
        return Frame(
            pixels,
            self.pixel_format.bit_depth,
            placed.frame_id,
            placed.device_time_ns,
            placed.host_time_ns,
            arrival_time_ns,
            setting,
            source,
            self.pixel_format.layout,
            placed.by_arrival,
            placed.clock_trouble,
        )

    def _pixels(self, buffer: Any) -> Pixels:
        # Aravis 0.8.20 does not say by how many bytes rows are padded.
        padding_bytes = int(buffer.get_image_padding()[0]) if hasattr(buffer, "get_image_padding") else 0
        return decode_pixels(
            buffer.get_data(),
            buffer.get_image_pixel_format(),
            buffer.get_image_width(),
            buffer.get_image_height(),
            self.pixel_format,
            has_chunks=buffer.has_chunks(),
            row_padding_bytes=padding_bytes,
        )

    def _taken_with(
        self, said: ExposureSetting | None, pixels: Pixels, host_time_ns: int
    ) -> tuple[ExposureSetting, SettingSource]:
        if said is not None:
            return said, "chunk"
        samples = light_samples(pixels, self.pixel_format.layout)
        self.ledger.observe(host_time_ns, float(samples[::SPARSE, ::SPARSE].mean()))
        return self.ledger.setting_at(host_time_ns), "ledger"


_TEMPERATURE = "DeviceTemperature"
"""SFNC: in degrees Celsius, of what DeviceTemperatureSelector names, as the camera or `features` has it."""


class AravisCamera:
    """An opened camera (see `drivers.camera.Camera`) that is set up: `open_camera` does both.

    `setting` is what its nodes hold. Without a `clock` the camera's own cannot be read. `ptp` and `actions` are for the
    trigger mode "ptp".
    """

    def __init__(
        self,
        nodes: AravisNodes,
        description: CameraDescription,
        *,
        limits: ExposureLimits,
        dialect: ExposureDialect,
        setting: ExposureSetting,
        stream: FrameStream,
        frames: FrameReader,
        clock: LatchedClock | None = None,
        ptp: PtpNodes | None = None,
        actions: ActionSender | None = None,
    ) -> None:
        self.description = description
        self.limits = limits
        self.dialect = dialect
        self._nodes = nodes
        self._stream = stream
        self._frames = frames
        self._clock = clock
        self._ptp = ptp
        self._actions = actions
        self._setting: ExposureSetting | None = setting
        self._taking = threading.Lock()
        self._closing = threading.Event()
        self._closed = False

    @property
    def description_xml(self) -> str:
        """Its GenICam description."""
        return self._nodes.description_xml()

    def start(self) -> None:
        """Start acquisition."""
        self._check_present()
        self._nodes.call("start acquisition", self._nodes.camera.start_acquisition)

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """Wait for the next frame; None if none arrives within `timeout_s`."""
        with self._taking:
            self._check_present()
            with self._stream.next_buffer(timeout_s) as buffer:
                return None if buffer is None else self._frames.read(buffer, time.monotonic_ns())

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write what differs from the last setting read back, and return what the nodes read back."""
        self._check_present()
        present, self._setting = self._setting, None  # unknown if a node refuses half-way
        try:
            with self._nodes.unchecked():
                self._setting = self.dialect.write(self._nodes, setting, present)
        except (NodeError, CameraBusyError):
            self._record_what_was_taken()
            raise
        self._frames.ledger.record(time.monotonic_ns(), self._setting)
        return self._setting

    def _record_what_was_taken(self) -> None:
        """Note what the nodes hold after a refusal, if they say: one may have changed, and frames are taken with it."""
        with contextlib.suppress(CameraError):
            held = self.dialect.read(self._nodes)
            if held.is_physical:
                self._frames.ledger.record(time.monotonic_ns(), held)

    def trigger(self) -> None:
        """Take a frame now."""
        self._check_present()
        with self._nodes.unchecked():  # a check would be a round trip, and delay it by that
            self._nodes.execute(SOFTWARE_TRIGGER)

    def schedule(self, device_time_ns: int) -> None:
        """Take a frame when the camera's clock shows this; NodeError if it cannot be sent, or an earlier one failed."""
        self._check_present()
        assert self._actions is not None
        serial = self.description.serial
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
        self._frames.timeline.read(offset_ns)
        return None if state is None else ClockReading(offset_ns, state)

    def temperature_c(self) -> float | None:
        """How warm it is inside, degrees Celsius; None if it does not say, now or ever."""
        self._check_present()
        if not is_number(self._nodes, _TEMPERATURE):
            return None
        try:
            temperature_c = float(self._nodes.read(_TEMPERATURE))
        except (NodeError, CameraBusyError):
            return None
        return temperature_c if math.isfinite(temperature_c) else None

    def refused_packets(self) -> RefusedPackets | None:
        """What was sent to its stream since the last call and looked foreign; None: nothing."""
        self._check_present()
        return self._stream.refused()

    def close(self) -> None:
        """Stop acquisition and free everything, which gives up control; waits for a `next_frame` in progress.

        A camera that does not answer delays this by 5 to 10 s: Aravis says goodbye and waits for the answers.
        """
        self._closing.set()
        with self._taking:
            if self._closed:
                return
            self._closed = True
            if not self._nodes.silent.is_set():  # else that would block for seconds
                try:
                    self._nodes.stop_acquisition()
                except CameraError as error:
                    _log.warning("%s", error)
            if self._actions is not None:
                self._actions.close()
            self._frames.chunks = None
            self._stream.close()
            self._nodes.release()

    def _check_present(self) -> None:
        if self._closing.is_set():
            raise CameraLostError(f"camera {self.description.serial} is closed")
        if self._nodes.silent.is_set():
            raise CameraLostError(f"camera {self.description.serial} does not answer any more")
