"""Clients of others on the GigE fake, each as far as it goes.

What they cannot do is listed in tests/fake_camera/gige/foreign_clients.py.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fake_camera.device.faults import Fault
from fake_camera.imaging import PIXEL_FORMATS
from tests.fake_camera.gige.foreign_clients import ForeignClient, ForeignFrame, Telegenic, Viva, viva_module
from tests.fake_camera.gige.gige_client import gige_camera, ramp
from tests.fakes import FakeCamera, fake_camera, first_address, loopback_address, unique

FRAMES = 200
LATE = 10
"""Frames that a fake may drop on a busy machine, where it is too late to render them."""
CLIENTS = pytest.mark.parametrize("kind", [Telegenic, Viva])


@contextlib.contextmanager
def examined(kind: type[ForeignClient], *options: str) -> Iterator[tuple[FakeCamera, Any]]:
    """A fake that stands before an evenly lit wall, and a client in control of it."""
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(first_address()) if kind is Viva else loopback_address()
        light = {"light": [{"at_s": 0, "lux": 50}]}
        scene = ["--scene", "wall", "--still", *options]
        fake = stack.enter_context(fake_camera(address=address, light=light, options=scene))
        client = kind(address)
        stack.callback(client.close)
        for name in ("ExposureAuto", "GainAuto"):
            client.set(name, "Off")
        client.set("ExposureTime", 1000.0)
        yield fake, client


def check(frames: list[ForeignFrame], period_ns: float | None = None) -> None:
    """No frame twice, none out of order, and each at its time."""
    ids = [frame.block_id for frame in frames]
    assert all(later > earlier for earlier, later in pairwise(ids))
    assert ids[-1] - ids[0] <= len(ids) - 1 + LATE
    assert {(frame.width, frame.height, len(frame.payload)) for frame in frames} == {(720, 540, 720 * 540)}
    for first, second in pairwise(frames):
        apart_ns = (second.device_time_ns - first.device_time_ns) / (second.block_id - first.block_id)
        assert apart_ns > 0
        if period_ns is not None:
            assert apart_ns == pytest.approx(period_ns, rel=1e-3)


@CLIENTS
def test_two_hundred_frames_in_free_run(kind: type[ForeignClient]) -> None:
    with examined(kind) as (_, client), client.streaming() as stream:
        frames = [stream.next_frame() for _ in range(FRAMES)]
        assert stream.lost() <= LATE
    check(frames, 1e9 / 30)


@CLIENTS
def test_two_hundred_frames_by_the_line(kind: type[ForeignClient]) -> None:
    with examined(kind) as (fake, client):
        client.set("TriggerMode", "On")
        client.set("TriggerSource", "Line0")
        with client.streaming() as stream:
            frames = [stream.next_frame() for _ in range(FRAMES)]
        pulses = [pulse for pulse in fake.truth() if pulse["trigger"] is not None]
    check(frames)
    period_ns = (pulses[-1]["host_time_ns"] - pulses[0]["host_time_ns"]) / (len(pulses) - 1)
    took_ns = frames[-1].device_time_ns - frames[0].device_time_ns
    assert took_ns / period_ns == pytest.approx(round(took_ns / period_ns), abs=0.05)  # the crystal is a few ppm off


@CLIENTS
def test_two_hundred_frames_by_software(kind: type[ForeignClient]) -> None:
    """One for one: a trigger waits for the frame of the last."""
    with examined(kind) as (fake, client):
        client.set("TriggerMode", "On")
        client.set("TriggerSource", "Software")
        with client.streaming() as stream:
            frames = []
            for _ in range(FRAMES):
                client.execute("TriggerSoftware")
                frames.append(stream.next_frame())
        told = {line["frame_id"]: line["device_time_ns"] for line in fake.truth() if line["trigger"] is None}
    check(frames)
    assert all(told[frame.block_id] == frame.device_time_ns for frame in frames if frame.block_id in told)
    assert len(told) >= FRAMES - 1  # the last line may still be on its way


@CLIENTS
@pytest.mark.parametrize("name", ["Mono8", "Mono16", "Mono12Packed"])
def test_pixels_arrive_bit_by_bit(kind: type[ForeignClient], name: str) -> None:
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(first_address()) if kind is Viva else loopback_address()
        stack.enter_context(gige_camera(address, unique("FC")))
        client = kind(address)
        stack.callback(client.close)
        client.set("PixelFormat", name)
        with client.streaming() as stream:
            frame = stream.next_frame()
    assert frame.pixel_format == PIXEL_FORMATS[name].pfnc_code
    pixels = ramp(720, 540, name)
    assert frame.payload == bytes(PIXEL_FORMATS[name].on_the_wire(pixels))
    if kind is Viva:  # it unpacks by itself
        own = viva_module().frame.Frame.from_bytes(frame.payload, 720, 540, name).to_numpy()
        assert np.array_equal(own, pixels)


@CLIENTS
def test_brightness_follows_the_exposure(kind: type[ForeignClient]) -> None:
    with examined(kind) as (_, client):
        means = []
        for exposure_us in (1000.0, 2000.0):
            client.set("ExposureTime", exposure_us)
            with client.streaming() as stream:
                means.append(np.frombuffer(stream.next_frame().payload, np.uint8).mean())
    assert 10 < means[0] < 100
    assert means[1] / means[0] == pytest.approx(2.0, rel=0.02)


@CLIENTS
def test_chunks_follow_the_pixels(kind: type[ForeignClient]) -> None:
    with examined(kind) as (_, client):
        client.set("ChunkModeActive", True)
        for chunk in ("ExposureTime", "Gain", "FrameID", "Timestamp"):
            client.set("ChunkSelector", chunk)
            client.set("ChunkEnable", True)
        if kind is Telegenic:
            with client.streaming() as stream:
                frame = stream.next_frame()
            assert len(frame.payload) == 720 * 540 + 8 + 4 * 16
            assert frame.payload.endswith(frame.device_time_ns.to_bytes(8, "big") + bytes([0, 0, 0x10, 4, 0, 0, 0, 8]))
            return
        with client.camera.stream(auto_packet_size=True) as frames:
            viva_frame = frames.next_frame(5000)
        assert client.camera.chunk_features(viva_frame) == {
            "ChunkExposureTime": "1000",
            "ChunkGain": "0",
            "ChunkFrameID": str(viva_frame.block_id),
            "ChunkTimestamp": str(viva_frame.ts_dev),
        }


@CLIENTS
def test_lost_packets_are_requested_again(kind: type[ForeignClient]) -> None:
    """Few at a time: telegenic gives a frame up that lacks a tenth of its packets."""
    with examined(kind) as (fake, client), client.streaming() as stream:
        for _ in range(10):
            fake.inject(Fault.LOSE_PACKETS, count=2)
            check([stream.next_frame() for _ in range(3)])
        assert stream.resent() >= 10


@CLIENTS
def test_a_second_controller_is_refused(kind: type[ForeignClient]) -> None:
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(first_address()) if kind is Viva else loopback_address()
        fake = stack.enter_context(gige_camera(address, unique("FC")))
        client = kind(address)
        stack.callback(client.close)
        client.set("ExposureAuto", "Off")
        for second in (Telegenic, kind):
            with pytest.raises(Exception, match=r"held by another application|ACCESS_DENIED"):
                second(address)
        client.set("ExposureTime", 1234.0)
        assert fake.features.get("ExposureTime") == 1234.0


def test_the_end_of_each_exposure_is_told_and_acknowledged() -> None:
    with first_address() as address, gige_camera(address, unique("FC")) as fake:
        client = Viva(address)
        with contextlib.closing(client), client.camera.events(["ExposureEnd"]) as events, client.streaming() as stream:
            frame = stream.next_frame()
            event = events.next_event(5000)
            while event.block_id < frame.block_id:
                event = events.next_event(5000)
            assert event.block_id == frame.block_id
            assert event.ts_dev == frame.device_time_ns + 5_000_000
            told = client.camera.event_features(event)
            assert told == {
                "EventExposureEnd": str(0x9001),
                "EventExposureEndTimestamp": str(event.ts_dev),
                "EventExposureEndFrameID": str(frame.block_id),
            }
        assert fake.features.get("EventNotification") == "On"


def test_actions_reach_the_cameras_that_they_are_for() -> None:
    module = viva_module()
    with examined(Viva, "--ptp", "10319") as (_, client):
        for name, value in (("ActionDeviceKey", 7), ("ActionGroupKey", 3), ("ActionGroupMask", 5)):
            client.set(name, value)
        client.set("TriggerMode", "On")
        client.set("TriggerSource", "Action1")
        with client.streaming() as stream:
            for keys, acks in (((7, 3, 4), 1), ((7, 3, 2), 0), ((7, 4, 4), 0), ((8, 3, 4), 0), ((7, 3, 1), 1)):
                assert module.network.send_action(*keys, destination=client.address).acks == acks
            assert [stream.next_frame().block_id for _ in range(2)] == [1, 2]


def test_a_configuration_is_saved_and_restored(tmp_path: Path) -> None:
    """Of the features that the description marks as streamable."""
    with examined(Viva) as (_, client):
        client.set("ExposureTime", 4321.0)
        client.set("ChunkSelector", "Gain")
        client.set("ChunkEnable", True)
        saved = client.camera.save_features(tmp_path / "camera")
        assert saved["values"] >= 40
        client.set("ExposureTime", 1000.0)
        client.set("ChunkEnable", False)
        restored = client.camera.load_features(tmp_path / "camera")
        assert restored["failures"] == []
        assert float(client.get("ExposureTime")) == 4321.0
        client.set("ChunkSelector", "Gain")
        assert client.get("ChunkEnable") == "true"


def test_the_clock_is_read_by_its_latch() -> None:
    with examined(Viva) as (_, client):
        client.camera.time_calibrate()
        with client.camera.stream(auto_packet_size=True) as stream:
            first, last = (stream.next_frame(5000) for _ in range(2))
        assert last.ts_host - first.ts_host == pytest.approx((last.ts_dev - first.ts_dev) * 1e-9, abs=0.01)
