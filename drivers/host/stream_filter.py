"""A filter on the UDP socket of a GigE Vision stream: the kernel passes what its camera sends and refuses the rest.

Stock Aravis takes stream packets from anyone, and a few of them end the process
(docs/understand/hostile-packets.md). The kernel steers what is refused to a second socket at the same port, where it is
counted and its senders are seen. Neither needs a privilege.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
from collections import Counter
from collections.abc import Collection
from pathlib import Path

from drivers.camera import RefusedPackets

_SO_ATTACH_FILTER, _SO_ATTACH_REUSEPORT_CBPF, _SO_MEMINFO = 26, 51, 55  # asm-generic/socket.h
_MEMINFO = struct.Struct("=9I")  # the last is what found no room (linux/sock_diag.h)

# Classic BPF (linux/filter.h). A load beyond the packet ends a program with 0.
_LOAD_WORD, _LOAD_HALF, _LOAD_BYTE = 0x20, 0x28, 0x30
_AND, _IF_EQUAL, _IF_ABOVE, _IF_ANY_BIT, _RETURN = 0x54, 0x15, 0x25, 0x45, 0x06
_IP_HEADER = 0xFFF00000  # SKF_NET_OFF: offsets from here on count from the IP header
_INSTRUCTION = struct.Struct("=HBBI")
_DROP, _WHOLE = 0, 0xFFFFFFFF
_FIRST_SOCKET, _SECOND_SOCKET = 0, 1

# Offsets: the source address is in the IP header, the source port in the UDP header, at which a filter's offsets start,
# and the GVSP header follows after its 8 bytes. With the extended-id bit set, the packet id is a word of its own.
_SOURCE_ADDRESS, _UDP_HEADER = _IP_HEADER + 12, _IP_HEADER + 20
_FLAGS, _EXTENDED_ID = 8 + 4, 0x80
_PACKET_ID, _PACKET_ID_BITS, _EXTENDED_PACKET_ID = 8 + 4, 0x00FFFFFF, 8 + 16

_MOST_READ = 100  # of refused packets at a time: a flood must not keep their reader
_NAMED_SENDERS = 3

_LARGEST_HEADERS_BYTES = 20 + 8 + 20  # of IP, UDP, and GVSP with extended ids; packet sizes include them

Endpoint = tuple[str, int]
"""IPv4 address and UDP port."""


def largest_packet_id(payload_bytes: int, packet_bytes: int) -> int:
    """Twice the largest packet id of a frame of that size, since cameras may send smaller packets."""
    return 2 * -(-payload_bytes // max(packet_bytes - _LARGEST_HEADERS_BYTES, 1)) + 16


class StreamFilter:
    """Lets this process's UDP socket at `listening` receive only plausible stream packets of its camera.

    The stream comes from `addresses` and `port`, 0 meaning any; packets with an id above `largest_id` are refused.
    Raises OSError when the kernel refuses the filter, or there is no such socket.
    """

    def __init__(self, addresses: Collection[str], port: int, largest_id: int, listening: Endpoint) -> None:
        own = _own_socket(listening)
        if own is None:
            raise OSError(errno.ENOENT, f"this process has no UDP socket at {listening[0]}:{listening[1]}")
        self._addresses = tuple(sorted(addresses))
        self._unread = 0
        with own:
            _attach(own, _SO_ATTACH_FILTER, filter_program(addresses, port, largest_id))
            self._second = _second_socket(own, steering_program(addresses, port, largest_id))

    def refused(self) -> RefusedPackets | None:
        """What was refused since the last call; None: nothing."""
        senders: Counter[str] = Counter()
        unread = self._unread
        try:
            while self._second is not None and senders.total() < _MOST_READ:
                memory = self._second.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
                *_, self._unread = _MEMINFO.unpack(memory)
                _, (address, port) = self._second.recvfrom(0)
                senders[f"{address}:{port}"] += 1
        except OSError:  # there are no more, or it was closed
            pass
        if not senders:
            return None
        named = tuple(sender for sender, _ in senders.most_common(_NAMED_SENDERS))
        return RefusedPackets(senders.total() + self._unread - unread, named, self._addresses)

    def close(self) -> None:
        """Stop counting; the filter stays for as long as its socket."""
        if self._second is not None:
            self._second.close()


def why_not() -> str | None:
    """Why this host refuses a filter; None when it accepts one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            _attach(probe, _SO_ATTACH_FILTER, filter_program(["127.0.0.1"], 0, 0))
        except OSError as error:
            return error.strerror or str(error)
    return None


