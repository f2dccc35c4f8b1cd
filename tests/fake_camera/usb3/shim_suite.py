"""Stock Aravis accepts the fake as a USB3 Vision camera. Run by test_usb3_aravis.py, in a process under the shim."""

from __future__ import annotations

import contextlib
import fcntl
import gc
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.device.line0 import Line0
from fake_camera.usb3.run import CAMERAS_VARIABLE
from fake_camera.usb3.usb.endpoint import InEndpoint, ReadRequest
from tests.fake_camera.gige.gige_client import ramp
from tests.fake_camera.stock_aravis import Aravis, GLib, StockAravisContract, next_buffer, serial_of, stream_of
from tests.fake_camera.stock_aravis import opened as opened_by_id
from tests.fake_camera.usb3 import usb3_client
from tests.fake_camera.usb3.libusb_client import TIMED_OUT, TIMEOUT_MS, LibusbCamera
from tests.fakes import unique
from tests.meanwhile import wait_until

Aravis.disable_interface("GigEVision")  # its discovery waits a second for answers

SOCKET, OTHER_SOCKET = (Path(path) for path in os.environ[CAMERAS_VARIABLE].split(":"))
PATIENCE_S = 10.0
RATE_HZ = 100.0
USBDEVFS_RESET = 0x5514


@contextlib.contextmanager
def usb3_camera(socket: Path, serial: str) -> Iterator[Device]:
    with usb3_client.usb3_camera(socket, serial, line0=Line0(time.monotonic_ns(), RATE_HZ)) as device:
        yield device
        gc.collect()  # Aravis frees what it holds before the camera goes


@pytest.fixture
def fake() -> Iterator[Device]:
    with usb3_camera(SOCKET, unique("USB")) as device:
        yield device


@pytest.fixture
def other() -> Iterator[Device]:
    with usb3_camera(OTHER_SOCKET, unique("USB")) as device:
        yield device


def found() -> dict[str, str]:
    """The ids of the USB3 Vision cameras by serial number."""
    Aravis.update_device_list()
    return {
        Aravis.get_device_serial_nbr(index): Aravis.get_device_id(index)
        for index in range(Aravis.get_n_devices())
        if Aravis.get_device_protocol(index) == "USB3Vision"
    }


def id_of(fake: Device) -> str:
    """Its id, as soon as it is found, since a camera that was reset takes a moment to come back."""
    ids: dict[str, str] = {}
    wait_until(lambda: serial_of(fake) in ids or bool(ids.update(found())))
    return ids[serial_of(fake)]


def opened(fake: Device) -> Any:
    return opened_by_id(id_of(fake))


def streaming(fake: Device) -> tuple[Any, Any]:
    """The camera and its stream, from which a frame has come."""
    camera = opened(fake)
    stream = stream_of(camera)
    camera.start_acquisition()
    next_buffer(stream)
    return camera, stream


class TestUsb3Vision(StockAravisContract):
    model = "FakeU3V287M"

    def open(self, fake: Device) -> Any:
        return opened(fake)


def test_its_bootstrap_registers_say_what_it_is(fake: Device) -> None:
    camera = opened(fake)
    assert camera.is_uv_device()
    names = ("U3VVersionMajor", "U3VVersionMinor", "U3VCurrentSpeed")
    assert [camera.get_integer(name) for name in names] == [1, 0, 8]


def test_both_cameras_are_found_and_an_absent_one_is_not(fake: Device) -> None:
    assert list(found()) == [serial_of(fake)]
    with usb3_camera(OTHER_SOCKET, unique("USB")) as other:
        assert sorted(found()) == sorted([serial_of(fake), serial_of(other)])
    wait_until(lambda: list(found()) == [serial_of(fake)])


@pytest.mark.parametrize("ahead", [1, 16])
def test_transfers_of_many_frames_at_once_come_in_order_and_whole(fake: Device, ahead: int) -> None:
    """As with asynchronous clients; late frames are counted by the camera, and nothing is lost on the way."""
    fake.features.set("AcquisitionFrameRate", 100.0)
    camera = LibusbCamera()
    with camera.streaming(ahead, 64 << 10) as arriving:
        fake.execute("AcquisitionStart")
        frames = [next(arriving) for _ in range(60)]
    camera.close()
    image = ramp(720, 540).tobytes()
    assert all(payload == image for _, payload in frames)
    ids = np.array([frame_id for frame_id, _ in frames])
    assert np.diff(ids).min() == 1
    assert ids[-1] - (len(ids) - 1) <= fake.counters.overruns + fake.counters.discarded


def test_a_stream_is_stopped_and_started_again(fake: Device) -> None:
    camera = opened(fake)
    for _ in range(5):
        stream = stream_of(camera)
        camera.start_acquisition()
        assert next_buffer(stream).get_frame_id() == 0
        next_buffer(stream)
        camera.stop_acquisition()
        del stream


def test_a_claimed_camera_is_busy(fake: Device) -> None:
    camera = opened(fake)
    with pytest.raises(GLib.Error, match="LIBUSB_ERROR_BUSY"):
        opened(fake)
    assert list(found()) == [serial_of(fake)]
    del camera
    gc.collect()
    opened(fake)


