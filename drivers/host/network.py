"""What the host's network offers to GigE Vision cameras, and which cameras answer on it."""

from __future__ import annotations

import math
import secrets
import select
import socket
import struct
import time
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Interface
from pathlib import Path
from typing import Literal

import psutil

from drivers.host import read_number
from drivers.setup import ActionKeys

SOCKET_BUFFER_BYTES = 4 << 20
"""What the kernel keeps of a GigE Vision stream while no one reads; capped by ``net.core.rmem_max``."""


@dataclass(frozen=True, slots=True)
class NetworkInterface:
    """A network interface that is up, with its IPv4 addresses and their subnets.

    `speed_mbps` is None if there is none, as on `lo` and most wireless interfaces.
    """

    name: str
    addresses: tuple[IPv4Interface, ...]
    mtu_bytes: int
    speed_mbps: float | None


def find_interfaces() -> list[NetworkInterface]:
    """The interfaces that are up and have an IPv4 address, by name."""
    addresses: dict[str, list[IPv4Interface]] = defaultdict(list)
    for label, entries in psutil.net_if_addrs().items():
        name = label.partition(":")[0]  # a second address may have a label of its own, as in eth0:1
        addresses[name] += [
            IPv4Interface(f"{entry.address}/{entry.netmask or 32}")
            for entry in entries
            if entry.family == socket.AF_INET
        ]
    stats = psutil.net_if_stats()
    return [
        NetworkInterface(name, tuple(addresses[name]), stats[name].mtu, stats[name].speed or None)
        for name in sorted(addresses)
        if addresses[name] and name in stats and stats[name].isup
    ]


def interface_with(address: str) -> NetworkInterface | None:
    """The interface that has an IPv4 address; None if none has."""
    return next((each for each in find_interfaces() if any(str(own.ip) == address for own in each.addresses)), None)


def largest_socket_buffer_bytes(root: Path = Path("/")) -> int | None:
    """``net.core.rmem_max``: the largest receive buffer that a socket is granted; None when it cannot be read."""
    size_bytes = read_number(root / "proc/sys/net/core/rmem_max")
    return None if size_bytes is None else int(size_bytes)


USABLE_SHARE = 0.9
"""Share of a GigE Vision link: the rest is for packets that are sent again, and for other traffic."""
_HEADERS_BYTES = 36
"""Headers of IP, UDP and GVSP, which count as part of a packet's size."""
_FRAMING_BYTES = 38
"""What Ethernet adds: preamble, header, checksum and gap."""


def bytes_per_s(mbps: float, cameras: int) -> float:
    """What each of this many cameras may send over a GigE Vision link, so that nothing before it overflows.

    Hardware triggers make cameras send at the same instant, each as fast as its own cable allows. A switch keeps what
    the common cable to the host cannot take at once, in a buffer that holds less than a frame, and drops the rest.
    """
    return USABLE_SHARE * mbps * 1e6 / 8 / cameras


def packet_delay_ns(packet_bytes: int, share_bytes_per_s: float, own_bytes_per_s: float | None) -> int:
    """How long a camera has to pause after each packet, of this size with its headers, to keep to its share.

    `own_bytes_per_s` is how fast it sends one by itself; None: unknown, then no time is allowed for it.
    """
    on_the_wire = packet_bytes + _FRAMING_BYTES
    sending_s = 0.0 if own_bytes_per_s is None else on_the_wire / own_bytes_per_s
    return max(math.ceil(1e9 * (on_the_wire / share_bytes_per_s - sending_s)), 0)


def packets_of(frame_bytes: int, packet_bytes: int) -> int:
    """How many stream packets of a size, headers included, carry a frame."""
    return math.ceil(frame_bytes / (packet_bytes - _HEADERS_BYTES))


def needed_bytes_per_s(frame_bytes: int, packet_bytes: int, rate_hz: float) -> float:
    """What a camera sends on average, with the headers of its packets."""
    return rate_hz * (frame_bytes + packets_of(frame_bytes, packet_bytes) * (_HEADERS_BYTES + _FRAMING_BYTES))


