"""What the host's network offers to GigE Vision cameras."""

from __future__ import annotations

import fcntl
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv4Interface
from pathlib import Path

from drivers.host.sysfs import read_number, read_value

SOCKET_BUFFER_BYTES = 4 << 20
"""What the kernel keeps of a GigE Vision stream while no one reads; capped by ``net.core.rmem_max``."""

_SIOCGIFADDR, _SIOCGIFNETMASK = 0x8915, 0x891B  # linux/sockios.h
_IFREQ = struct.Struct("16s24x")
_ADDRESS_AT = slice(20, 24)  # the IPv4 address within the sockaddr_in that follows the name


@dataclass(frozen=True, slots=True)
class NetworkInterface:
    """A network interface that is up; `speed_mbps` is None where it has none, as on `lo` and most wireless ones."""

    name: str
    address: IPv4Interface
    mtu_bytes: int
    speed_mbps: float | None


def interface_address(name: str) -> IPv4Interface | None:
    """The first IPv4 address of an interface, with its subnet; None when it has none."""
    request = _IFREQ.pack(name.encode())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            address, netmask = (
                socket.inet_ntoa(fcntl.ioctl(asking, what, request)[_ADDRESS_AT])
                for what in (_SIOCGIFADDR, _SIOCGIFNETMASK)
            )
        except OSError:
            return None
    return IPv4Interface(f"{address}/{netmask}")


def find_interfaces(
    root: Path = Path("/"), address_of: Callable[[str], IPv4Interface | None] = interface_address
) -> list[NetworkInterface]:
    """The interfaces that are up and have an IPv4 address, by name; facts are read below `root`."""
    interfaces = []
    for folder in sorted((root / "sys/class/net").glob("*/")):
        address = address_of(folder.name)
        mtu_bytes = read_number(folder / "mtu")
        if address is None or mtu_bytes is None or read_value(folder / "operstate") == "down":
            continue
        speed_mbps = read_number(folder / "speed")
        known = speed_mbps is not None and speed_mbps > 0  # -1: the driver does not know
        interfaces.append(NetworkInterface(folder.name, address, int(mtu_bytes), speed_mbps if known else None))
    return interfaces


def largest_socket_buffer_bytes(root: Path = Path("/")) -> int | None:
    """``net.core.rmem_max``: the largest receive buffer that a socket is granted; None when it cannot be read."""
    size_bytes = read_number(root / "proc/sys/net/core/rmem_max")
    return None if size_bytes is None else int(size_bytes)