@pytest.mark.parametrize("cycle", range(2))
def test_unplugged_while_streaming_and_replugged(fake: Device, other: Device, cycle: int) -> None:
    camera, bystander = opened(fake), opened(other)
    lost = threading.Event()
    camera.get_device().connect("control-lost", lambda _device: lost.set())
    stream, other_stream = stream_of(camera), stream_of(bystander)
    camera.start_acquisition()
    bystander.start_acquisition()
    next_buffer(stream)
    fake.faults.add(FaultOrder(Fault.VANISH, None, None))
    assert lost.wait(PATIENCE_S)
    assert list(found()) == [serial_of(other)]
    with pytest.raises(GLib.Error):
        camera.get_float("ExposureTime")
    del stream, camera
    gc.collect()
    fake.faults.add(FaultOrder(Fault.COME_BACK, None, None))
    assert fake.features.get("ExposureAuto") == "Continuous"  # as after power-on
    again = opened(fake)
    stream = stream_of(again)
    again.start_acquisition()
    next_buffer(stream)
    next_buffer(other_stream)
    for streaming in (again, bystander):
        streaming.stop_acquisition()


def test_cycles_of_streaming_and_unplugging_leave_nothing_behind(fake: Device) -> None:
    counts: list[tuple[int, int]] = []
    for _ in range(6):
        camera, stream = streaming(fake)
        fake.faults.add(FaultOrder(Fault.VANISH, None, None))
        del stream, camera
        gc.collect()
        fake.faults.add(FaultOrder(Fault.COME_BACK, None, None))
        assert id_of(fake) in found().values()
        if counts:
            wait_until(
                lambda: all(now <= first for now, first in zip(open_files_and_threads(), counts[0], strict=True))
            )
        counts.append(open_files_and_threads())


def open_files_and_threads() -> tuple[int, int]:
    return len(list(Path("/proc/self/fd").iterdir())), len(list(Path("/proc/self/task").iterdir()))


def test_a_reset_camera_comes_back_by_itself(fake: Device) -> None:
    camera = opened(fake)
    with contextlib.suppress(GLib.Error):  # it may go before it acknowledges
        camera.execute_command("DeviceReset")
    del camera
    gc.collect()
    assert opened(fake).get_float("ExposureTime") == 1000.0


@pytest.mark.parametrize("fault", [Fault.NAK, Fault.PENDING_ACKNOWLEDGE])
def test_a_slow_answer_is_waited_for(fake: Device, fault: Fault) -> None:
    camera = opened(fake)
    fake.faults.add(FaultOrder(fault))
    camera.set_float("ExposureTime", 2000.0)
    assert camera.get_float("ExposureTime") == 2000.0


def test_a_truncated_frame_is_told(fake: Device) -> None:
    camera, stream = streaming(fake)
    fake.faults.add(FaultOrder(Fault.SHORT_TRAILER))  # which Aravis does not mind
    fake.faults.add(FaultOrder(Fault.TRUNCATE))
    next_buffer(stream, Aravis.BufferStatus.SIZE_MISMATCH)
    next_buffer(stream)
    camera.stop_acquisition()
    assert stream.get_info_uint64_by_name("n_failures") == 1


def test_a_stalled_stream_goes_on_when_the_camera_is_opened_again(fake: Device) -> None:
    camera, stream = streaming(fake)
    fake.faults.add(FaultOrder(Fault.STALL))
    while stream.timeout_pop_buffer(300_000) is not None:
        pass
    camera.stop_acquisition()
    del stream, camera
    gc.collect()
    # Aravis 0.8.26 clears the halt when it opens a camera, not when it starts a stream.
    camera, _stream = streaming(fake)
    camera.stop_acquisition()


def test_a_usbfs_call_that_the_shim_lacks_is_named(fake: Device, capfd: pytest.CaptureFixture[str]) -> None:
    found()
    address = int(Path("/sys/bus/usb/devices/100-1/devnum").read_text())
    node = os.open(f"/dev/bus/usb/100/{address:03d}", os.O_RDWR)
    with pytest.raises(OSError, match="Inappropriate ioctl"):
        fcntl.ioctl(node, USBDEVFS_RESET)
    os.close(node)
    assert "libusb needs the usbfs call 0x5514, which is missing" in capfd.readouterr().err


def test_what_a_camera_sends_while_a_read_is_given_up_comes_with_the_next_read(
    fake: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else frames of a rate near the host's timeout are lost, as none is behind a host controller."""
    cancel, sent_late = InEndpoint.cancel, [b"first", bytes(40), b"third"]

    def send_before(endpoint: InEndpoint, request: ReadRequest) -> bool:
        if sent_late:
            endpoint.write(sent_late.pop(0))
        return cancel(endpoint, request)

    monkeypatch.setattr(InEndpoint, "cancel", send_before)
    with contextlib.closing(LibusbCamera()) as camera:
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
        assert camera.read_stream(64, TIMEOUT_MS) == (0, b"first")
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
        assert camera.read_stream(16, TIMEOUT_MS) == (0, bytes(16))  # a transfer goes on in the next read
        assert camera.read_stream(64, TIMEOUT_MS) == (0, bytes(24))
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
        assert camera.read_stream(64, TIMEOUT_MS) == (0, b"third")
        assert camera.read_stream(64, 20) == (TIMED_OUT, b"")
