"""Network facts, read from a host that is files in a folder."""

from __future__ import annotations

from ipaddress import IPv4Interface
from pathlib import Path

from drivers.host.network import NetworkInterface, find_interfaces, interface_address, largest_socket_buffer_bytes

ADDRESSES = {"eth0": IPv4Interface("192.168.7.1/24"), "lo": IPv4Interface("127.0.0.1/8")}


def interface(root: Path, name: str, mtu: int, operstate: str, speed: str | None = None) -> None:
    folder = root / "sys/class/net" / name
    folder.mkdir(parents=True)
    (folder / "mtu").write_text(f"{mtu}\n")
    (folder / "operstate").write_text(f"{operstate}\n")
    if speed is not None:
        (folder / "speed").write_text(f"{speed}\n")


def test_interfaces_that_are_up_and_have_an_address_are_found(tmp_path: Path) -> None:
    interface(tmp_path, "eth0", 1500, "up", "1000")
    interface(tmp_path, "eth1", 1500, "up", "1000")  # no address
    interface(tmp_path, "lo", 65536, "unknown")
    assert find_interfaces(tmp_path, ADDRESSES.get) == [
        NetworkInterface("eth0", ADDRESSES["eth0"], 1500, 1000),
        NetworkInterface("lo", ADDRESSES["lo"], 65536, None),
    ]


def test_an_interface_that_is_down_does_not_count(tmp_path: Path) -> None:
    interface(tmp_path, "eth0", 1500, "down")
    assert find_interfaces(tmp_path, ADDRESSES.get) == []


def test_a_speed_that_the_driver_does_not_know_is_none(tmp_path: Path) -> None:
    interface(tmp_path, "eth0", 1500, "up", "-1")
    assert find_interfaces(tmp_path, ADDRESSES.get)[0].speed_mbps is None


def test_the_kernel_tells_the_address_of_the_loopback() -> None:
    assert interface_address("lo") == IPv4Interface("127.0.0.1/8")
    assert interface_address("no-such-if") is None


def test_the_socket_buffer_limit_is_read(tmp_path: Path) -> None:
    assert largest_socket_buffer_bytes(tmp_path) is None
    file = tmp_path / "proc/sys/net/core/rmem_max"
    file.parent.mkdir(parents=True)
    file.write_text("212992\n")
    assert largest_socket_buffer_bytes(tmp_path) == 212992
