"""The camera as a USB device: its endpoints, and the standard requests to its default endpoint."""

from __future__ import annotations

import dataclasses
import errno
import struct
from enum import IntEnum

from fake_camera.device.device import Device
from fake_camera.device.faults import NOT_DESCRIBED, USB3
from fake_camera.genapi.sent_chunks import sent_chunks
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genapi.xml_registers import XmlRegisters
from fake_camera.genicam.description import genicam_xml, zipped
from fake_camera.genicam.registers import RegisterMap, feature_registers
from fake_camera.imaging import ExposedFrame
from fake_camera.usb3.bootstrap import SBRM, USB3_VISION, bootstrap_registers
from fake_camera.usb3.control_channel import ControlChannel
from fake_camera.usb3.event_channel import EventChannel
from fake_camera.usb3.stream_channel import StreamChannel
from fake_camera.usb3.usb import descriptors
from fake_camera.usb3.usb.descriptors import CONTROL_IN, CONTROL_OUT, EVENT_IN, STREAM_IN, Identity
from fake_camera.usb3.usb.endpoint import InEndpoint

_SETUP = struct.Struct("<BBHHH")
_TO_DEVICE, _TO_ENDPOINT = 0, 2
_ENDPOINT_HALT = 0


class Standard(IntEnum):
    """The standard requests of USB."""

    GET_STATUS = 0
    CLEAR_FEATURE = 1
    SET_FEATURE = 3
    GET_DESCRIPTOR = 6
    GET_CONFIGURATION = 8
    SET_CONFIGURATION = 9
    GET_INTERFACE = 10
    SET_INTERFACE = 11
    SET_SEL = 48
    SET_ISOCHRONOUS_DELAY = 49


class StallError(Exception):
    """The device does not support a request to its default endpoint."""


@dataclasses.dataclass(frozen=True, slots=True)
class Setup:
    """A request to the default endpoint."""

    request_type: int
    request: int
    value: int
    index: int
    length: int

    @classmethod
    def from_bytes(cls, setup: bytes) -> Setup:
        """Parse the eight bytes of a setup packet."""
        return cls(*_SETUP.unpack(setup))

    @property
    def recipient(self) -> int:
        """Device, interface or endpoint."""
        return self.request_type & 0x1F