def filter_program(addresses: Collection[str], port: int, largest_id: int) -> bytes:
    """The filter as classic BPF."""
    return _program(addresses, port, largest_id, udp_header=0, admitted=_WHOLE, refused=_DROP)


def steering_program(addresses: Collection[str], port: int, largest_id: int) -> bytes:
    """The same decision as the number of the socket that gets the packet; for IP headers without options."""
    return _program(addresses, port, largest_id, udp_header=_UDP_HEADER, admitted=_FIRST_SOCKET, refused=_SECOND_SOCKET)


def _program(
    addresses: Collection[str], port: int, largest_id: int, *, udp_header: int, admitted: int, refused: int
) -> bytes:
    """Its jumps count instructions: one for a test that holds and one for a test that does not."""
    own = [(_IF_EQUAL, int.from_bytes(socket.inet_aton(address), "big")) for address in addresses]
    source = [(_LOAD_WORD, _SOURCE_ADDRESS), *own]
    if port:
        source += [(_LOAD_HALF, udp_header), (_IF_EQUAL, port)]
    extended = [(_LOAD_WORD, udp_header + _EXTENDED_PACKET_ID), (_IF_ABOVE, largest_id), (_RETURN, admitted)]
    standard = [(_LOAD_WORD, udp_header + _PACKET_ID), (_AND, _PACKET_ID_BITS), *extended[1:]]
    flags = [(_LOAD_BYTE, udp_header + _FLAGS), (_IF_ANY_BIT, _EXTENDED_ID)]
    steps = [*source, *flags, *standard, *extended, (_RETURN, refused)]
    instructions = []
    for index, (code, operand) in enumerate(steps):
        refuse = len(steps) - 2 - index
        other_addresses = len(own) - index if index <= len(own) else 0  # still to be compared with
        jumps = {
            _IF_EQUAL: (other_addresses, 0 if other_addresses else refuse),
            _IF_ABOVE: (refuse, 0),
            _IF_ANY_BIT: (len(standard), 0),
        }
        instructions.append(_INSTRUCTION.pack(code, *jumps.get(code, (0, 0)), operand))
    return b"".join(instructions)


def _attach(target: socket.socket, option: int, program: bytes) -> None:
    instructions = ctypes.create_string_buffer(program, len(program))
    pointer = struct.pack("@HP", len(program) // _INSTRUCTION.size, ctypes.addressof(instructions))
    target.setsockopt(socket.SOL_SOCKET, option, pointer)


def _second_socket(first: socket.socket, steering: bytes) -> socket.socket | None:
    """A socket at the same port, for what `steering` sends there; None: the kernel cannot, and nobody counts.

    A socket that is already bound joins such a group as its first as soon as it allows that.
    """
    second = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
    try:
        for each in (first, second):
            each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        second.bind(first.getsockname())
        _attach(second, _SO_ATTACH_REUSEPORT_CBPF, steering)
    except OSError:
        second.close()
        return None
    return second


def _own_socket(listening: Endpoint) -> socket.socket | None:
    """Another descriptor of the socket; libraries give the port of theirs, but not the descriptor."""
    for link in Path("/proc/self/fd").iterdir():
        try:
            if not str(link.readlink()).startswith("socket:"):
                continue
            descriptor = os.dup(int(link.name))
        except OSError:  # closed in the meantime
            continue
        try:
            candidate = socket.socket(fileno=descriptor)
        except OSError:  # its number now belongs to another file
            os.close(descriptor)
            continue
        kind = candidate.family, candidate.type
        if kind == (socket.AF_INET, socket.SOCK_DGRAM) and candidate.getsockname() == listening:
            return candidate
        candidate.close()
    return None
