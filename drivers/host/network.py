"""What the host's network offers to GigE Vision cameras."""

from __future__ import annotations

import socket
from collections import defaultdict
from dataclasses import dataclass
from ipaddress import IPv4Interface
from pathlib import Path

import psutil

from drivers.host.sysfs import read_number

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
