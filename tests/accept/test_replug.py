"""Cables pulled and plugged in again and again: nothing is left behind, and the other camera does not mind."""

from __future__ import annotations

import ctypes
import gc
import os
import threading
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from fake_camera.device.faults import Fault
from imaging.python310 import Self
from tests.autoexpose_daemon.stereo import Run, running_daemon, stereo_cameras

CYCLES = int(os.environ.get("REPLUG_CYCLES", "5"))
WARM_UP_CYCLES = 2  # the first ones fill caches that stay
TRIGGERS_OUT = 20
GROWTH_BYTES = 2 << 20

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.timeout(120 + 20 * CYCLES),
]


@dataclass(frozen=True)
class Resources:
    """What this process holds; of its threads, those that were not `earlier` than this test."""

    threads: int
    descriptors: int
    bytes: int

    @classmethod
    def now(cls, earlier: Collection[threading.Thread]) -> Self:
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)  # glibc keeps freed memory, how much depends on the tests before
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        descriptors = len(list(Path("/proc/self/fd").iterdir()))
        return cls(len(_new_threads(earlier)), descriptors, pages * os.sysconf("SC_PAGESIZE"))


def _new_threads(earlier: Collection[threading.Thread]) -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread not in earlier]


def _has_reconnected(run: Run, times: int) -> bool:
    return run.daemon.telemetry.counts.reconnects >= times


def _at_rest(run: Run, earlier: Collection[threading.Thread], threads: int) -> Resources:
    """What is held once dead cameras are closed, without the frames that the test itself has collected until then."""
    run.wait_until(lambda: len(_new_threads(earlier)) <= threads, "dead cameras closed")
    run.seen.clear()
    return Resources.now(earlier)


def test_unplugged_cameras_come_back_and_leave_nothing_behind() -> None:
    earlier = threading.enumerate()  # some of them end during this test
    with stereo_cameras() as cameras, running_daemon(cameras, {"control": {"policy": "fixed"}}) as run:
        run.wait_for_pairs(60)
        before = Resources.now(earlier)
        for cycle in range(WARM_UP_CYCLES + CYCLES):
            (run.left, run.right)[cycle % 2].inject(Fault.VANISH, count=TRIGGERS_OUT)
            run.wait_until(partial(_has_reconnected, run, cycle + 1), f"return {cycle}")
            run.wait_for_pairs(20)
            if cycle == WARM_UP_CYCLES - 1:
                warm = _at_rest(run, earlier, before.threads)
            run.seen.clear()
        after = _at_rest(run, earlier, before.threads)
        assert run.daemon.telemetry.counts.reconnects == WARM_UP_CYCLES + CYCLES
        assert after.threads == before.threads
        assert after.descriptors <= before.descriptors
        assert after.bytes - warm.bytes < GROWTH_BYTES * CYCLES