class UsbDevice:
    """A device as the USB host sees it; with `xml` it shows the description and the memory of that camera.

    Attributes
    ----------
    endpoints
        The bulk IN endpoints by address.
    """

    def __init__(self, device: Device, xml: XmlCamera | None = None) -> None:
        self._device = device
        self._xml = xml
        self.endpoints = {address: InEndpoint() for address in (CONTROL_IN, EVENT_IN, STREAM_IN)}
        self._stream = StreamChannel(self.endpoints[STREAM_IN], device.faults, device.counters)
        self._events = EventChannel(self.endpoints[EVENT_IN], device.now_ns)
        self._control = ControlChannel(self._registers(), self.endpoints[CONTROL_IN], device.faults)
        self._halted_out = False
        self._configuration = 0
        device.faults.restrict(USB3 if xml is None else USB3 - NOT_DESCRIBED)
        device.connect(self._send, self._exposure_ended)

    def reset(self) -> None:
        """Back to the power-on state, except for the camera's features."""
        self._stream.reset()
        self._events.reset()
        self._control.reset()
        self._configuration = 0
        self._halted_out = False
        for endpoint in self.endpoints.values():
            endpoint.reset()

    def released(self, interface: int) -> None:
        """No program has an interface any more: drop what waits there."""
        for address, endpoint in self.endpoints.items():
            if descriptors.INTERFACE_OF[address] == interface:
                endpoint.flush()

    def write(self, data: bytes) -> int | None:
        """A bulk transfer to the one OUT endpoint: 0 or a negative errno, None when it is never taken (NAK)."""
        if self._halted_out:
            return -errno.EPIPE
        return 0 if self._control.take(data) else None

    def request(self, setup: Setup) -> bytes:
        """Answer a request to the default endpoint; raises StallError for an unsupported one."""
        match setup.request:
            case Standard.GET_DESCRIPTOR if setup.request_type == 0x80:
                answer = self._descriptor(setup.value >> 8, setup.value & 0xFF)
            case Standard.GET_STATUS if setup.request_type & 0xE0 == 0x80:
                answer = struct.pack("<H", self._status(setup))
            case Standard.GET_CONFIGURATION if setup.request_type == 0x80:
                answer = bytes([self._configuration])
            case Standard.GET_INTERFACE if setup.request_type == 0x81:
                answer = bytes([0])
            case _ if setup.request_type & 0xE0 == 0x00:
                self._command(setup)
                answer = b""
            case _:
                raise StallError
        return answer[: setup.length]

    def _registers(self) -> RegisterMap:
        device, xml = self._device, self._xml
        model = str(device.features.get("DeviceModelName"))
        if xml is None:
            description = zipped(model, genicam_xml(device.features, USB3_VISION))
            bootstrap = bootstrap_registers(
                device, self._stream, self._events, description, lambda: int(device.features.get("PayloadSize"))
            )
            return RegisterMap((*bootstrap, *feature_registers(device, USB3_VISION.byte_order)), alignment=1)
        description = zipped(model, xml.description.data)
        sbrm = xml.address("U3VVersionMajor") or SBRM
        bootstrap = bootstrap_registers(
            device, self._stream, self._events, description, lambda: xml.payload_bytes, sbrm=sbrm
        )
        return XmlRegisters(bootstrap, xml, alignment=1)

    def _send(self, frame: ExposedFrame) -> None:
        frame = _counted_from_0(frame)
        chunks = sent_chunks(frame, self._device, self._xml, USB3_VISION.byte_order)
        self._stream.send(frame, chunks)

    def _exposure_ended(self, frame: ExposedFrame) -> None:
        self._events.exposure_ended(_counted_from_0(frame))

    def _identity(self) -> Identity:
        names = ("DeviceVendorName", "DeviceModelName", "DeviceSerialNumber", "DeviceVersion", "DeviceUserID")
        return Identity(*(str(self._device.features.get(name)) for name in names))

    def _descriptor(self, kind: int, index: int) -> bytes:
        answer: bytes | None = None
        match kind:
            case 0x01:
                answer = descriptors.device_descriptor()
            case 0x02 if index == 0:
                answer = descriptors.configuration_descriptor()
            case 0x03:
                answer = descriptors.string_descriptor(self._identity(), index)
            case 0x0F:
                answer = descriptors.object_store_descriptor()
        if answer is None:
            raise StallError
        return answer

    def _status(self, setup: Setup) -> int:
        if setup.recipient == _TO_ENDPOINT:
            return int(self._halted(setup.index & 0xFF))
        return 1 if setup.recipient == _TO_DEVICE else 0  # self-powered

    def _command(self, setup: Setup) -> None:
        """A standard request without an answer."""
        on_halt = setup.recipient == _TO_ENDPOINT and setup.value == _ENDPOINT_HALT
        match setup.request:
            case Standard.SET_FEATURE if on_halt:
                self._halt(setup.index & 0xFF, True)
            case Standard.CLEAR_FEATURE if on_halt:
                self._halt(setup.index & 0xFF, False)
            case Standard.SET_CONFIGURATION if setup.value in (0, 1):
                self._configuration = setup.value
            case Standard.SET_INTERFACE if setup.value == 0:
                pass  # the only setting
            case Standard.CLEAR_FEATURE | Standard.SET_FEATURE if setup.recipient == _TO_DEVICE:
                pass  # link power management: nothing to do
            case Standard.SET_SEL | Standard.SET_ISOCHRONOUS_DELAY:
                pass  # likewise
            case _:
                raise StallError

    def _halted(self, address: int) -> bool:
        if address == CONTROL_OUT:
            return self._halted_out
        endpoint = self.endpoints.get(address)
        return endpoint is not None and endpoint.halted

    def _halt(self, address: int, on: bool) -> None:
        if address == CONTROL_OUT:
            self._halted_out = on
        elif (endpoint := self.endpoints.get(address)) is None:
            raise StallError
        elif on:
            endpoint.halt()
        else:
            endpoint.clear_halt()


def _counted_from_0(frame: ExposedFrame) -> ExposedFrame:
    """As frames are counted on USB."""
    return dataclasses.replace(frame, frame_id=max(frame.frame_id - 1, 0))
