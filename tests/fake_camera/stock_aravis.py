"""What stock Aravis makes of a fake camera on any transport: GigE Vision directly, USB3 Vision under the shim."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from tests.fake_camera.gige.gige_client import ramp

with warnings.catch_warnings():
    warnings.simplefilter("ignore", ImportWarning)  # PyGObject's importer is of an older kind
    import gi

    gi.require_version("Aravis", "0.8")
    from gi.repository import Aravis, GLib

__all__ = ["Aravis", "GLib", "StockAravisContract", "next_buffer", "opened", "serial_of", "stream_of"]

PATIENCE_S = 10.0
ACCESS_POLICIES = [
    getattr(Aravis.AccessCheckPolicy, name) for name in ("ENABLE", "DISABLE") if hasattr(Aravis, "AccessCheckPolicy")
]


def serial_of(fake: Device) -> str:
    return str(fake.features.get("DeviceSerialNumber"))


def opened(device_id: str) -> Any:
    """A camera that exposes for 1 ms, at no gain."""
    camera = Aravis.Camera.new(device_id)
    camera.set_string("ExposureAuto", "Off")
    camera.set_string("GainAuto", "Off")
    camera.set_float("ExposureTime", 1000.0)
    return camera


def stream_of(camera: Any, buffers: int = 10) -> Any:
    gige = camera.is_gv_device()
    if gige:
        camera.get_device().set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
    stream = camera.create_stream(None, None)
    if gige:
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", 4 << 20)
        stream.set_property("packet-timeout", 2000)
    for _ in range(buffers):
        stream.push_buffer(Aravis.Buffer.new_allocate(camera.get_payload()))
    return stream


def next_buffer(stream: Any, status: Any = Aravis.BufferStatus.SUCCESS) -> Any:
    """The next buffer with this status: over UDP, on a busy machine, some frames lose packets for good."""
    for _ in range(100):
        buffer = stream.timeout_pop_buffer(round(PATIENCE_S * 1e6))
        assert buffer is not None
        if buffer.get_status() == status:
            return buffer
        stream.push_buffer(buffer)
    raise AssertionError(f"no buffer {status} came")


class StockAravisContract:
    """For the tests of each transport to inherit; they provide the fixture `fake`.

    Tests open the camera themselves: a fixture would keep it until its fake is gone.
    """

    model: str

    def open(self, fake: Device) -> Any:
        raise NotImplementedError

    def test_identity(self, fake: Device) -> None:
        camera = self.open(fake)
        assert (camera.get_vendor_name(), camera.get_model_name()) == ("Autoexpose", self.model)
        assert camera.get_device_serial_number() == serial_of(fake)

    def test_nodes_are_written_and_read_back(self, fake: Device) -> None:
        camera = self.open(fake)
        camera.set_float("ExposureTime", 1234.0)
        camera.set_float("Gain", 12.5)
        camera.set_string("PixelFormat", "Mono12")
        camera.set_integer("BinningHorizontal", 2)
        camera.set_string("DeviceUserID", "bow")
        assert camera.get_float("ExposureTime") == 1234.0
        assert (fake.features.get("Gain"), fake.features.get("PixelFormat")) == (12.5, "Mono12")
        assert fake.features.get("DeviceUserID") == camera.get_string("DeviceUserID") == "bow"
        assert camera.get_integer("WidthMax") == camera.get_integer("Width") == 360
        assert camera.get_payload() == 360 * 540 * 2
        bounds = camera.get_exposure_time_bounds()
        assert (bounds.min, bounds.max) == (10.0, 1e6)
        assert camera.get_device().get_feature("Gain").get_unit() == "dB"
        before_ns = fake.now_ns()
        camera.execute_command("TimestampLatch")
        assert before_ns <= camera.get_integer("TimestampLatchValue") <= fake.now_ns()

    @pytest.mark.parametrize("policy", [Aravis.RangeCheckPolicy.ENABLE, Aravis.RangeCheckPolicy.DISABLE])
    def test_out_of_range_is_refused_by_aravis_and_by_the_camera(self, fake: Device, policy: Any) -> None:
        camera = self.open(fake)
        camera.get_device().set_range_check_policy(policy)
        for value in (9.0, 1.1e6):
            with pytest.raises(GLib.Error):
                camera.set_float("ExposureTime", value)
        assert fake.features.get("ExposureTime") == 1000.0

    @pytest.mark.parametrize("policy", ACCESS_POLICIES)
    def test_locked_is_refused_by_aravis_and_by_the_camera(self, fake: Device, policy: Any) -> None:
        camera = self.open(fake)
        camera.get_device().set_access_check_policy(policy)
        camera.set_string("ExposureAuto", "Continuous")
        with pytest.raises(GLib.Error):
            camera.set_float("ExposureTime", 2000.0)
        assert fake.features.get("ExposureTime") == 1000.0

    def test_a_refused_write_is_an_error_and_happens_once(self, fake: Device) -> None:
        camera = self.open(fake)
        fake.faults.add(FaultOrder(Fault.REFUSE_WRITES))
        with pytest.raises(GLib.Error, match="access-denied"):
            camera.set_float("ExposureTime", 2000.0)
        camera.set_float("ExposureTime", 3000.0)
        assert fake.features.get("ExposureTime") == 3000.0

    @pytest.mark.realtime
    def test_frames_run_free_and_tell_how_they_were_taken(self, fake: Device) -> None:
        camera = self.open(fake)
        camera.set_float("ExposureTime", 2345.0)
        camera.set_float("Gain", 6.0)
        camera.set_chunk_mode(True)
        camera.set_chunks("ExposureTime,Gain,FrameID,Timestamp")
        parser = camera.create_chunk_parser()
        stream = stream_of(camera)
        camera.start_acquisition()
        for newest in range(10):
            buffer = next_buffer(stream)
            assert buffer.get_frame_id() == parser.get_integer_value(buffer, "ChunkFrameID") >= newest
            assert buffer.get_timestamp() == parser.get_integer_value(buffer, "ChunkTimestamp")
            assert parser.get_float_value(buffer, "ChunkExposureTime") == 2345.0
            assert parser.get_float_value(buffer, "ChunkGain") == 6.0
            pixels = np.frombuffer(buffer.get_data(), np.uint8, count=720 * 540).reshape(540, 720)
            assert np.array_equal(pixels, ramp(720, 540))
            stream.push_buffer(buffer)
        camera.stop_acquisition()

    @pytest.mark.realtime
    def test_a_region_of_deep_pixels_is_locked_while_it_streams(self, fake: Device) -> None:
        camera = self.open(fake)
        camera.set_string("PixelFormat", "Mono12")
        camera.set_region(8, 4, 304, 200)
        stream = stream_of(camera)
        camera.start_acquisition()
        buffer = next_buffer(stream)
        with pytest.raises(GLib.Error):
            camera.set_integer("Width", 320)
        camera.stop_acquisition()
        region = buffer.get_image_region()
        assert (region.x, region.y, region.width, region.height) == (8, 4, 304, 200)
        pixels = np.frombuffer(buffer.get_data(), "<u2").reshape(200, 304)
        assert np.array_equal(pixels, ramp(304, 200, "Mono12"))
        camera.set_integer("Width", 320)
