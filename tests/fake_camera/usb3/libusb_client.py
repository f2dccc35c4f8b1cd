"""A minimal USB3 Vision host on stock libusb, with any number of pending transfers.

By hand, under the shim:
python -m fake_camera --usb3 --exec python -m tests.fake_camera.usb3.libusb_client FRAMES SECONDS
"""

from __future__ import annotations

import ctypes as c
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from fake_camera.usb3.usb.descriptors import CONTROL_IN, CONTROL_OUT, PRODUCT_ID, STREAM_IN, VENDOR_ID
from tests.fake_camera.usb3.usb3_client import READMEM, SBRM_ADDRESS, WRITEMEM

LEADER_BYTES = TRAILER_BYTES = 1024
TIMEOUT_MS = 5000
TIMED_OUT = -7
_BULK = 2


class _Timeval(c.Structure):
    _fields_ = (("seconds", c.c_long), ("microseconds", c.c_long))


class _Transfer(c.Structure):
    """libusb_transfer, without isochronous packets."""


_Callback = c.CFUNCTYPE(None, c.POINTER(_Transfer))
_Transfer._fields_ = (
    ("device", c.c_void_p), ("flags", c.c_uint8), ("endpoint", c.c_uint8), ("type", c.c_uint8), ("timeout", c.c_uint),
    ("status", c.c_int), ("length", c.c_int), ("actual_length", c.c_int), ("callback", _Callback),
    ("user_data", c.c_void_p), ("buffer", c.c_void_p), ("packets", c.c_int),
)  # fmt: skip


@dataclass(slots=True)
class Slot:
    """The transfers of one frame: leader, payload in pieces, trailer."""

    buffers: list[Any]
    transfers: list[Any] = field(default_factory=list)

    def frame(self) -> tuple[int, bytes]:
        """Frame id and payload of what has arrived."""
        leader, *pieces, trailer = (
            c.string_at(buffer, transfer.contents.actual_length)
            for buffer, transfer in zip(self.buffers, self.transfers, strict=True)
        )
        assert (leader[:4], trailer[:4]) == (b"U3VL", b"U3VT")
        ids = struct.unpack_from("<Q", leader, 8), struct.unpack_from("<Q", trailer, 8)
        assert ids[0] == ids[1]
        return ids[0][0], b"".join(pieces)