PORT = 3956
"""The UDP port that every GigE Vision camera listens on."""
SEARCH_S = 1.0
"""How long to wait for answers to a search; cameras may spread theirs over some tenths of a second."""
ANSWER_S = 0.5
TRIES = 3

_DISCOVERY, _READREG = 0x0002, 0x0080
_ACK_REQUIRED, _BROADCAST_ANSWER = 0x01, 0x10
_SUCCESS, _ACCESS_DENIED, _BUSY = 0x0000, 0x8006, 0x8007
_HEADER, _ACK_HEADER = struct.Struct(">BBHHH"), struct.Struct(">HHHH")
_SEARCH_ID = 1
_CONTROL_PRIVILEGE = 0x0A00
_NETWORK_INTERFACES = 0x0600
_CURRENT_ADDRESSES = (0x0024, 0x069C, 0x071C, 0x079C)
"""Registers of the IPv4 address of each of a camera's network interfaces."""
_STREAM_PORT, _PACKET_SIZE, _PACKET_SIZE_BITS = 0x0D00, 0x0D04, 0xFFFF
_PTP_STATUS = 0x096C
PTP_STATES = {
    **{1: "Initializing", 2: "Faulty", 3: "Disabled", 4: "Listening", 5: "PreMaster", 6: "Master", 7: "Passive"},
    **{8: "Uncalibrated", 9: "Slave"},
}
"""States of a port by their numbers in IEEE 1588, in the words of SFNC."""
_HELD = 0b11  # exclusive access, control access
_IDENTITY_BYTES = 0xF8
_IP_PKTINFO = 8  # linux/in.h

Control = Literal["free", "held", "silent"]
"""Whether someone controls a camera; `silent`: it did not answer."""


@dataclass(frozen=True, slots=True)
class GigeCamera:
    """A camera that answered a search; `address` is its own, with its subnet."""

    serial: str
    vendor: str
    model: str
    address: IPv4Interface
    interface: NetworkInterface

    @property
    def reachable(self) -> bool:
        """Whether the camera is in a subnet of the interface: packets to any other address go elsewhere."""
        return any(self.address.ip in own.network for own in self.interface.addresses)


@dataclass(frozen=True, slots=True)
class Search:
    """What a search found; `failures` gives the reasons for interfaces that could not be searched, by name."""

    cameras: tuple[GigeCamera, ...]
    failures: dict[str, str]


def search(interfaces: Iterable[NetworkInterface], wait_s: float = SEARCH_S, wanted: Collection[str] = ()) -> Search:
    """Search every interface for cameras; up to `TRIES` times, until the `wanted` serial numbers have answered.

    Cameras in a foreign subnet are found too, since they are asked to answer by broadcast.
    """
    cameras: dict[tuple[str, IPv4Interface], GigeCamera] = {}
    failures: dict[str, str] = {}
    with ExitStack() as stack:
        asking: dict[socket.socket, NetworkInterface] = {}
        askers = {
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)): interface for interface in interfaces
        }
        for _ in range(TRIES):
            asking.clear()
            for asker, own in askers.items():
                try:
                    _ask_everyone(asker, own)
                    asking[asker] = own
                except OSError as error:
                    failures[own.name] = error.strerror or str(error)
            for camera in _identities(asking, time.monotonic() + wait_s):
                # A broadcast on a network card also reaches cameras on the host's own loopback.
                if camera.reachable or (camera.serial, camera.address) not in cameras:
                    cameras[camera.serial, camera.address] = camera
            if {camera.serial for camera in cameras.values()} >= set(wanted):
                break
    return Search(tuple(sorted(cameras.values(), key=lambda camera: camera.serial)), failures)


def control_of(camera_address: str, answer_s: float = ANSWER_S) -> Control:
    """Read the control privilege register of the camera at an IPv4 address."""
    answer = _read_register(camera_address, _CONTROL_PRIVILEGE, answer_s)
    if answer is None:
        return "silent"
    if answer.status == _ACCESS_DENIED:  # on some cameras exclusive access hides even this register
        return "held"
    if answer.status != _SUCCESS:
        return "silent"
    return "held" if answer.value & _HELD else "free"


