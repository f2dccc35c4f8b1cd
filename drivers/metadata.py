"""What is known of a frame besides its pixels: its number, and the setting that it was taken with."""

from __future__ import annotations

import threading
from collections import deque

from drivers.exposure import ExposureSetting
from drivers.nodes import NodeMap

FRAME_ID_CYCLE = 0xFFFF
"""GigE Vision 1 counts frames 1 ... 65535 and skips 0, so that ids repeat after 65535 frames and not 65536."""
LEDGER_LENGTH = 64
"""Writes remembered; at one a frame, a second at 60 Hz, longer than a frame is ever under way."""


class FrameIdUnwrapper:
    """Turns the wire's frame ids into a counter that never restarts.

    Ids beyond 16 bits (USB3 Vision, GigE Vision 2) are such counters already and pass through.
    """

    def __init__(self) -> None:
        self._newest: int | None = None

    def unwrap(self, frame_id: int) -> int:
        """The unwrapped id nearest to the newest one seen: right while gaps stay below half a cycle (32767 frames)."""
        if self._newest is None or frame_id > FRAME_ID_CYCLE:
            unwrapped = frame_id
        else:
            ahead = (frame_id - self._newest) % FRAME_ID_CYCLE
            unwrapped = self._newest + (ahead if ahead <= FRAME_ID_CYCLE // 2 else ahead - FRAME_ID_CYCLE)
        self._newest = unwrapped if self._newest is None else max(self._newest, unwrapped)
        return unwrapped


class SettingLedger:
    """Which setting a frame was taken with, for cameras that do not say so themselves.

    A setting is taken to hold for exposures that start after it was read back. Cameras latch a frame or two later;
    until that delay is measured, the frames right after a write may carry the new setting too early.
    """

    def __init__(self, setting: ExposureSetting) -> None:
        self._lock = threading.Lock()
        self._writes = deque([(0, setting)], maxlen=LEDGER_LENGTH)

    def record(self, host_time_ns: int, setting: ExposureSetting) -> None:
        """Note that the nodes read back `setting` at `host_time_ns`; times must not decrease."""
        with self._lock:
            self._writes.append((host_time_ns, setting))

    def setting_at(self, host_time_ns: int) -> ExposureSetting:
        """The setting last read back before `host_time_ns`; the oldest remembered one for times before all."""
        with self._lock:
            for written_ns, setting in reversed(self._writes):
                if written_ns <= host_time_ns:
                    return setting
            return self._writes[0][1]


def enable_chunks(nodes: NodeMap, gain_driven: bool) -> tuple[bool, tuple[str, ...]]:
    """Have each frame tell its exposure time and gain; whether the camera can, and the lack in words if not."""
    wanted = ("ExposureTime", "Gain") if gain_driven else ("ExposureTime",)
    if nodes.available("ChunkModeActive"):
        nodes.write_boolean("ChunkModeActive", True)
        if set(wanted) <= set(nodes.entries("ChunkSelector")):
            for chunk in wanted:
                nodes.write_entry("ChunkSelector", chunk)
                nodes.write_boolean("ChunkEnable", True)
            return True, ()
        nodes.write_boolean("ChunkModeActive", False)
    return False, (f"no chunk data of {' and '.join(wanted)}: a frame's setting is inferred from when it was written",)