class LibusbCamera:
    """The first fake camera on the bus, opened."""

    def __init__(self) -> None:
        self._usb = c.CDLL("libusb-1.0.so.0")
        self._usb.libusb_open_device_with_vid_pid.restype = c.c_void_p
        self._usb.libusb_alloc_transfer.restype = c.POINTER(_Transfer)
        self._context = c.c_void_p()
        self._check(self._usb.libusb_init(c.byref(self._context)))
        self._device = c.c_void_p(self._usb.libusb_open_device_with_vid_pid(self._context, VENDOR_ID, PRODUCT_ID))
        assert self._device, "no camera on the bus"
        for interface in (0, 2):
            self._check(self._usb.libusb_claim_interface(self._device, interface))
        self._request_id = 0
        self._sirm = self._number(self._number(SBRM_ADDRESS, 8) + 0x20, 8)
        self.payload_bytes = self._number(self._sirm + 0x08, 8)
        self._waiting = 0
        self._frames: list[tuple[int, bytes]] = []

    def close(self) -> None:
        """Release the camera."""
        self._usb.libusb_close(self._device)
        self._usb.libusb_exit(self._context)

    @contextmanager
    def streaming(self, frames: int, piece_bytes: int) -> Iterator[Iterator[tuple[int, bytes]]]:
        """Frame id and payload of one frame after another, with the transfers of several frames pending."""
        count, rest = divmod(self.payload_bytes, piece_bytes)
        sizes = [LEADER_BYTES, *[piece_bytes] * count, *([rest] if rest else []), TRAILER_BYTES]
        for offset, value in (
            (0x18, LEADER_BYTES), (0x1C, piece_bytes), (0x20, count), (0x24, rest), (0x28, 0), (0x2C, TRAILER_BYTES),
        ):  # fmt: skip
            self._write(self._sirm + offset, value)
        slots = [self._slot(sizes) for _ in range(frames)]
        self._resubmitting = True
        for slot in slots:
            self._submit(slot)
        self._write(self._sirm + 0x04, 1)
        try:
            yield self._arriving()
        finally:
            self._resubmitting = False
            for slot in slots:
                for transfer in slot.transfers:
                    self._usb.libusb_cancel_transfer(transfer)
            while self._waiting:
                self._handle_events()
            self._write(self._sirm + 0x04, 0)
            for slot in slots:
                for transfer in slot.transfers:
                    self._usb.libusb_free_transfer(transfer)

    def read_stream(self, count: int, timeout_ms: int) -> tuple[int, bytes]:
        """One synchronous read, given up after some time: libusb's result (0, or TIMED_OUT) and the data."""
        buffer, moved = c.create_string_buffer(count), c.c_int()
        bulk = self._usb.libusb_bulk_transfer
        result = bulk(self._device, c.c_ubyte(STREAM_IN), buffer, count, c.byref(moved), timeout_ms)
        return result, buffer.raw[: moved.value]

    def _arriving(self) -> Iterator[tuple[int, bytes]]:
        while True:
            while not self._frames:
                self._handle_events()
            yield self._frames.pop(0)

    def _slot(self, sizes: list[int]) -> Slot:
        slot = Slot([c.create_string_buffer(size) for size in sizes])
        done, ended = _Callback(lambda _transfer: self._done()), _Callback(lambda _transfer: self._ended(slot))
        for buffer in slot.buffers:
            transfer = self._usb.libusb_alloc_transfer(0)
            transfer.contents.device, transfer.contents.endpoint = self._device, STREAM_IN
            transfer.contents.type, transfer.contents.timeout = _BULK, 0
            transfer.contents.buffer, transfer.contents.length = c.addressof(buffer), len(buffer)
            transfer.contents.callback = ended if buffer is slot.buffers[-1] else done
            slot.transfers.append(transfer)
        return slot

    def _submit(self, slot: Slot) -> None:
        for transfer in slot.transfers:
            self._check(self._usb.libusb_submit_transfer(transfer))
            self._waiting += 1

    def _done(self) -> None:
        self._waiting -= 1

    def _ended(self, slot: Slot) -> None:
        """The trailer of a frame has arrived, or was cancelled."""
        self._waiting -= 1
        if self._resubmitting:
            self._frames.append(slot.frame())
            self._submit(slot)

    def _handle_events(self) -> None:
        self._check(self._usb.libusb_handle_events_timeout(self._context, c.byref(_Timeval(1, 0))))

    def _number(self, address: int, count: int) -> int:
        return int.from_bytes(self._command(READMEM, struct.pack("<QHH", address, 0, count)), "little")

    def _write(self, address: int, value: int) -> None:
        self._command(WRITEMEM, struct.pack("<QI", address, value))

    def _command(self, command: int, payload: bytes) -> bytes:
        self._request_id += 1
        self._bulk(
            CONTROL_OUT, b"U3VC" + struct.pack("<HHHH", 1 << 14, command, len(payload), self._request_id) + payload
        )
        answer = self._bulk(CONTROL_IN, bytes(1024))
        assert answer[4:6] == b"\0\0", answer[:12]
        return answer[12:]

    def _bulk(self, endpoint: int, data: bytes) -> bytes:
        """One synchronous transfer of what is sent, or of room for what comes."""
        buffer, moved = c.create_string_buffer(data, len(data)), c.c_int()
        bulk = self._usb.libusb_bulk_transfer
        self._check(bulk(self._device, c.c_ubyte(endpoint), buffer, len(data), c.byref(moved), TIMEOUT_MS))
        return buffer.raw[: moved.value]

    def _check(self, result: int) -> None:
        assert result >= 0, f"libusb says {result}"


def main() -> None:
    """Count the frames that come within a time."""
    frames, seconds = int(sys.argv[1]), float(sys.argv[2])
    camera = LibusbCamera()
    with camera.streaming(frames, 1 << 20) as arriving:
        ids, until_s, cpu_s = [next(arriving)[0]], time.monotonic() + seconds, time.process_time()
        while time.monotonic() < until_s:
            ids.append(next(arriving)[0])
        cpu_s = time.process_time() - cpu_s
    gaps = sum(later != earlier + 1 for earlier, later in pairwise(ids))
    print(f"{frames} frames on their way: {len(ids)} came in {seconds:g} s, {gaps} gaps, CPU {cpu_s / seconds:.2f}")


if __name__ == "__main__":
    main()