def ptp_status_of(camera_address: str, answer_s: float = ANSWER_S) -> str | None:
    """The PtpStatus of the camera at an IPv4 address, from its bootstrap register; None if it does not show one."""
    answer = _read_register(camera_address, _PTP_STATUS, answer_s)
    return None if answer is None or answer.status != _SUCCESS else PTP_STATES.get(answer.value)


def addresses_of(camera_address: str, answer_s: float = ANSWER_S) -> frozenset[str]:
    """The addresses that a camera's control channel answers from, and those that its network interfaces have.

    Its stream may leave from any of them. An answer counts only with the random id of its request.
    """
    found: set[str] = set()

    def read(register: int) -> int | None:
        answer = _read_register(camera_address, register, answer_s, from_anywhere=True)
        if answer is None:
            return None
        found.add(answer.sender)
        return answer.value if answer.status == _SUCCESS else None

    interfaces = read(_NETWORK_INTERFACES)
    if not found:  # it does not answer us
        return frozenset()
    for register in _CURRENT_ADDRESSES[: interfaces or 1]:
        if named := read(register):  # 0 is no address
            found.add(str(IPv4Address(named)))
    return frozenset(found)


def streamed_packet_bytes(camera_address: str, answer_s: float = ANSWER_S) -> int | None:
    """The size of the packets of the stream that a camera sends at present; None if it sends none."""
    port = _read_register(camera_address, _STREAM_PORT, answer_s)
    size = _read_register(camera_address, _PACKET_SIZE, answer_s)
    if port is None or size is None or not port.value & 0xFFFF or size.status != _SUCCESS:
        return None
    return size.value & _PACKET_SIZE_BITS


@dataclass(frozen=True, slots=True)
class _Answer:
    """Status and value of a bootstrap register (0 without success), and who answered."""

    status: int
    value: int
    sender: str


