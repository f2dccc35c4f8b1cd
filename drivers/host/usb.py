"""USB3 Vision cameras as libusb and the kernel see them, without claiming any."""

from __future__ import annotations

import grp
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import usb.core
from usb.backend import libusb1

from drivers.host import read_number, read_value

USB3_VISION = (0xEF, 0x05)
"""Class and subclass of the interfaces of a USB3 Vision camera."""
CONTROL_PROTOCOL = 0x00
"""Protocol of the control interface, which every camera has."""
UDEV_MATCH = "ef0500"
"""How udev rules name that interface."""

Blind = Literal["no bus", "no libusb", "no list"]
"""Why no USB camera can be seen at all: the kernel shows no USB, libusb does not load, or it cannot list devices."""

_DEVICES = "sys/bus/usb/devices"
_RULE_FOLDERS = ("etc/udev/rules.d", "run/udev/rules.d", "usr/local/lib/udev/rules.d", "usr/lib/udev/rules.d")


USB3_MBPS = 5000
"""The speed of SuperSpeed."""
USB3_USABLE_SHARE = 0.64
"""Share left by line coding and protocol: about 400 of SuperSpeed's 625 MB/s, 40 of the 60 MB/s of USB 2."""


def usb_bytes_per_s(mbps: float, cameras: int) -> float:
    """What each of this many cameras can send over a bus of this many megabits per second."""
    return USB3_USABLE_SHARE * mbps * 1e6 / 8 / cameras


@dataclass(frozen=True, slots=True)
class Process:
    """A running program."""

    pid: int
    command: str


@dataclass(frozen=True, slots=True)
class DeviceNode:
    """The file through which a USB device is opened; `usable`: this user may read and write it."""

    path: str
    exists: bool
    usable: bool
    mode: str
    group: str
    holders: tuple[Process, ...]


@dataclass(frozen=True, slots=True)
class UsbCamera:
    """A USB3 Vision camera; None means that the kernel does not say.

    `bus` is the root hub, whose bandwidth its devices share; `controller` the hardware behind it.
    """

    serial: str | None
    vendor: str
    model: str
    speed_mbps: float | None
    bus: int
    bus_speed_mbps: float | None
    controller: str | None
    node: DeviceNode


@dataclass(frozen=True, slots=True)
class UsbFacts:
    """What the host's USB offers.

    `usbfs_memory_mb` is the kernel's limit on the memory of all USB transfers together, 0 for none; `udev_rule` the
    file with a rule for USB3 Vision cameras.
    """

    cameras: tuple[UsbCamera, ...] = ()
    blind: Blind | None = None
    usbfs_memory_mb: float | None = None
    udev_rule: str | None = None


def find_usb(root: Path = Path("/"), get_backend: Callable[[], Any] = libusb1.get_backend) -> UsbFacts:
    """Look for cameras with libusb; further facts are read below `root`."""
    cameras: list[UsbCamera] = []
    blind: Blind | None = None
    backend = get_backend()
    try:
        devices = [] if backend is None else list(usb.core.find(find_all=True, backend=backend))
        cameras = [_describe(device, root) for device in devices if _is_camera(device)]
    except usb.core.USBError:
        blind = "no list"
    else:
        if not devices and not (root / _DEVICES).is_dir():
            blind = "no bus"
        elif backend is None:
            blind = "no libusb"
    return UsbFacts(
        cameras=tuple(sorted(cameras, key=lambda camera: camera.node.path)),
        blind=blind,
        usbfs_memory_mb=read_number(root / "sys/module/usbcore/parameters/usbfs_memory_mb"),
        udev_rule=_find_udev_rule(root),
    )


def _is_camera(device: Any) -> bool:
    try:
        return any(
            (interface.bInterfaceClass, interface.bInterfaceSubClass) == USB3_VISION
            and interface.bInterfaceProtocol == CONTROL_PROTOCOL
            for configuration in device
            for interface in configuration
        )
    except usb.core.USBError:  # unplugged in the meantime
        return False


def _describe(device: Any, root: Path) -> UsbCamera:
    ports = ".".join(str(port) for port in device.port_numbers or ())
    folder = root / _DEVICES / f"{device.bus}-{ports}"
    root_hub = root / _DEVICES / f"usb{device.bus}"
    return UsbCamera(
        serial=read_value(folder / "serial") or _ask(device, "serial_number"),
        vendor=read_value(folder / "manufacturer") or _ask(device, "manufacturer") or f"vendor {device.idVendor:04x}",
        model=read_value(folder / "product") or _ask(device, "product") or f"product {device.idProduct:04x}",
        speed_mbps=read_number(folder / "speed"),
        bus=device.bus,
        bus_speed_mbps=read_number(root_hub / "speed"),
        controller=root_hub.resolve().parent.name if root_hub.exists() else None,
        node=_read_node(f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}", root),
    )


def _ask(device: Any, name: str) -> str | None:
    """A string descriptor that sysfs does not show; libusb opens the camera to read it."""
    try:
        text: str | None = getattr(device, name)
    except (usb.core.USBError, ValueError):  # no permission to open it; pyusb raises either
        return None
    return text


def _read_node(path: str, root: Path) -> DeviceNode:
    file = root / path.lstrip("/")
    try:
        status = file.stat()
    except OSError:
        return DeviceNode(path, exists=False, usable=False, mode="", group="", holders=())
    try:
        group = grp.getgrgid(status.st_gid).gr_name
    except KeyError:
        group = str(status.st_gid)
    return DeviceNode(
        path,
        exists=True,
        usable=os.access(file, os.R_OK | os.W_OK),
        mode=stat.filemode(status.st_mode),
        group=group,
        holders=_holders(path, root),
    )


def _holders(path: str, root: Path) -> tuple[Process, ...]:
    """The other programs that have a file open; only root sees those of other users."""
    holders = []
    for folder in (root / "proc").glob("[0-9]*"):
        if int(folder.name) == os.getpid():
            continue
        try:
            held = any(str(descriptor.readlink()) == path for descriptor in (folder / "fd").iterdir())
        except OSError:  # of another user, or it has ended
            continue
        if held:
            holders.append(Process(int(folder.name), read_value(folder / "comm") or "unknown"))
    return tuple(sorted(holders, key=lambda process: process.pid))


def _find_udev_rule(root: Path) -> str | None:
    for folder in _RULE_FOLDERS:
        for file in sorted((root / folder).glob("*.rules")):
            lines = (read_value(file) or "").splitlines()
            if any(UDEV_MATCH in line and not line.lstrip().startswith("#") for line in lines):
                return f"/{folder}/{file.name}"
    return None
