"""What a described camera does when its registers are written, and what a host finds in its memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from queue import Queue

import numpy as np
import pytest

from fake_camera.device.device import Device
from fake_camera.device.faults import Fault, FaultOrder
from fake_camera.device.features import FeatureError
from fake_camera.genapi.description import Description
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.field import Field
from fake_camera.genapi.memory import Memory
from fake_camera.genapi.raw_gain import RawGainLaw
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genicam.chunks import tagged
from fake_camera.imaging import ExposedFrame
from fake_camera.ptp.slave import DataSet, PortState, Slave
from fake_camera.usb3.usbip.server import Usb3Server
from fake_camera.world.sensor import Sensor, SensorModel
from tests.fake_camera.gige.gige_client import Ramp, ramp
from tests.fake_camera.usb3.usb3_client import SBRM_ADDRESS, SUCCESS, UsbIpClient
from tests.xml_cameras import COMBINATIONS, SCALE, features, xml_camera
from tests.xml_shapes import xml_shape

FLIR, ABS_AND_PLAIN, BASLER_RAW = 16, 17, 7
"""Numbers of combinations: everything there is; two names for one exposure time; a raw gain with a chunk."""
IN_MICROSECONDS, GAIN_IN_A_CATEGORY = 18, 2
"""Further ones, with floats in their registers."""


class Client:
    """Reads and writes features as a client does: by the description, through the memory."""

    def __init__(self, camera: XmlCamera) -> None:
        self._camera = camera

    @property
    def _evaluator(self) -> Evaluator:
        return Evaluator(self._camera.description, Memory(self._camera.read))

    def get(self, name: str) -> float:
        return self._evaluator.value(name)

    def set(self, name: str, value: float) -> None:
        evaluator = self._evaluator
        written: list[tuple[Field, bytes]] = []
        evaluator.write = lambda field, data: written.append((field, data))  # type: ignore[method-assign]
        evaluator.set(name, value)
        for field, data in written:
            self._camera.write(field.address, data)

    def run(self, name: str) -> None:
        evaluator = self._evaluator
        node = evaluator.node(name)
        self.set(evaluator.target(name), node.integer("CommandValue", 1))


@contextmanager
def worn_by(text: bytes, ptp_clock: int | None = None, **law: RawGainLaw) -> Iterator[tuple[Device, Client, XmlCamera]]:
    """A camera that wears this description."""
    with closing(Device(Ramp(), "X1", ptp_clock=ptp_clock)) as device:
        worn = XmlCamera(Description.from_bytes(text, "tiny"), device, **law)
        yield device, Client(worn), worn


def camera(number: int) -> AbstractContextManager[tuple[Device, Client, XmlCamera]]:
    return worn_by(xml_camera(number))


@pytest.mark.parametrize("number", range(1, len(COMBINATIONS)))
def test_exposure_and_gain_written_to_its_registers_reach_the_sensor(number: int) -> None:
    declared = features(COMBINATIONS[number])
    name = "ExposureTime" if "ExposureTime" in declared else "ExposureTimeAbs"
    with camera(number) as (device, client, worn):
        assert worn.not_available == ()
        unit_us = 1e6 if declared[name][1] == "s" else 1.0
        client.set(name, 7000.0 / unit_us)
        assert device.features.get("ExposureTime") == pytest.approx(7000.0)
        gain = next(
            (gain for gain in ("Gain", "GainRaw") if declared.get(gain, ("", ""))[0] in ("Float", "Integer")), None
        )
        if gain is not None:
            in_db = declared[gain][1] == "dB"
            client.set(gain, 12 if in_db else 120)
            assert device.features.get("Gain") == pytest.approx(12.0, abs=0.1)


def test_values_out_of_limits_are_refused_and_change_nothing() -> None:
    with camera(FLIR) as (device, client, _):
        for value in (1.0, 3e6):
            with pytest.raises(FeatureError, match=r"ExposureTime .* is not within 10 to 1e"):
                client.set("ExposureTime", value)
        assert client.get("ExposureTime") == device.features.get("ExposureTime") == 5000.0
        with pytest.raises(FeatureError, match="no entry"):
            client.set("TriggerMode", 7)


def without(part: str, number: int) -> bytes:
    """A description that lacks a part, such as a limit."""
    whole = xml_camera(number)
    assert part.encode() in whole
    return whole.replace(part.encode(), b"")


def test_a_frame_rate_of_0_does_not_end_the_free_run() -> None:
    with worn_by(without("<pMin>AcquisitionFrameRate_RawMin</pMin>", IN_MICROSECONDS)) as (device, client, _):
        frames = Queue[ExposedFrame]()
        device.connect(frames.put)
        client.set("AcquisitionFrameRate", 0.0)
        client.run("AcquisitionStart")
        frames.get(timeout=10)
        client.set("AcquisitionFrameRate", 100.0)
        assert frames.get(timeout=10).frame_id > 1


def test_a_gain_without_limits_has_those_of_the_sensor() -> None:
    text = without("<pMin>Gain_RawMin</pMin><pMax>Gain_RawMax</pMax>", IN_MICROSECONDS)
    with worn_by(text) as (device, client, _):
        client.set("Gain", 1e30)
        settings = device.features.image_settings(1 << 62)
        light = np.ones((540, 720), np.float32)
        assert Sensor(SensorModel(), 0).expose(light, settings, 0).max() == 255


def test_a_raw_gain_that_is_no_factor_changes_nothing() -> None:
    text = without("<pMin>GainRaw_RawMin</pMin><pMax>GainRaw_RawMax</pMax>", GAIN_IN_A_CATEGORY)
    with worn_by(text, raw_gain="amplitude") as (device, client, _):
        client.set("GainRaw", 120.0)
        before = device.features.get("Gain")
        client.set("GainRaw", -100.0)
        assert device.features.get("Gain") == before == pytest.approx(18.5, abs=0.1)


def test_half_a_pair_of_pixels_that_share_chroma_is_refused() -> None:
    grey, yuv = 0x01080001, 0x01100003  # by their old numbers
    with worn_by(xml_camera(FLIR).replace(b"Mono10", b"YUV422_8")) as (device, client, _):
        client.set("PixelFormat", yuv)
        with pytest.raises(FeatureError, match=r"YUV422_8 .* 321 pixels"):
            client.set("Width", 321)
        for name, value in (("Width", 320), ("PixelFormat", grey), ("Width", 321)):
            client.set(name, value)
        with pytest.raises(FeatureError, match=r"YUV422_8 .* 321 pixels"):
            client.set("PixelFormat", yuv)
        assert (device.features.get("Width"), device.features.get("PixelFormat")) == (321, "Mono8")


def test_two_names_of_one_exposure_time_agree() -> None:
    with camera(ABS_AND_PLAIN) as (_, client, _):
        client.set("ExposureTimeAbs", 1234.0)
        assert client.get("ExposureTime") == 1234.0


def test_the_wire_is_its_first_line() -> None:
    with camera(FLIR) as (device, client, worn):
        assert worn.trigger_line == "Line1"
        client.set("TriggerMode", 1)
        assert (device.features.get("TriggerMode"), device.features.get("TriggerSource")) == ("On", "Line0")
        client.set("TriggerSource", 2)
        assert device.features.get("TriggerSource") == "Line2"


def test_a_selector_in_a_register_swaps_what_is_selected() -> None:
    with camera(FLIR) as (device, client, _):
        client.set("TriggerMode", 1)
        client.set("TriggerSelector", 0)
        assert client.get("TriggerMode") == 0
        client.set("TriggerMode", 0)
        assert device.features.get("TriggerMode") == "On"
        client.set("TriggerSelector", 1)
        assert client.get("TriggerMode") == 1


def frame(device: Device) -> ExposedFrame:
    settings = device.features.image_settings(1 << 62)
    return ExposedFrame(7, None, 123_456_789, np.zeros((48, 64), np.uint8), settings)


@pytest.mark.parametrize("number", [FLIR, ABS_AND_PLAIN, BASLER_RAW])
def test_chunks_are_written_so_that_the_description_reads_them_back(number: int) -> None:
    with camera(number) as (device, client, worn):
        assert worn.chunks(frame(device)) is None
        before = client.get("PayloadSize")
        client.set("ChunkModeActive", 1)
        names = [
            name for name in features(COMBINATIONS[number]) if name.startswith("Chunk") and name != "ChunkModeActive"
        ]
        for entry in range(len(names)):
            client.set("ChunkSelector", entry)
            client.set("ChunkEnable", 1)
        client.set("ExposureTime" if number != BASLER_RAW else "ExposureTimeAbs", 4321.0)
        client.set("GainRaw" if number == BASLER_RAW else "Gain", 60 if number == BASLER_RAW else 6)
        found = worn.chunks(frame(device))
        assert found is not None
        assert client.get("PayloadSize") == before + len(tagged(frame(device), found, "big"))
        values = {"ChunkExposureTime": 4321.0, "ChunkGain": 6.0, "ChunkGainAll": 60}
        for index, name in enumerate(names):
            port = Memory()
            port.write(0, dict(found)[0x9A000001 + index])
            reader = Evaluator(worn.description, Memory(), {f"{name}_Port": port})
            assert reader.value(name) == pytest.approx(values.get(name, 7), abs=1 / SCALE)


def test_ordered_refusals_and_restarts_hold_here_too() -> None:
    with camera(FLIR) as (device, client, _):
        device.faults.add(FaultOrder(Fault.REFUSE_WRITES, count=1))
        with pytest.raises(FeatureError, match="as ordered"):
            client.set("ExposureTime", 7000.0)
        client.set("ExposureTime", 7000.0)
        device.execute("DeviceReset")
        assert client.get("ExposureTime") == device.features.get("ExposureTime") == 5000.0


def test_a_gamma_without_a_switch_acts() -> None:
    nodes = (
        '<Float Name="Gamma"><pValue>G</pValue><Min>0.5</Min><Max>2</Max></Float>'
        '<FloatReg Name="G"><Address>0x30000</Address>'
        "<Length>4</Length><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg><Port"
    )
    with worn_by(xml_camera(FLIR).replace(b"<Port", nodes.encode(), 1)) as (device, client, _):
        assert device.features.image_settings(1 << 62).gamma == pytest.approx(0.8)
        client.set("Gamma", 1.0)
        assert device.features.image_settings(1 << 62).gamma == 1.0


def test_a_description_with_a_node_missing_still_makes_a_camera() -> None:
    whole = Description.from_bytes(xml_camera(FLIR), "")
    with closing(Device(Ramp(), "X1")) as device:
        incomplete = 0
        for name in list(whole.nodes)[::3]:
            nodes = {other: node for other, node in whole.nodes.items() if other != name}
            incomplete += bool(XmlCamera(replace(whole, nodes=nodes), device).not_available)
        assert incomplete > 10


@pytest.mark.parametrize("name", ["base", "counts"])
def test_exposure_is_counts_times_their_base(name: str) -> None:
    with worn_by(xml_shape(name)) as (device, client, _):
        client.set("ExposureTimeRaw", 300)
        assert device.features.get("ExposureTime") == 300 * client.get("ExposureTimeBaseAbs") == 3000.0
        client.set("ExposureTimeBaseAbs", 20.0)
        assert (client.get("ExposureTimeRaw"), device.features.get("ExposureTime")) == (300, 6000.0)


@pytest.mark.parametrize("number", [FLIR, ABS_AND_PLAIN])
def test_ptp_and_action_commands_by_its_own_registers(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0x0200_00FF_FE00_0001
    with worn_by(xml_camera(number, ptp=True), clock) as (device, client, worn):
        assert client.get("PtpStatus") == worn.entries("PtpStatus")["Disabled"] == 2
        assert client.get("PtpClockID") == clock
        client.set("PtpEnable", 1)
        assert device.features.get("PtpEnable") is True
        assert client.get("PtpStatus") == 2  # latched
        client.run("PtpDataSetLatch")
        assert client.get("PtpStatus") == worn.entries("PtpStatus")["Initializing"] == 0
        assert client.get("PtpServoStatus") == 0  # it has no entry for Unknown
        monkeypatch.setattr(Slave, "data_set", lambda _: DataSet(PortState.Slave, True, -7, clock, clock))
        client.run("PtpDataSetLatch")
        assert (client.get("PtpStatus"), client.get("PtpServoStatus")) == (8, 6)
        assert client.get("PtpOffsetFromMaster") == -7  # declared without a sign, but of 64 bits
        client.set("ActionDeviceKey", 0xCAFE)
        assert device.features.get("ActionDeviceKey") == 0xCAFE
        client.set("TriggerSource", 7)
        assert device.features.get("TriggerSource") == "Action1"
        assert worn.entries("GevIEEE1588Status") == {}


CHUNKS_LITTLE_ENDIAN = 14
"""The number of a combination with chunks, whose registers are little-endian."""


@contextmanager
def host_of(text: bytes, path: Path) -> Iterator[tuple[UsbIpClient, XmlCamera, Device]]:
    with closing(Device(Ramp(), "X1")) as device:
        worn = XmlCamera(Description.from_bytes(text, ""), device)
        with closing(Usb3Server(device, path, xml=worn)), UsbIpClient(path) as host:
            yield host, worn, device


def write(host: UsbIpClient, worn: XmlCamera, name: str, value: float) -> int:
    """Write a feature by its description, as a client does; the status that the camera answers."""
    evaluator = Evaluator(worn.description, Memory(host.read_memory))
    statuses: list[int] = []
    evaluator.write = lambda field, data: statuses.append(  # type: ignore[method-assign]
        host.write_memory(field.address, data)
    )
    evaluator.set(name, value)
    return statuses[0]


def test_the_host_is_told_of_the_chunks_in_the_payload(tmp_path: Path) -> None:
    with host_of(xml_camera(CHUNKS_LITTLE_ENDIAN, "U3V"), tmp_path / "usb") as (host, worn, device):
        required = host.stream_registers() + 0x08
        image = host.read_number(required, 8)
        pixels = ramp(720, 540)
        assert image == pixels.nbytes
        for name, value in (("ChunkModeActive", 1), ("ChunkSelector", 1), ("ChunkEnable", 1)):
            assert write(host, worn, name, value) == SUCCESS
        frame = ExposedFrame(7, None, 1, pixels, device.features.image_settings(1 << 62))
        found = worn.chunks(frame)
        assert found is not None
        assert host.read_number(required, 8) == image + len(tagged(frame, found, "little")) > image + 16


@pytest.mark.parametrize("at", [0x1000, 0x10000, 0xFFFFF1100000])
def test_the_sbrm_lies_where_its_description_looks_for_it(tmp_path: Path, at: int) -> None:
    nodes = (
        '<Integer Name="U3VVersionMajor"><pValue>V</pValue></Integer><MaskedIntReg Name="V">'
        f"<Address>0x{at:X}</Address><Length>4</Length><pPort>Device</pPort><LSB>16</LSB><MSB>31</MSB>"
        "<Endianess>LittleEndian</Endianess></MaskedIntReg><Port"
    )
    text = xml_camera(CHUNKS_LITTLE_ENDIAN, "U3V").replace(b"<Port", nodes.encode(), 1)
    with host_of(text, tmp_path / "usb") as (host, *_):
        assert host.read_number(SBRM_ADDRESS, 8) == at
        assert host.read_number(at, 4) == 0x00010000


def test_who_it_is_stands_where_its_description_looks_for_it(tmp_path: Path) -> None:
    node = (
        '<StringReg Name="DeviceSerialNumber"><Address>0x10020144</Address><Length>64</Length><pPort>Device</pPort>'
        "</StringReg><Port"
    )
    text = xml_camera(CHUNKS_LITTLE_ENDIAN, "U3V").replace(b"<Port", node.encode(), 1)
    with host_of(text, tmp_path / "usb") as (host, *_):
        assert host.read_memory(0x10020144, 64) == b"X1".ljust(64, b"\0")
