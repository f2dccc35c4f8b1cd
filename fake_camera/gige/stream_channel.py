"""The stream channel: sends frames as GVSP packets, at a pace that a receiver keeps up with, and again on request."""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections import deque
from ipaddress import IPv4Address

from fake_camera.device.faults import Fault, Faults
from fake_camera.genicam.status import CommandError, Status
from fake_camera.gige.gvcp import Resend
from fake_camera.gige.gvsp import Block, trial_packet, unavailable_packet
from fake_camera.gige.switch import Switch
from fake_camera.imaging import ExposedFrame

MIN_PACKET_BYTES = 220
MAX_PACKET_BYTES = 9000  # also at power-on, since large packets take a third of the processor time of small ones

MAX_PACKET_DELAY_NS = 1_000_000

_PACE_S_PER_BYTE = 0.3e-3 / 65536
"""Pause per byte sent: a client's default socket buffer (about 200 kB) loses packets of an unpaced frame."""

_IP_UDP_BYTES = 28
_SHORTEST_PAUSE_S = 0.25e-3  # pauses are saved up to this, since shorter ones cost more processor time than they help
_BLOCKS_KEPT = 8

_FIRE_TEST_PACKET = 1 << 31
_DO_NOT_FRAGMENT = 1 << 30

# Constants that Python's socket module lacks (linux/in.h).
_IP_MTU_DISCOVER, _IP_PMTUDISC_DONT, _IP_PMTUDISC_DO = 10, 0, 2

_AWAY = 128  # between an address and that of the fault `other_address`, which the loopback interface has, too


class StreamChannel:
    """One stream to one client; its settings are those of the stream channel registers.

    Attributes
    ----------
    source_port
        The UDP port that packets come from.
    """

    def __init__(self, address: str, faults: Faults, switch: Switch | None = None) -> None:
        self._faults = faults
        self._switch = switch
        self._socket = _sending_from(address)
        self._fragments: bool | None = None  # whether the socket makes them at present
        self._other_address = str(IPv4Address(int(IPv4Address(address)) ^ _AWAY))
        self._kept: deque[Block] = deque(maxlen=_BLOCKS_KEPT)
        self._last_frame_id = 0
        self._openings = 0
        self.source_port: int = self._socket.getsockname()[1]
        self._power_on()

    def _power_on(self) -> None:
        self.host_port = 0
        self.destination = 0
        self._packet_delay_ns = 0
        self._packet_bytes = MAX_PACKET_BYTES
        self._do_not_fragment = True

    def reset(self) -> None:
        """Back to the power-on state: no client."""
        self._power_on()
        self._kept.clear()

    def stop(self) -> None:
        """Close the channel to the client; its settings stay."""
        self.host_port = 0

    def close(self) -> None:
        """Free the socket."""
        self._socket.close()

    @property
    def destination(self) -> int:
        """The client's IPv4 address as a number."""
        return self._destination

    @destination.setter
    def destination(self, value: int) -> None:
        self._destination = value
        self._client = socket.inet_ntoa(struct.pack(">I", value))

    @property
    def host_port(self) -> int:
        """The client's UDP port; 0 closes the channel."""
        return self._host_port

    @host_port.setter
    def host_port(self, value: int) -> None:
        self._host_port = value & 0xFFFF  # the upper half selects a network interface: the stream has only one
        self._openings += 1

    @property
    def packet_delay_ns(self) -> int:
        """Pause after each packet, on top of the pace."""
        return self._packet_delay_ns

    @packet_delay_ns.setter
    def packet_delay_ns(self, delay_ns: int) -> None:
        if delay_ns > MAX_PACKET_DELAY_NS:
            raise CommandError(Status.INVALID_PARAMETER)
        self._packet_delay_ns = delay_ns

    @property
    def packet_size_register(self) -> int:
        """The packet size register: bytes of a packet with all its headers, and the do-not-fragment bit."""
        return self._packet_bytes | (_DO_NOT_FRAGMENT if self._do_not_fragment else 0)

    @packet_size_register.setter
    def packet_size_register(self, value: int) -> None:
        packet_bytes = value & 0xFFFF
        if packet_bytes < MIN_PACKET_BYTES:
            raise CommandError(Status.INVALID_PARAMETER)
        self._packet_bytes = min(packet_bytes, MAX_PACKET_BYTES)
        self._do_not_fragment = bool(value & _DO_NOT_FRAGMENT)
        if value & _FIRE_TEST_PACKET and packet_bytes == self._packet_bytes:
            self._send([trial_packet(packet_bytes)])

    def send(self, frame: ExposedFrame, chunks: bytes) -> None:
        """Send a frame with its chunk data at the channel's pace, and keep it for a while."""
        if not self._host_port:
            return
        block = Block.from_frame(frame, chunks, self._packet_bytes)
        if frame.frame_id <= self._last_frame_id:
            self._kept.clear()  # a new acquisition counts from 1 again: its packets must not come from former frames
        self._last_frame_id = frame.frame_id
        packet_ids = list(range(block.last_packet_id + 1))
        if self._faults.spoils_frame(Fault.TRUNCATE):
            del packet_ids[len(packet_ids) // 2 : -1]  # nor is the rest kept for sending again
        else:
            self._kept.append(block)
        pause_s = 0.0
        opening = self._openings
        for packet_id in packet_ids:
            if self._openings != opening:
                return  # the next client must not get the rest
            sent = self._send(block.packet(packet_id))
            pause_s += sent * _PACE_S_PER_BYTE + self._packet_delay_ns * 1e-9
            if pause_s > _SHORTEST_PAUSE_S:
                time.sleep(pause_s)  # a longer sleep is not made up for, because bursts lose packets
                pause_s = 0.0

    def resend(self, request: Resend) -> None:
        """Send packets again; those no longer kept are answered with one error for the whole request."""
        block = next((block for block in tuple(self._kept) if block.block_id == request.block_id), None)
        if block is None or request.first > block.last_packet_id:
            self._send([unavailable_packet(request.block_id, request.first)])
            return
        for packet_id in range(request.first, min(request.last, block.last_packet_id) + 1):
            self._send(block.packet(packet_id, Status.PACKET_RESEND))

    def _send(self, buffers: list[bytes | memoryview]) -> int:
        """Send one packet and return its size, even if a fault or the network loses it."""
        size = sum(map(len, buffers))
        if not self._host_port or self._faults.vanished or self._faults.lose_packet():
            return size
        if self._switch is not None and not self._switch.passes(size + _IP_UDP_BYTES):
            return size
        client = self._client, self._host_port
        with contextlib.suppress(OSError):  # too big to go unfragmented, no route, no room
            if self._faults.spoils_packet(Fault.OTHER_ADDRESS):
                with _sending_from(self._other_address, self.source_port) as elsewhere:
                    elsewhere.sendmsg(buffers, (), 0, client)
                return size
            careless = self._faults.spoils_packet(Fault.FRAGMENT)
            self._allow_fragments(careless or not self._do_not_fragment)
            self._socket.sendmsg(buffers, (), 0, client)
        return size

    def _allow_fragments(self, allowed: bool) -> None:
        if allowed is not self._fragments:
            self._fragments = allowed
            mode = _IP_PMTUDISC_DONT if allowed else _IP_PMTUDISC_DO
            self._socket.setsockopt(socket.IPPROTO_IP, _IP_MTU_DISCOVER, mode)


def _sending_from(address: str, port: int = 0) -> socket.socket:
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.bind((address, port))
    return sender