def _read_register(
    camera_address: str, register: int, answer_s: float, *, from_anywhere: bool = False
) -> _Answer | None:
    """Read a bootstrap register; None if no answer comes from the camera's address, or at all.

    A camera without that register refuses at once. One that is busy is asked again.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        for _ in range(TRIES):
            request_id = secrets.randbelow(0xFFFF) + 1
            deadline_s = time.monotonic() + answer_s
            try:
                if not from_anywhere:
                    asker.connect((camera_address, PORT))
                asker.sendto(_command(_READREG, struct.pack(">I", register), request_id), (camera_address, PORT))
                while (left_s := deadline_s - time.monotonic()) > 0:
                    asker.settimeout(left_s)
                    datagram, (sender, _) = asker.recvfrom(2048)
                    status, acknowledged, payload = _parse(datagram, request_id)
                    final = len(payload) >= 4 if status == _SUCCESS else status != _BUSY
                    if acknowledged == _READREG + 1 and final:
                        return _Answer(status, int.from_bytes(payload[:4], "big"), sender)
            except OSError:  # timed out, or the host itself reports that nothing is there
                continue
    return None


def _identities(asking: Mapping[socket.socket, NetworkInterface], deadline_s: float) -> Iterator[GigeCamera]:
    """Who answers until then; answers already there are read even if this process had no time for them before."""
    while ready := select.select(list(asking), [], [], max(deadline_s - time.monotonic(), 0.0))[0]:
        for asker in ready:
            camera = _read_identity(asker.recv(2048), asking[asker])
            if camera is not None:
                yield camera


def _ask_everyone(asker: socket.socket, interface: NetworkInterface) -> None:
    # Bound to the device but to no address, it also receives answers that were broadcast.
    asker.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, interface.name.encode())
    asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    # By itself the kernel does not send broadcasts from 127.0.0.1.
    discovery = _command(_DISCOVERY, b"", _SEARCH_ID, _BROADCAST_ANSWER)
    for own in interface.addresses:
        sender = struct.pack("=i4s4x", 0, own.ip.packed)
        asker.sendmsg([discovery], [(socket.IPPROTO_IP, _IP_PKTINFO, sender)], 0, ("255.255.255.255", PORT))


def _command(number: int, payload: bytes, request_id: int, flags: int = 0) -> bytes:
    return _HEADER.pack(0x42, flags | _ACK_REQUIRED, number, len(payload), request_id) + payload


def _parse(datagram: bytes, request_id: int) -> tuple[int, int, bytes]:
    """Status, number of the acknowledgement and payload; zeros for anything else, or to another request."""
    if len(datagram) < _ACK_HEADER.size:
        return 0, 0, b""
    status, acknowledged, _, answered = _ACK_HEADER.unpack_from(datagram)
    return (status, acknowledged, datagram[_ACK_HEADER.size :]) if answered == request_id else (0, 0, b"")


def _read_identity(datagram: bytes, interface: NetworkInterface) -> GigeCamera | None:
    status, acknowledged, identity = _parse(datagram, _SEARCH_ID)
    if status != _SUCCESS or acknowledged != _DISCOVERY + 1 or len(identity) < _IDENTITY_BYTES:
        return None

    def text(at: int, length: int) -> str:
        return identity[at : at + length].split(b"\0", 1)[0].decode("utf-8", "replace").strip()

    address, netmask = (socket.inet_ntoa(identity[at : at + 4]) for at in (0x24, 0x34))
    try:
        subnet = IPv4Interface(f"{address}/{netmask}")
    except ValueError:  # an invalid netmask says nothing about the subnet
        subnet = IPv4Interface(address)
    # A camera without a serial number is named by its MAC address, as in Aravis.
    serial = text(0xD8, 16) or identity[0x0A:0x10].hex(":")
    return GigeCamera(serial, text(0x48, 32), text(0x68, 32), subnet, interface)


_ACTION, _SCHEDULED = 0x0100, 0x80
_REQUEST_IDS = 0xFFFF  # 1 ... 65535: 0 is none
_STATUSES = {
    0x8013: "its clock was never set by a PTP master",
    0x8015: "it keeps no more of them",
    0x8016: "it came too late",
}


def action_command(keys: ActionKeys, device_time_ns: int, request_id: int) -> bytes:
    """A scheduled ACTION_CMD of GigE Vision 2.0, to act when the camera's clock shows `device_time_ns`."""
    payload = struct.pack(">IIIQ", keys.device, keys.group, keys.mask, device_time_ns)
    return _command(_ACTION, payload, request_id, _SCHEDULED)


def refusal(answer: bytes) -> str | None:
    """Why a camera did not take a command, in words; None if it did, or if the datagram is not such an answer."""
    status, answered = struct.unpack_from(">HH", answer) if len(answer) >= _ACK_HEADER.size else (0, 0)
    if answered != _ACTION + 1 or not status:
        return None
    return _STATUSES.get(status, f"status 0x{status:04x}")


class ActionSender:
    """Sends scheduled action commands to one camera, without waiting for its answers.

    Raises OSError when the host has no route to the camera, or no socket to spare.
    """

    def __init__(self, camera_address: str, port: int = PORT) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((camera_address, port))
        except OSError:
            self._socket.close()
            raise
        self._sent = 0

    def send(self, keys: ActionKeys, device_time_ns: int) -> str | None:
        """Send one; returns why the camera refused an earlier one, each once. Raises OSError when it cannot be sent."""
        self._socket.send(action_command(keys, device_time_ns, self._sent % _REQUEST_IDS + 1))
        self._sent += 1
        while (answer := self._received()) is not None:
            if (why := refusal(answer)) is not None:
                return why  # others are read with the next commands
        return None

    def close(self) -> None:
        """Free the socket."""
        self._socket.close()

    def _received(self) -> bytes | None:
        try:
            return self._socket.recv(64)
        except OSError:  # nothing there, or the host reports that nobody listens
            return None
