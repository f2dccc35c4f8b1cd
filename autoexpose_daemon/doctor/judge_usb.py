"""What the facts of USB mean for the daemon."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from autoexpose_daemon.doctor.need import Diagnosis, Need
from drivers.host.usb import USB3_MBPS, UsbCamera, UsbFacts, usb_bytes_per_s

USBFS_MEMORY_MB = 1000
"""Room for the transfers of any two cameras; the kernel's own limit of 16 MB is too small for them."""

_INSTALL_RULE = (
    "sudo install -m 644 systemd/60-usb3-vision.rules /etc/udev/rules.d/ && "
    "sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb"
)
_RAISE_LIMIT = (
    "sudo install -m 644 systemd/usbfs-memory.conf /etc/tmpfiles.d/ && sudo systemd-tmpfiles --create usbfs-memory.conf"
)
_BLIND = {
    "no bus": (
        "the kernel shows no USB (in a container, or on a machine without USB)",
        "ls /sys/bus/usb/devices /dev/bus/usb   # a container must be given both",
    ),
    "no libusb": ("libusb does not load", "sudo apt install libusb-1.0-0"),
    "no list": ("libusb cannot list the devices", "ls -l /dev/bus/usb/*   # a container must be given them"),
}


def judge_usb(usb: UsbFacts, need: Need, there: Sequence[str]) -> Iterator[Diagnosis]:
    """Findings on the USB3 Vision cameras; `there` are the serial numbers of all cameras found."""
    if usb.blind is not None:
        why, fix = _BLIND[usb.blind]
        complete = bool(need.serials) and set(need.serials.values()) <= set(there)
        sentence = f"USB3 Vision cameras cannot be seen: {why}"
        yield (
            Diagnosis("usb-bus", "ok", f"{sentence}; the configuration names none")
            if complete
            else Diagnosis("usb-bus", "warning", sentence, fix)
        )
    for camera in usb.cameras:
        yield _judge_link(camera, need)
        if need.wants(camera.serial):
            yield _judge_node(camera, need, usb.udev_rule)
            yield from _judge_holders(camera, need)
    wanted = [camera for camera in usb.cameras if need.wants(camera.serial)]
    yield from _judge_bandwidth(wanted, need)
    if usb.blind != "no bus":
        yield _judge_memory(usb.usbfs_memory_mb, bool(wanted))
        yield _judge_rule(usb.udev_rule, bool(wanted))


def _judge_link(camera: UsbCamera, need: Need) -> Diagnosis:
    name = f"{need.name(camera.serial)} ({camera.vendor} {camera.model})"
    speed = "an unknown speed" if camera.speed_mbps is None else f"{camera.speed_mbps:g} Mbit/s"
    if not need.wants(camera.serial):
        return Diagnosis("usb-link", "ok", f"{name} is present at {speed}; the configuration does not name it")
    if camera.speed_mbps is None or camera.speed_mbps >= USB3_MBPS:
        return Diagnosis("usb-link", "ok", f"{name} is linked at {speed}")
    return Diagnosis(
        "usb-link",
        "warning",
        f"{name} is linked at {speed}, which is not SuperSpeed: the cable, hub or port is USB 2",
        "lsusb -t   # shows each link's speed; use a SuperSpeed port and a USB 3 cable",
    )


def _judge_node(camera: UsbCamera, need: Need, udev_rule: str | None) -> Diagnosis:
    node = camera.node
    name = need.name(camera.serial)
    if not node.exists:
        return Diagnosis(
            "usb-node",
            "stops",
            f"{name}: its device node {node.path} does not exist here",
            f"ls -l {node.path}   # a container must be given /dev/bus/usb",
        )
    sentence = f"{name}: its device node {node.path} ({node.mode}, group {node.group})"
    if node.usable:
        return Diagnosis("usb-node", "ok", f"{sentence} may be opened by this user")
    return Diagnosis("usb-node", "stops", f"{sentence} may not be opened by this user", _open_node(camera, udev_rule))


def _open_node(camera: UsbCamera, udev_rule: str | None) -> str:
    """The command that lets this user open a camera."""
    if udev_rule is None:
        return _INSTALL_RULE
    if camera.node.group == "root":  # the rule was installed after the camera was connected
        return "sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb"
    return f"sudo usermod -aG {camera.node.group} $USER   # then log in again"


def _judge_holders(camera: UsbCamera, need: Need) -> Iterator[Diagnosis]:
    if camera.node.holders:
        programs = ", ".join(f"{holder.command} (process {holder.pid})" for holder in camera.node.holders)
        yield Diagnosis(
            "usb-holder",
            "stops",
            f"{need.name(camera.serial)} is in use by {programs}",
            "kill " + " ".join(str(holder.pid) for holder in camera.node.holders),
        )


def _judge_bandwidth(cameras: Sequence[UsbCamera], need: Need) -> Iterator[Diagnosis]:
    """Devices on one root hub share its bandwidth."""
    for bus, group in groupby(sorted(cameras, key=lambda camera: camera.bus), key=lambda camera: camera.bus):
        sharing = list(group)
        serials = [camera.serial for camera in sharing]
        names = " and ".join(map(need.name, serials))
        needed = need.bytes_per_s(serials)
        sentence = (
            f"{names} {'share' if len(sharing) > 1 else 'is on'} bus {bus} of host controller "
            f"{sharing[0].controller or 'unknown'} and need{'' if len(sharing) > 1 else 's'} {needed / 1e6:.0f} MB/s"
        )
        speed_mbps = sharing[0].bus_speed_mbps
        if speed_mbps is None:
            yield Diagnosis("usb-bandwidth", "ok", f"{sentence} of an unknown bandwidth ({need.in_words(serials)})")
            continue
        available = usb_bytes_per_s(speed_mbps, 1)
        sentence += f" of about {available / 1e6:.0f} MB/s ({need.in_words(serials)})"
        if needed <= available:
            yield Diagnosis("usb-bandwidth", "ok", sentence)
        else:
            fix = "lsusb -t   # shows the controllers; give each camera one of its own, or lower trigger.rate_hz"
            yield Diagnosis("usb-bandwidth", "warning", f"{sentence}: frames will be lost", fix)


def _judge_memory(limit_mb: float | None, used: bool) -> Diagnosis:
    if limit_mb is None:
        sentence = "usbfs_memory_mb, the limit on the memory of USB transfers, cannot be read"
    elif limit_mb == 0:
        return Diagnosis("usbfs-memory", "ok", "usbfs_memory_mb is 0: USB transfers may take any amount of memory")
    else:
        sentence = f"usbfs_memory_mb allows {limit_mb:g} MB for all USB transfers"
        if limit_mb >= USBFS_MEMORY_MB:
            return Diagnosis("usbfs-memory", "ok", sentence)
        sentence += f", less than the {USBFS_MEMORY_MB} that two cameras may take"
    if not used:
        return Diagnosis("usbfs-memory", "ok", f"{sentence}; no USB3 Vision camera needs it")
    return Diagnosis("usbfs-memory", "warning", sentence, _RAISE_LIMIT)


def _judge_rule(udev_rule: str | None, used: bool) -> Diagnosis:
    if udev_rule is not None:
        return Diagnosis("udev-rule", "ok", f"{udev_rule} has a udev rule for USB3 Vision cameras")
    sentence = "no udev rule opens USB3 Vision cameras to a group"
    if not used:
        return Diagnosis("udev-rule", "ok", f"{sentence}; no USB3 Vision camera needs it")
    return Diagnosis(
        "udev-rule", "warning", f"{sentence}: unless a vendor's own rule does, only root can open them", _INSTALL_RULE
    )
