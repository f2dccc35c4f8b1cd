"""The setting that a frame was taken with."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from drivers.genicam.hold import hold, offered, switch
from drivers.genicam.nodes import NodeMap
from drivers.genicam.quantity import us_per_unit
from drivers.genicam.write_latency import WriteLatency
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting

LEDGER_LENGTH = 64
"""Writes remembered: at one per frame, a second at 60 Hz, longer than any frame takes to arrive."""

_INFERRED = "a frame's setting is inferred from when it was written"


class SettingLedger:
    """Which setting a frame was taken with, for cameras that do not say so themselves.

    A setting applies to exposures that start at least the camera's latency after it was read back. The latency counts
    as zero until the brightness of frames has shown another (`WriteLatency`).
    """

    def __init__(self, setting: ExposureSetting) -> None:
        self._lock = threading.Lock()
        self._writes = deque([(0, setting)], maxlen=LEDGER_LENGTH)
        self._latency = WriteLatency()

    def record(self, host_time_ns: int, setting: ExposureSetting) -> None:
        """Note that the nodes read back `setting` at `host_time_ns`; times must not decrease."""
        with self._lock:
            self._latency.write(host_time_ns, setting.level - self._writes[-1][1].level)
            self._writes.append((host_time_ns, setting))

    def observe(self, host_time_ns: int, grey: float) -> None:
        """Learn from the mean grey level of the frame whose exposure started at `host_time_ns`, in their order."""
        with self._lock:
            self._latency.frame(host_time_ns, grey)

    def setting_at(self, host_time_ns: int) -> ExposureSetting:
        """The setting of an exposure that started at `host_time_ns`; before all writes, the oldest one remembered."""
        with self._lock:
            for written_ns, setting in reversed(self._writes):
                if written_ns + self._latency.latency_ns <= host_time_ns:
                    return setting
            return self._writes[0][1]


@dataclass(frozen=True, slots=True)
class ChunkNodes:
    """The chunk nodes that hold a frame's setting: exposure time in units of `us_per_unit`; `gain`, if it is driven.

    `gain` is in the numbers of the node that drives it; `gain_is_integer`: the chunk is read as an integer.
    """

    exposure_time: str
    us_per_unit: float
    gain: str | None
    gain_is_integer: bool = False


def enable_chunks(nodes: NodeMap, gain_node: str | None) -> tuple[ChunkNodes | None, tuple[str, ...]]:
    """Have each frame carry its exposure time and gain; None if the camera cannot, with the limitation in words.

    `gain_node` is what drives the gain, None if nothing does.
    """
    raw = gain_node == "GainRaw"
    wanted = ("ExposureTime", *(() if gain_node is None else ("GainAll",) if raw else ("Gain",)))
    try:
        if nodes.exists("ChunkSelector") and nodes.available("ChunkModeActive"):
            switch(nodes, "ChunkModeActive", True)  # first: some selectors exist only while it is on
            named = all(nodes.exists(f"Chunk{chunk}") for chunk in wanted)
            chunk_us = us_per_unit(nodes.unit("ChunkExposureTime")) if named else None
            if chunk_us is not None and set(wanted) <= set(offered(nodes, "ChunkSelector")):
                for chunk in wanted:
                    hold(nodes, "ChunkSelector", chunk)
                    switch(nodes, "ChunkEnable", True)
                gain = None if gain_node is None else f"Chunk{wanted[1]}"
                is_integer = gain is not None and nodes.is_integer(gain)
                return ChunkNodes("ChunkExposureTime", chunk_us, gain, is_integer), ()
            switch(nodes, "ChunkModeActive", False)
    except NodeError as error:
        return None, (f"{_INFERRED} (chunk data cannot be switched on: {error})",)
    return None, (f"no chunk data of {' and '.join(wanted)}: {_INFERRED}",)
