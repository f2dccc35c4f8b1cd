"""The stream channel: sends frames as leader, payload and trailer, in transfers of the sizes that the host chose."""

from __future__ import annotations

import itertools
import threading
from dataclasses import dataclass

from fake_camera.device.acquisition import Counters
from fake_camera.device.faults import Fault, Faults
from fake_camera.genicam.status import CommandError, Status
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame
from fake_camera.usb3 import u3vsp
from fake_camera.usb3.usb.endpoint import InEndpoint

MEMORY_BYTES = 8 << 20
"""The camera's memory for frames that the host has not fetched, at least two; those that find it full are discarded."""


@dataclass(slots=True)
class TransferSizes:
    """The host's choice: a frame is a leader, `payload_count` transfers, two that may be shorter, and a trailer."""

    max_leader_bytes: int = 0
    payload_bytes: int = 0
    payload_count: int = 0
    final1_bytes: int = 0
    final2_bytes: int = 0
    max_trailer_bytes: int = 0


class StreamChannel:
    """The stream of one camera, with the settings of the SIRM.

    Attributes
    ----------
    enabled
        Whether frames are sent.
    sizes
        Sizes of the transfers in which they are sent.
    """

    LEADER_BYTES = u3vsp.LEADER_BYTES
    TRAILER_BYTES = u3vsp.MAX_TRAILER_BYTES

    def __init__(self, endpoint: InEndpoint, faults: Faults, counters: Counters) -> None:
        self._endpoint = endpoint
        self._faults = faults
        self._counters = counters
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Back to the power-on state."""
        with self._lock:
            self.enabled = False
            self.sizes = TransferSizes()

    def set_size(self, name: str, value: int) -> None:
        """Set one of the sizes; raises CommandError ACCESS_DENIED while the stream is on."""
        if self.enabled:
            raise CommandError(Status.ACCESS_DENIED)
        setattr(self.sizes, name, value)

    def enable(self, on: bool) -> None:
        """Start or stop sending frames; what the host has not fetched is dropped.

        Raises CommandError: STREAM_HALTED, or STREAM_SIZES_INCONSISTENT when leader or trailer do not fit their
        transfers.
        """
        if on and self._endpoint.halted:
            raise CommandError(Status.STREAM_HALTED)
        fits = self.sizes.max_leader_bytes >= self.LEADER_BYTES and self.sizes.max_trailer_bytes >= self.TRAILER_BYTES
        if on and not fits:
            raise CommandError(Status.STREAM_SIZES_INCONSISTENT)
        with self._lock:
            self.enabled = on
            self._endpoint.flush()

    def send(self, frame: ExposedFrame, chunks: bytes) -> None:
        """Send a frame with its chunk data, unless the stream is off or the camera's memory is full."""
        image = PIXEL_FORMATS[frame.settings.pixel_format].on_the_wire(frame.pixels)
        payload = memoryview(b"".join((image, chunks))) if chunks else image
        with self._lock:
            if not self.enabled:
                return
            if self._endpoint.backlog_bytes + len(payload) > max(MEMORY_BYTES, 2 * len(payload)):
                self._counters.discarded += 1
            elif self._faults.spoils_frame(Fault.STALL):
                self._endpoint.halt()
            else:
                self._endpoint.write(*self._transfers(frame, payload, bool(chunks)))

    def _transfers(self, frame: ExposedFrame, payload: memoryview, has_chunks: bool) -> list[bytes | memoryview]:
        sent = payload
        if self._faults.spoils_frame(Fault.TRUNCATE):
            sent = payload[: len(payload) // 2]
        pieces = self._cut(sent)
        sent_bytes = sum(len(piece) for piece in pieces)
        trailer = u3vsp.trailer(frame, has_chunks, sent_bytes, len(payload))
        if self._faults.spoils_frame(Fault.SHORT_TRAILER):
            trailer = trailer[:8]
        return [u3vsp.leader(frame, has_chunks), *pieces, trailer]

    def _cut(self, payload: memoryview) -> list[memoryview]:
        """The payload cut into the transfers that the host expects; what does not fit is discarded."""
        sizes = self.sizes
        equal = itertools.repeat(sizes.payload_bytes, sizes.payload_count if sizes.payload_bytes else 0)
        pieces = []
        for size in itertools.chain(equal, (sizes.final1_bytes, sizes.final2_bytes)):
            if not payload:
                break
            if size:
                pieces.append(payload[:size])
                payload = payload[size:]
        return pieces
