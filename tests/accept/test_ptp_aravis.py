"""Cameras that stock Aravis opens follow a PTP master over real sockets, and expose together at action commands."""

from __future__ import annotations

import gc
import json
import random
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from fake_camera.device.line0 import Line0
from fake_camera.device.truth import TruthFile
from fake_camera.ptp.host_master import HostMaster
from fake_camera.ptp.messages import clock_identity
from tests.fake_camera.gige.gige_client import ACTION, GVCP_PORT, command, gige_camera, parse_ack
from tests.fake_camera.stock_aravis import Aravis, stream_of
from tests.fakes import loopback_address, unique
from tests.meanwhile import wait_until

pytestmark = pytest.mark.realtime

ADDRESSES = loopback_address(), loopback_address()
CLOCKS = clock_identity(0x0200_0000_0001), clock_identity(0x0200_0000_0002)
EVENT_PORT = random.SystemRandom().randrange(20_000, 30_000, 2)
ACTION_LATE = 0x8016
ROUNDING_NS = 2
BROADCAST = "127.255.255.255"
DEVICE_KEY, GROUP_KEY, GROUP_MASK = random.SystemRandom().getrandbits(32), 1, 1
ACKNOWLEDGED, SCHEDULED = 0x01, 0x80
S = 1_000_000_000
BOUND_NS = S // 60 // 2 // 10
"""A tenth of half a period at 60 Hz; some 20 us are usual, but other programs may use the machine."""


@pytest.fixture
def cameras(tmp_path: Path) -> Iterator[list[Any]]:
    with ExitStack() as stack:
        for address, clock in zip(ADDRESSES, CLOCKS, strict=True):
            truth = TruthFile(tmp_path / address, lambda _: 1.0, Line0(time.monotonic_ns(), 60.0))
            stack.callback(truth.close)
            stack.enter_context(
                gige_camera(address, unique("PTP"), ptp_clock=clock, ptp_event_port=EVENT_PORT, truth=truth)
            )
        opened = [Aravis.Camera.new(address) for address in ADDRESSES]
        yield opened
        opened.clear()
        gc.collect()  # Aravis gives control back when it frees a camera: before that camera is gone


def status(camera: Any) -> str:
    camera.execute_command("PtpDataSetLatch")
    return str(camera.get_string("PtpStatus"))


def latched_ns(camera: Any) -> int:
    camera.execute_command("TimestampLatch")
    return int(camera.get_integer("TimestampLatchValue"))


def expose_together(cameras: list[Any], streams: list[Any], together_ns: list[list[int]]) -> list[list[int]]:
    """Schedule an exposure of both cameras; if both frames arrive, add their stamps.

    On a busy machine an action may come too late, and frames get lost.
    """
    at_ns = latched_ns(cameras[0]) + S // 5
    statuses = expose_at(at_ns)
    assert set(statuses) <= {0, ACTION_LATE}
    stamps_ns = [stamp_ns for stream in streams if (stamp_ns := stamp_from(stream, at_ns - ROUNDING_NS)) is not None]
    if statuses == [0, 0] and len(stamps_ns) == len(streams):
        assert all(abs(stamp_ns - at_ns) <= ROUNDING_NS for stamp_ns in stamps_ns)
        together_ns.append(stamps_ns)
    return together_ns


def stamp_from(stream: Any, at_ns: int) -> int | None:
    """The stamp of the first whole frame from `at_ns` on; None if none comes."""
    while (buffer := stream.timeout_pop_buffer(1_000_000)) is not None:
        whole, stamp_ns = buffer.get_status() == Aravis.BufferStatus.SUCCESS, int(buffer.get_timestamp())
        stream.push_buffer(buffer)
        if whole and stamp_ns >= at_ns:
            return stamp_ns
    return None


def true_starts_ns(truth: Path) -> dict[int, int]:
    """When a camera's exposures began by the clock that all processes share, by when they did by its own."""
    lines = [json.loads(line) for line in truth.read_text().splitlines()]
    return {line["device_time_ns"]: line["host_time_ns"] for line in lines if line["trigger"] is None}


def expose_at(time_ns: int) -> list[int]:
    """Broadcast a scheduled action from a plain socket; the status that each of two cameras answers."""
    payload = struct.pack(">IIIQ", DEVICE_KEY, GROUP_KEY, GROUP_MASK, time_ns)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        udp.settimeout(5)
        udp.sendto(command(ACTION, payload, 1, ACKNOWLEDGED | SCHEDULED), (BROADCAST, GVCP_PORT))
        statuses: list[int] = []
        while len(statuses) < len(ADDRESSES):
            answer, (address, _port) = udp.recvfrom(100)
            if address in ADDRESSES:  # other cameras may hear it, too
                statuses.append(parse_ack(answer)[0])
        return statuses


def set_up_for_actions(camera: Any) -> Any:
    camera.set_string("TriggerMode", "On")
    camera.set_string("TriggerSource", "Action1")
    camera.set_integer("ActionDeviceKey", DEVICE_KEY)
    camera.set_integer("ActionGroupKey", GROUP_KEY)
    camera.set_integer("ActionGroupMask", GROUP_MASK)
    stream = stream_of(camera)
    stream.set_property("frame-retention", 2_000_000)  # us: two frames at once take longer on a busy machine
    camera.start_acquisition()
    return stream


def all_are(cameras: list[Any], wanted: str) -> Callable[[], bool]:
    return lambda: all(status(camera) == wanted for camera in cameras)


def test_two_cameras_follow_a_master_expose_together_and_notice_its_end(cameras: list[Any], tmp_path: Path) -> None:
    streams = [set_up_for_actions(camera) for camera in cameras]
    assert all_are(cameras, "Disabled")()
    with HostMaster(EVENT_PORT) as master:
        for camera in cameras:
            camera.set_boolean("PtpEnable", True)
        wait_until(all_are(cameras, "Slave"))
        for camera, clock in zip(cameras, CLOCKS, strict=True):
            assert camera.get_string("PtpServoStatus") == "Locked"
            assert abs(camera.get_integer("PtpOffsetFromMaster")) < BOUND_NS
            assert camera.get_integer("PtpClockID") == clock
            assert camera.get_integer("PtpParentClockID") == camera.get_integer("PtpGrandmasterClockID")
            assert camera.get_integer("PtpGrandmasterClockID") not in CLOCKS
            before_ns = master.time_ns(time.monotonic_ns())
            shown_ns = latched_ns(camera)
            assert before_ns - BOUND_NS < shown_ns < master.time_ns(time.monotonic_ns()) + BOUND_NS
        together_ns: list[list[int]] = []
        wait_until(lambda: len(expose_together(cameras, streams, together_ns)) == 3)
    starts_ns = [true_starts_ns(tmp_path / address) for address in ADDRESSES]
    for stamps_ns in together_ns:
        left_ns, right_ns = (starts[stamp_ns] for starts, stamp_ns in zip(starts_ns, stamps_ns, strict=True))
        assert abs(left_ns - right_ns) < BOUND_NS
    wait_until(all_are(cameras, "Listening"))
    for camera in cameras:
        camera.stop_acquisition()
