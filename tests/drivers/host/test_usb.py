"""USB facts, read from a host that is files in a folder, through the real pyusb."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core
from usb.backend import IBackend

from drivers.host.usb import Process, find_usb
from tests import REPOSITORY

CAMERA_INTERFACES = ((0xEF, 0x05, 0x00), (0xEF, 0x05, 0x02))
"""Class, subclass and protocol of a USB3 Vision camera's control and stream interface."""


@dataclass(frozen=True)
class UsbDevice:
    """A device to plug into the tree; its address is also the number of its port."""

    bus: int = 2
    address: int = 3
    serial: str | None = "U3V-1"
    maker: str | None = "Maker"
    product: str | None = "Model"
    speed_mbps: float = 5000
    controller: str = "0000:00:14.0"
    interfaces: tuple[tuple[int, int, int], ...] = CAMERA_INTERFACES

    def texts(self) -> dict[str, str]:
        """The strings that it has, by their names in sysfs."""
        strings = {"serial": self.serial, "manufacturer": self.maker, "product": self.product}
        return {name: text for name, text in strings.items() if text is not None}


class UsbTree:
    """The tree below `root`: what sysfs, procfs, udev and /dev of such a host would hold."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.devices: list[UsbDevice] = []
        (root / "sys/bus/usb/devices").mkdir(parents=True)

    def plug_in(self, device: UsbDevice) -> Path:
        """Add a device with its root hub; returns its node."""
        hub = self.root / f"sys/devices/pci0000:00/{device.controller}/usb{device.bus}"
        folder = hub / f"{device.bus}-{device.address}"
        self.write(hub / "speed", f"{device.speed_mbps:g}")
        for name, text in device.texts().items():
            self.write(folder / name, text)
        self.write(folder / "speed", f"{device.speed_mbps:g}")
        for place in (hub, folder):
            link = self.root / "sys/bus/usb/devices" / place.name
            if not link.exists():
                link.symlink_to(place)
        node = self.root / f"dev/bus/usb/{device.bus:03d}/{device.address:03d}"
        self.write(node, "")
        self.devices.append(device)
        return node

    def hold(self, node: Path, pid: int, command: str) -> None:
        """Let a program have a device node open."""
        self.write(self.root / f"proc/{pid}/comm", command)
        descriptor = self.root / f"proc/{pid}/fd/7"
        descriptor.parent.mkdir()
        descriptor.symlink_to("/" + str(node.relative_to(self.root)))

    def write(self, file: Path, text: str) -> None:
        """Write a file as the kernel would: with a newline at its end."""
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n")

    def backend(self) -> IBackend:
        """What pyusb takes for libusb."""
        return ListedDevices(self.devices)


class ListedDevices(IBackend):  # type: ignore[misc]  # pyusb has no types
    """As much of libusb as listing takes. `refusal` is raised when a device is opened: by default it fails the test."""

    def __init__(self, devices: list[UsbDevice], refusal: BaseException | None = None) -> None:
        self._devices = devices
        self._refusal = refusal or AssertionError("the device was opened")

    def enumerate_devices(self) -> Iterator[UsbDevice]:
        return iter(self._devices)

    def get_device_descriptor(self, dev: UsbDevice) -> Any:
        names = ["bLength", "bDescriptorType", "bcdUSB", "bDeviceClass", "bDeviceSubClass", "bDeviceProtocol"]
        numbers = dict.fromkeys([*names, "bMaxPacketSize0", "bcdDevice"], 1)
        strings = {"iManufacturer": dev.maker, "iProduct": dev.product, "iSerialNumber": dev.serial}
        return SimpleNamespace(
            **numbers,
            **{name: int(text is not None) for name, text in strings.items()},  # 0: no such string
            bus=dev.bus,
            address=dev.address,
            port_number=dev.address,
            port_numbers=(dev.address,),
            speed=4,
            idVendor=0x1234,
            idProduct=0xABCD,
            bNumConfigurations=1,
        )

    def get_configuration_descriptor(self, dev: UsbDevice, config: int) -> Any:
        names = ["bLength", "bDescriptorType", "wTotalLength", "bConfigurationValue", "iConfiguration"]
        numbers = dict.fromkeys([*names, "bmAttributes", "bMaxPower"], 1)
        return SimpleNamespace(**numbers, bNumInterfaces=len(dev.interfaces), extra_descriptors=[])

    def get_interface_descriptor(self, dev: UsbDevice, intf: int, alt: int, config: int) -> Any:
        if alt > 0:
            raise IndexError
        of_class, subclass, protocol = dev.interfaces[intf]
        numbers = dict.fromkeys(["bLength", "bDescriptorType", "bInterfaceNumber", "bNumEndpoints", "iInterface"], 0)
        return SimpleNamespace(
            **numbers,
            bAlternateSetting=alt,
            bInterfaceClass=of_class,
            bInterfaceSubClass=subclass,
            bInterfaceProtocol=protocol,
            extra_descriptors=[],
        )

    def open_device(self, dev: UsbDevice) -> Any:
        raise self._refusal


class RefusingDevices(ListedDevices):
    """A libusb that cannot list anything."""

    def enumerate_devices(self) -> Iterator[UsbDevice]:
        raise usb.core.USBError("Other error")


RULE = 'SUBSYSTEM=="usb", ENV{ID_USB_INTERFACES}=="*:ef0500:*", GROUP="video", MODE="0660"'


@pytest.fixture
def tree(tmp_path: Path) -> UsbTree:
    return UsbTree(tmp_path)


def test_a_camera_is_described_without_being_opened(tree: UsbTree) -> None:
    node = tree.plug_in(UsbDevice())
    node.chmod(0o660)
    (camera,) = find_usb(tree.root, tree.backend).cameras
    assert (camera.serial, camera.vendor, camera.model) == ("U3V-1", "Maker", "Model")
    assert (camera.speed_mbps, camera.bus_speed_mbps) == (5000, 5000)
    assert (camera.bus, camera.controller) == (2, "0000:00:14.0")
    assert camera.node.path == "/dev/bus/usb/002/003"
    assert (camera.node.exists, camera.node.usable, camera.node.mode) == (True, True, "-rw-rw----")
    assert camera.node.holders == ()


@pytest.mark.parametrize(
    "interfaces",
    [
        ((0x03, 0x01, 0x02),),  # a mouse
        ((0x0E, 0x01, 0x00), (0x0E, 0x02, 0x00)),  # a webcam
        ((0xEF, 0x05, 0x02),),  # the standard's stream without its control
    ],
)
def test_other_devices_are_no_cameras(tree: UsbTree, interfaces: tuple[tuple[int, int, int], ...]) -> None:
    tree.plug_in(UsbDevice(interfaces=interfaces))
    assert find_usb(tree.root, tree.backend).cameras == ()


def test_cameras_are_told_apart_by_bus_and_address(tree: UsbTree) -> None:
    tree.plug_in(UsbDevice(bus=4, address=2, serial="B", controller="0000:05:00.0"))
    tree.plug_in(UsbDevice(bus=2, address=2, serial="A"))
    tree.plug_in(UsbDevice(bus=1, address=9, serial="slow", speed_mbps=480))
    cameras = find_usb(tree.root, tree.backend).cameras
    assert [(camera.serial, camera.speed_mbps, camera.controller) for camera in cameras] == [
        ("slow", 480, "0000:00:14.0"),
        ("A", 5000, "0000:00:14.0"),
        ("B", 5000, "0000:05:00.0"),
    ]


def test_a_camera_without_strings_goes_by_its_numbers(tree: UsbTree) -> None:
    tree.plug_in(UsbDevice(serial=None, maker=None, product=None))
    (camera,) = find_usb(tree.root, tree.backend).cameras
    assert (camera.serial, camera.vendor, camera.model) == (None, "vendor 1234", "product abcd")


def test_a_name_that_neither_sysfs_nor_the_camera_gives_is_unknown(tmp_path: Path) -> None:
    """No sysfs, and a camera that may not be opened."""
    (camera,) = find_usb(tmp_path, lambda: ListedDevices([UsbDevice()], usb.core.USBError("Access denied"))).cameras
    assert (camera.serial, camera.vendor, camera.model) == (None, "vendor 1234", "product abcd")
    assert (camera.speed_mbps, camera.bus_speed_mbps, camera.controller) == (None, None, None)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open every node")
def test_a_node_that_this_user_may_not_open_is_told(tree: UsbTree) -> None:
    tree.plug_in(UsbDevice()).chmod(0o444)
    (camera,) = find_usb(tree.root, tree.backend).cameras
    assert not camera.node.usable


def test_programs_that_have_the_node_open_are_named_but_not_this_one(tree: UsbTree) -> None:
    held, free = tree.plug_in(UsbDevice()), tree.plug_in(UsbDevice(address=4, serial="U3V-2"))
    tree.hold(held, 4711, "arv-viewer-0.8")
    tree.hold(held, 815, "recorder")
    tree.hold(free, os.getpid(), "autoexpose")
    first, second = find_usb(tree.root, tree.backend).cameras
    assert first.node.holders == (Process(815, "recorder"), Process(4711, "arv-viewer-0.8"))
    assert second.node.holders == ()


@pytest.mark.parametrize(
    ("file", "text", "found"),
    [
        ("etc/udev/rules.d/60-usb3-vision.rules", RULE, "/etc/udev/rules.d/60-usb3-vision.rules"),
        ("usr/lib/udev/rules.d/70-maker.rules", RULE, "/usr/lib/udev/rules.d/70-maker.rules"),
        ("etc/udev/rules.d/60-usb3-vision.rules", f"# {RULE}", None),
        ("etc/udev/rules.d/60-usb3-vision.rules.off", RULE, None),
        ("etc/udev/rules.d/99-mouse.rules", 'SUBSYSTEM=="usb"', None),
    ],
)
def test_a_udev_rule_is_found_where_udev_reads_it(tree: UsbTree, file: str, text: str, found: str | None) -> None:
    tree.write(tree.root / file, text)
    assert find_usb(tree.root, tree.backend).udev_rule == found


def test_the_shipped_rule_and_the_memory_limit_are_read_and_a_missing_node_is_told(tree: UsbTree) -> None:
    tree.plug_in(UsbDevice()).unlink()
    facts = find_usb(tree.root, tree.backend)
    assert (facts.udev_rule, facts.usbfs_memory_mb) == (None, None)
    assert not facts.cameras[0].node.exists and not facts.cameras[0].node.usable
    shipped = (REPOSITORY / "systemd/60-usb3-vision.rules").read_text()
    assert 'MODE="0660"' in shipped
    tree.write(tree.root / "etc/udev/rules.d/60-usb3-vision.rules", shipped)
    tree.write(tree.root / "sys/module/usbcore/parameters/usbfs_memory_mb", "16")
    facts = find_usb(tree.root, tree.backend)
    assert facts.udev_rule is not None and facts.usbfs_memory_mb == 16


def test_a_host_without_usb_a_missing_libusb_and_one_that_fails_are_told(tmp_path: Path) -> None:
    assert find_usb(tmp_path, lambda: None).blind == "no bus"
    tree = UsbTree(tmp_path)
    assert find_usb(tmp_path, lambda: None).blind == "no libusb"
    assert find_usb(tmp_path, lambda: RefusingDevices(tree.devices)).blind == "no list"
    assert find_usb(tmp_path, tree.backend).blind is None


def test_this_host_has_a_libusb_and_is_looked_at_without_error() -> None:
    assert find_usb().blind in (None, "no bus")
