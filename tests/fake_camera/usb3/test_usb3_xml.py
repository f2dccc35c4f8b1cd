"""A described camera on USB: what a host finds in its memory."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from fake_camera.device.device import Device
from fake_camera.genapi.description import Description
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.memory import Memory
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genicam.chunks import tagged
from fake_camera.imaging import ExposedFrame
from fake_camera.usb3.usbip.server import Usb3Server
from tests.fake_camera.gige.gige_client import Ramp, ramp
from tests.fake_camera.usb3.usb3_client import (
    INVALID_PARAMETER,
    MANIFEST_ADDRESS,
    SBRM_ADDRESS,
    SUCCESS,
    UsbIpClient,
)
from tests.xml_cameras import xml_camera

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


def test_it_hands_out_the_description_that_it_wears(tmp_path: Path) -> None:
    text = xml_camera(CHUNKS_LITTLE_ENDIAN, "U3V")
    with host_of(text, tmp_path / "usb") as (host, *_):
        manifest = host.read_number(MANIFEST_ADDRESS, 8)
        address, length = struct.unpack("<QQ", host.read_memory(manifest + 16, 16))
        with zipfile.ZipFile(io.BytesIO(host.read_memory(address, length))) as archive:
            assert [archive.read(name) for name in archive.namelist()] == [text]


def test_its_registers_answer_as_those_of_the_standard_do(tmp_path: Path) -> None:
    with host_of(xml_camera(CHUNKS_LITTLE_ENDIAN, "U3V"), tmp_path / "usb") as (host, worn, _):
        assert host.read_memory(0x0004, 6) == b"Nobody"
        assert write(host, worn, "ExposureTime", 7000.0) == SUCCESS
        assert write(host, worn, "ExposureTime", 3e6) == INVALID_PARAMETER
        at = worn.address("ExposureTime")
        assert at is not None
        assert struct.unpack("<f", host.read_memory(at, 4)) == (7000.0,)


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
