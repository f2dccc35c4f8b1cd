"""A device as a GigE Vision camera on the network: its sockets, and the thread that answers commands."""

from __future__ import annotations

import contextlib
import errno
import selectors
import socket
import threading
import time

from fake_camera.device.device import Device
from fake_camera.device.faults import GIGE, NOT_DESCRIBED
from fake_camera.genapi.sent_chunks import sent_chunks
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genapi.xml_registers import XmlRegisters, free_address
from fake_camera.genicam.description import genicam_xml, zipped
from fake_camera.genicam.events import EXPOSURE_END
from fake_camera.genicam.privilege import ControlPrivilege
from fake_camera.genicam.registers import RegisterMap, feature_registers
from fake_camera.gige import gvcp
from fake_camera.gige.actions import ActionChannel
from fake_camera.gige.bootstrap import GIGE_VISION, bootstrap_registers
from fake_camera.gige.control_channel import ControlChannel
from fake_camera.gige.gvsp import block_id
from fake_camera.gige.message_channel import MessageChannel
from fake_camera.gige.stream_channel import StreamChannel
from fake_camera.gige.switch import Switch
from fake_camera.imaging import ExposedFrame
from fake_camera.ptp.port import EVENT_PORT, PtpPort

_BROADCAST_ADDRESSES = ("255.255.255.255", "127.255.255.255")
_EXPIRY_CHECK_S = 0.1


class AddressTakenError(Exception):
    """Another camera already answers at this address."""


class GigeServer:
    """Serves one device at one IPv4 address of this machine (127.0.0.1, 127.0.0.2 ...), always on UDP port 3956."""

    def __init__(
        self,
        device: Device,
        address: str,
        xml: XmlCamera | None = None,
        switch: Switch | None = None,
        *,
        ptp_event_port: int = EVENT_PORT,
        second_address: str | None = None,
    ) -> None:
        """Bind the sockets; with `xml` the device shows the description and the memory of that camera.

        Its stream goes through `switch`, if given, and leaves from `second_address`, if given, that of a second network
        interface. A device with a PTP clock uses `ptp_event_port` and the next one. Raises AddressTakenError when
        another camera listens at `address`; OSError when this machine has no such address, or a port of PTP cannot be
        used.
        """
        self._device = device
        # Without SO_REUSEADDR, since two cameras at one address would each get some of the commands.
        self._socket = _bind(address, reuse=False)
        self._broadcast_sockets = [_bind(broadcast, reuse=True) for broadcast in _BROADCAST_ADDRESSES]
        self._second_address = second_address
        self._stream = StreamChannel(second_address or address, device.faults, switch)
        self._messages = MessageChannel(address)
        privilege = ControlPrivilege()
        self._xml = xml
        self._ptp: PtpPort | None = None
        self._actions: ActionChannel | None = None
        if device.ptp is not None:
            self._ptp = PtpPort(device.ptp, address, ptp_event_port, lambda: not device.faults.vanished)
            clock_states = {} if xml is None else xml.entries("GevIEEE1588Status")
            self._actions = ActionChannel(device, privilege, clock_states)
        registers = self._registers(address, privilege)
        act = None if self._actions is None else self._actions.act
        self._control = ControlChannel(registers, privilege, self._stream.resend, self._released, act)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=f"gvcp {address}", daemon=True)
        device.faults.restrict(GIGE if xml is None else GIGE - NOT_DESCRIBED)
        device.connect(self._send, self._exposure_ended)
        device.on_power_on(self._power_on)

    def start(self) -> None:
        """Start answering."""
        self._thread.start()
        if self._ptp is not None:
            self._ptp.start()

    def close(self) -> None:
        """Stop answering and free the address."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()
        for udp in (self._socket, *self._broadcast_sockets):
            udp.close()
        self._stream.close()
        self._messages.close()
        if self._ptp is not None:
            self._ptp.close()

    def _registers(self, address: str, privilege: ControlPrivilege) -> RegisterMap:
        device, xml = self._device, self._xml
        model = str(device.features.get("DeviceModelName"))
        if xml is None:
            description = zipped(model, genicam_xml(device.features, GIGE_VISION))
            bootstrap = bootstrap_registers(
                device,
                address,
                privilege,
                self._stream,
                self._messages,
                description=description,
                actions=self._actions,
                second_address=self._second_address,
            )
            return RegisterMap((*bootstrap, *feature_registers(device, GIGE_VISION.byte_order)))
        description = zipped(model, xml.description.data)
        at = free_address(xml, len(description))
        bootstrap = bootstrap_registers(
            device,
            address,
            privilege,
            self._stream,
            self._messages,
            description=description,
            description_address=at,
            actions=self._actions,
            second_address=self._second_address,
        )
        return XmlRegisters(bootstrap, xml)

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for udp in (self._socket, *self._broadcast_sockets):
                selector.register(udp, selectors.EVENT_READ, udp)
            while not self._closing.is_set():
                for key, _events in selector.select(_EXPIRY_CHECK_S):
                    self._answer(key.data)
                self._control.expire(time.monotonic())

    def _answer(self, udp: socket.socket) -> None:
        datagram, peer = udp.recvfrom(0x10000)
        if self._device.faults.vanished:
            return
        if udp is not self._socket and not self._is_broadcast(datagram):
            return
        answer = self._control.answer(datagram, peer, time.monotonic())
        if answer is not None:
            with contextlib.suppress(OSError):  # a broadcast from a network that this address cannot reach
                self._socket.sendto(answer, peer)

    def _is_broadcast(self, datagram: bytes) -> bool:
        """Whether it is a command that may be sent to all cameras at once."""
        request = gvcp.Request.from_bytes(datagram)
        if request is None:
            return False
        is_action = request.command == gvcp.Command.ACTION and self._actions is not None
        return is_action or request.command == gvcp.Command.DISCOVERY

    def _send(self, frame: ExposedFrame) -> None:
        chunks = sent_chunks(frame, self._device, self._xml, GIGE_VISION.byte_order)
        self._stream.send(frame, chunks)

    def _exposure_ended(self, frame: ExposedFrame) -> None:
        block, time_ns = block_id(frame.frame_id), frame.exposure_end_ns
        self._messages.send(gvcp.event(EXPOSURE_END, block, time_ns, frame.frame_id.to_bytes(8, "big")))

    def _released(self) -> None:
        """Stop streaming: there is no client."""
        self._stream.stop()
        self._messages.host_port = 0
        self._device.execute("AcquisitionStop")
        self._device.features.update("TLParamsLocked", 0)

    def _power_on(self) -> None:
        self._control.reset()
        self._stream.reset()
        self._messages.reset()
        if self._actions is not None:
            self._actions.reset()


def _bind(address: str, *, reuse: bool) -> socket.socket:
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    if reuse:
        udp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        udp.bind((address, gvcp.PORT))
    except OSError as error:
        udp.close()
        if error.errno == errno.EADDRINUSE:
            raise AddressTakenError(
                f"another camera already answers at {address}: end that one (a demo?), or choose another address"
            ) from error
        raise
    return udp
