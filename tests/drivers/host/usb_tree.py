"""A host with USB devices that is only files in a folder, and a libusb that lists them to pyusb."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import usb.core
from usb.backend import IBackend

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
