"""A filter on the UDP socket of a GigE Vision stream: the kernel passes what its camera sends and drops the rest.

Stock Aravis takes stream packets from anyone, and a few of them end the process (docs/hostile-packets.md). Attaching a
filter to one's own socket needs no privilege.
"""

from __future__ import annotations

import ctypes
import errno
import os
import socket
import struct
from pathlib import Path

_SO_ATTACH_FILTER = 26  # asm-generic/socket.h

# Classic BPF (linux/filter.h). On a UDP socket offset 0 is the UDP header; a load beyond the packet drops it.
_LOAD_WORD, _LOAD_HALF, _LOAD_BYTE = 0x20, 0x28, 0x30
_AND, _IF_EQUAL, _IF_ABOVE, _IF_ANY_BIT, _RETURN = 0x54, 0x15, 0x25, 0x45, 0x06
_IP_HEADER = 0xFFF00000  # SKF_NET_OFF: offsets from here on count from the IP header
_INSTRUCTION = struct.Struct("=HBBI")
_DROP, _WHOLE = 0, 0xFFFFFFFF

# Offsets: the source address is in the IP header, the source port in the UDP header, and the GVSP header follows after
# its 8 bytes. With the extended-id bit set, the packet id is a word of its own.
_SOURCE_ADDRESS, _SOURCE_PORT = _IP_HEADER + 12, 0
_FLAGS, _EXTENDED_ID = 8 + 4, 0x80
_PACKET_ID, _PACKET_ID_BITS, _EXTENDED_PACKET_ID = 8 + 4, 0x00FFFFFF, 8 + 16

_LARGEST_HEADERS_BYTES = 20 + 8 + 20  # of IP, UDP, and GVSP with extended ids; packet sizes include them

Endpoint = tuple[str, int]
"""IPv4 address and UDP port."""


def largest_packet_id(payload_bytes: int, packet_bytes: int) -> int:
    """Twice the largest packet id of a frame of that size, since cameras may send smaller packets."""
    return 2 * -(-payload_bytes // max(packet_bytes - _LARGEST_HEADERS_BYTES, 1)) + 16


def admit_only(camera: Endpoint, largest_id: int, listening: Endpoint) -> None:
    """Let this process's UDP socket at `listening` receive only plausible stream packets of `camera`.

    Parameters
    ----------
    camera
        Source of its stream; port 0 means any.
    largest_id
        Packets with a greater packet id are dropped.
    listening
        Local address and port of the socket.

    Raises
    ------
    OSError
        When the kernel refuses the filter, or there is no such socket.
    """
    own = _own_socket(listening)
    if own is None:
        raise OSError(errno.ENOENT, f"this process has no UDP socket at {listening[0]}:{listening[1]}")
    with own:
        _attach(own, filter_program(camera, largest_id))


def why_not() -> str | None:
    """Why this host refuses a filter; None when it accepts one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            _attach(probe, filter_program(("127.0.0.1", 0), 0))
        except OSError as error:
            return error.strerror or str(error)
    return None


def _attach(target: socket.socket, program: bytes) -> None:
    instructions = ctypes.create_string_buffer(program, len(program))
    pointer = struct.pack("@HP", len(program) // _INSTRUCTION.size, ctypes.addressof(instructions))
    target.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, pointer)


def filter_program(camera: Endpoint, largest_id: int) -> bytes:
    """The filter as classic BPF, whose jumps count instructions, one for a test that holds and one for failure."""
    address, port = int.from_bytes(socket.inet_aton(camera[0]), "big"), camera[1]
    source = [(_LOAD_WORD, _SOURCE_ADDRESS), (_IF_EQUAL, address)]
    if port:
        source += [(_LOAD_HALF, _SOURCE_PORT), (_IF_EQUAL, port)]
    extended = [(_LOAD_WORD, _EXTENDED_PACKET_ID), (_IF_ABOVE, largest_id), (_RETURN, _WHOLE)]
    standard = [(_LOAD_WORD, _PACKET_ID), (_AND, _PACKET_ID_BITS), *extended[1:]]
    steps = [*source, (_LOAD_BYTE, _FLAGS), (_IF_ANY_BIT, _EXTENDED_ID), *standard, *extended, (_RETURN, _DROP)]
    instructions = []
    for index, (code, operand) in enumerate(steps):
        drop = len(steps) - 2 - index
        jumps = {_IF_EQUAL: (0, drop), _IF_ABOVE: (drop, 0), _IF_ANY_BIT: (len(standard), 0)}
        instructions.append(_INSTRUCTION.pack(code, *jumps.get(code, (0, 0)), operand))
    return b"".join(instructions)


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
