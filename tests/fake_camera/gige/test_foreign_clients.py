"""Clients of others stream the GigE fake, briefly; tests/accept/test_foreign_clients.py does at length."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from itertools import pairwise

import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.imaging import PIXEL_FORMATS
from tests.fake_camera.gige.foreign_clients import ForeignClient, Telegenic, Viva
from tests.fake_camera.gige.gige_client import gige_camera, ramp
from tests.fakes import first_address, loopback_address, unique

pytestmark = [pytest.mark.realtime]


@pytest.fixture(params=[Telegenic, Viva])
def examined(request: pytest.FixtureRequest) -> Iterator[tuple[Device, ForeignClient]]:
    """A fake that shows a ramp, and a client in control of it."""
    with contextlib.ExitStack() as stack:
        address = stack.enter_context(first_address()) if request.param is Viva else loopback_address()
        fake = stack.enter_context(gige_camera(address, unique("FC")))
        client = request.param(address)
        stack.callback(client.close)
        for name in ("ExposureAuto", "GainAuto"):
            client.set(name, "Off")
        yield fake, client


def test_frames_arrive_bit_by_bit(examined: tuple[Device, ForeignClient]) -> None:
    fake, client = examined
    assert client.get("ExposureAuto") == "Off"
    with client.streaming() as stream:
        frames = [stream.next_frame() for _ in range(15)]
        lost = stream.lost()
    code = PIXEL_FORMATS["Mono8"].pfnc_code
    assert {(frame.width, frame.height, frame.pixel_format) for frame in frames} == {(720, 540, code)}
    assert {frame.payload for frame in frames} == {ramp(720, 540).tobytes()}
    assert all(later.block_id > earlier.block_id for earlier, later in pairwise(frames))
    assert lost <= fake.counters.overruns


def test_lost_packets_are_requested_again(examined: tuple[Device, ForeignClient]) -> None:
    fake, client = examined
    with client.streaming() as stream:
        stream.next_frame()
        fake.faults.add(FaultOrder(Fault.LOSE_PACKETS, None, 3))
        payloads = {stream.next_frame().payload for _ in range(5)}
        assert stream.resent() >= 1
    assert payloads == {ramp(720, 540).tobytes()}


def test_a_second_controller_is_refused(examined: tuple[Device, ForeignClient]) -> None:
    fake, client = examined
    for second in (Telegenic, type(client)):
        with pytest.raises(Exception, match=r"held by another application|ACCESS_DENIED"):
            second(client.address)
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
