"""What the facts of USB and of the network mean for the daemon."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from ipaddress import IPv4Interface
from itertools import groupby

from autoexpose_daemon.doctor.facts import Diagnosis, GigeFacts, Need
from drivers.host.network import SOCKET_BUFFER_BYTES, Control, GigeCamera, NetworkInterface, bytes_per_s, packets_of
from drivers.host.usb import USB3_MBPS, UsbCamera, UsbFacts, usb_bytes_per_s

USBFS_MEMORY_MB = 1000
"""What is installed: room for the transfers of any two cameras. The kernel's own limit of 16 MB is too small."""
_USBFS_MEMORY_MB_EACH = USBFS_MEMORY_MB // 2

_INSTALL_RULE = (
    "sudo install -m 644 systemd/60-usb3-vision.rules /etc/udev/rules.d/ && "
    "sudo udevadm control --reload && sudo udevadm trigger --subsystem-match=usb"
)
_RAISE_LIMIT = (
    "sudo install -m 644 systemd/usbfs-memory.conf /etc/tmpfiles.d/ && sudo systemd-tmpfiles --create usbfs-memory.conf"
)
_RAISE_LIMIT_FURTHER = (
    f"sed s/{USBFS_MEMORY_MB}/{{}}/ systemd/usbfs-memory.conf | "
    "sudo tee /etc/tmpfiles.d/autoexpose-usbfs-memory.conf && "
    "sudo systemd-tmpfiles --create autoexpose-usbfs-memory.conf"
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
    yield from _judge_hubs(wanted, need)
    if usb.blind != "no bus":
        yield _judge_memory(usb.usbfs_memory_mb, len(wanted))
        yield _judge_rule(usb.udev_rule, bool(wanted))


def _judge_link(camera: UsbCamera, need: Need) -> Diagnosis:
    name = f"{need.name(camera.serial)} ({camera.vendor} {camera.model})"
    speed = "an unknown speed" if camera.speed_mbps is None else f"{camera.speed_mbps:g} Mbit/s"
    if not need.wants(camera.serial):
        return Diagnosis("usb-link", "ok", f"{name} is present at {speed}; the configuration does not name it")
    if camera.speed_mbps is None or camera.speed_mbps >= USB3_MBPS:
        return Diagnosis("usb-link", "ok", f"{name} is linked at {speed}")
    sentence = f"{name} is linked at {speed}, which is not SuperSpeed: the cable, hub or port is USB 2"
    fix = "lsusb -t   # shows each link's speed; use a SuperSpeed port and a USB 3 cable"
    return Diagnosis("usb-link", "warning", sentence, fix)


def _judge_node(camera: UsbCamera, need: Need, udev_rule: str | None) -> Diagnosis:
    node = camera.node
    name = need.name(camera.serial)
    if not node.exists:
        sentence = f"{name}: its device node {node.path} does not exist here"
        fix = f"ls -l {node.path}   # a container must be given /dev/bus/usb"
        return Diagnosis("usb-node", "stops", sentence, fix)
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
        sentence = f"{need.name(camera.serial)} is in use by {programs}"
        fix = "kill " + " ".join(str(holder.pid) for holder in camera.node.holders)
        yield Diagnosis("usb-holder", "stops", sentence, fix)


def _judge_hubs(cameras: Sequence[UsbCamera], need: Need) -> Iterator[Diagnosis]:
    """Devices on one root hub share its bandwidth."""
    for bus, group in groupby(sorted(cameras, key=lambda camera: camera.bus), key=lambda camera: camera.bus):
        sharing = list(group)
        serials = [camera.serial for camera in sharing]
        place = f"bus {bus} of host controller {sharing[0].controller or 'unknown'}"
        mbps = sharing[0].bus_speed_mbps
        available = None if mbps is None else usb_bytes_per_s(mbps, 1)
        fix = "lsusb -t   # shows the controllers; give each camera one of its own, or lower trigger.rate_hz"
        needed = need.bytes_per_s(serials)
        yield _judge_bandwidth("usb-bandwidth", place, serials, need, needed=needed, available=available, fix=fix)


def _judge_bandwidth(
    check: str,
    place: str,
    serials: Sequence[str | None],
    need: Need,
    *,
    needed: float,
    available: float | None,
    fix: str,
) -> Diagnosis:
    """Whether a place has the bytes per second that these cameras need; `available` None: nobody knows."""
    several, frames = len(serials) > 1, need.in_words(serials)
    sentence = f"{need.names(serials)} {'share' if several else 'is on'} {place} and need{'' if several else 's'} "
    sentence += f"{needed / 1e6:.0f} MB/s"
    if available is None:
        return Diagnosis(check, "ok", f"{sentence} of an unknown bandwidth ({frames})")
    sentence += f" of about {available / 1e6:.0f} MB/s ({frames})"
    if needed <= available:
        return Diagnosis(check, "ok", sentence)
    return Diagnosis(check, "warning", f"{sentence}: frames will be lost", fix)


def _judge_memory(limit_mb: float | None, cameras: int) -> Diagnosis:
    several = max(cameras, 2)
    needed_mb = several * _USBFS_MEMORY_MB_EACH
    if limit_mb is None:
        sentence = "usbfs_memory_mb, the limit on the memory of USB transfers, cannot be read"
    elif limit_mb == 0:
        return Diagnosis("usbfs-memory", "ok", "usbfs_memory_mb is 0: USB transfers may take any amount of memory")
    else:
        sentence = f"usbfs_memory_mb allows {limit_mb:g} MB for all USB transfers"
        if limit_mb >= needed_mb:
            return Diagnosis("usbfs-memory", "ok", sentence)
        sentence += f", less than the {needed_mb} that {several} cameras may take"
    fix = _RAISE_LIMIT if needed_mb == USBFS_MEMORY_MB else _RAISE_LIMIT_FURTHER.format(needed_mb)
    return _if_used("usbfs-memory", sentence, cameras > 0, "USB3", so="", fix=fix)


def _judge_rule(udev_rule: str | None, used: bool) -> Diagnosis:
    if udev_rule is not None:
        return Diagnosis("udev-rule", "ok", f"{udev_rule} has a udev rule for USB3 Vision cameras")
    sentence = "no udev rule opens USB3 Vision cameras to a group"
    so = ": unless a vendor's own rule does, only root can open them"
    return _if_used("udev-rule", sentence, used, "USB3", so=so, fix=_INSTALL_RULE)


def _if_used(check: str, sentence: str, used: bool, kind: str, *, so: str, fix: str) -> Diagnosis:
    """A warning with what follows, unless no camera of this kind is used."""
    if not used:
        return Diagnosis(check, "ok", f"{sentence}; no {kind} Vision camera needs it")
    return Diagnosis(check, "warning", sentence + so, fix)


JUMBO_BYTES = 8000
"""From this MTU on, a frame takes few enough packets; not all cards and cameras reach 9000."""
LARGEST_PACKET_BYTES = 16000
"""What `transport.packet_size_bytes` allows; the MTU of lo is larger than any camera can use."""
_RAISE_SOCKET_BUFFER = (
    f"echo net.core.rmem_max={SOCKET_BUFFER_BYTES} | sudo tee /etc/sysctl.d/60-autoexpose.conf && sudo sysctl --system"
)


def judge_gige(gige: GigeFacts, need: Need) -> Iterator[Diagnosis]:
    """Findings on the GigE Vision cameras."""
    for interface, reason in gige.failures.items():
        sentence = f"{interface} could not be searched for GigE Vision cameras: {reason}"
        yield Diagnosis("gige-search", "warning", sentence, f"ip address show dev {interface}")
    wanted = []
    for camera in gige.cameras:
        name = f"{need.name(camera.serial)} ({camera.vendor} {camera.model})"
        where = f"{camera.address.ip} on {camera.interface.name}"
        if not need.wants(camera.serial):
            yield Diagnosis("gige-camera", "ok", f"{name} is present at {where}; the configuration does not name it")
        elif not camera.reachable:
            yield _foreign(camera, name)
        else:
            yield _judge_control(gige.control[camera.address], f"{name} at {where}", camera)
            if need.ptp:
                yield _judge_ptp(gige.ptp.get(camera.address), name)
            if (packet_bytes := gige.packet_bytes.get(camera.address, 0)) > camera.interface.mtu_bytes:
                yield _fragmented(camera.interface, name, packet_bytes)
            wanted.append(camera)
    wanted.sort(key=lambda camera: camera.interface.name)
    for interface, group in groupby(wanted, key=lambda camera: camera.interface):
        sharing = list(group)
        mbps = need.link_mbps or interface.speed_mbps
        yield _judge_packets(interface, sharing, need)
        serials, fix = [camera.serial for camera in sharing], f"ethtool {interface.name}   # shows the link's speed; "
        packet_bytes = need.packet_size_bytes or min(interface.mtu_bytes, LARGEST_PACKET_BYTES)
        needed = need.bytes_per_s(serials, packet_bytes)
        available = None if mbps is None else bytes_per_s(mbps, 1)
        fix += "give each camera an interface, or lower trigger.rate_hz"
        enough = _judge_bandwidth(
            "gige-bandwidth", interface.name, serials, need, needed=needed, available=available, fix=fix
        )
        yield enough
        if need.plan and mbps is not None and enough.severity == "ok":
            yield from _judge_shares(interface, mbps, serials, packet_bytes, need)
        if len(sharing) > 1 and mbps is not None:
            yield _judge_bursts(interface, mbps, sharing, need)
        if gige.no_filter is not None:
            yield _unfiltered(interface, sharing, gige.no_filter)
    yield _judge_socket_buffer(gige.largest_socket_buffer_bytes, bool(wanted))


def _foreign(camera: GigeCamera, name: str) -> Diagnosis:
    interface = camera.interface
    subnets = " and ".join(str(own.network) for own in interface.addresses)
    return Diagnosis(
        "gige-subnet",
        "stops",
        f"{name} has the address {camera.address.ip}, outside the subnet{'s' * (len(interface.addresses) > 1)} "
        f"{subnets} of {interface.name}: it can be discovered but not reached",
        f"sudo ip address add {_neighbour(camera.address)} dev {interface.name}"
        "   # or give the camera an address of this subnet",
    )


def _neighbour(address: IPv4Interface) -> IPv4Interface:
    """Another address in the camera's subnet; if that is not sensible, one of its 256 neighbours."""
    sensible = 1 <= address.network.prefixlen <= 30
    network = address.network if sensible else IPv4Interface(f"{address.ip}/24").network
    host = next(host for host in network.hosts() if host != address.ip)
    return IPv4Interface(f"{host}/{network.prefixlen}")


def _judge_control(control: Control, name: str, camera: GigeCamera) -> Diagnosis:
    if control == "silent":
        sentence = f"{name} answers discovery, but not direct requests: a firewall, or a duplicate address"
        fix = f"ping -c 3 {camera.address.ip}; sudo nft list ruleset"
        return Diagnosis("gige-control", "stops", sentence, fix)
    if control == "held":
        sentence = f"{name} is controlled by another program; a killed program keeps control for some seconds"
        fix = "sudo ss -uanp   # lists the programs of this host that use UDP: close the one with the camera"
        return Diagnosis("gige-control", "stops", sentence, fix)
    return Diagnosis("gige-control", "ok", f"{name} answers and is free")


def _judge_ptp(status: str | None, name: str) -> Diagnosis:
    match status:
        case "Slave" | "Master":
            return Diagnosis("ptp", "ok", f"{name} follows a PTP clock (PtpStatus {status})")
        case "Disabled":
            return Diagnosis("ptp", "ok", f"{name} has its PTP clock off; the daemon switches it on")
        case None:
            sentence = f"{name} does not show the state of a PTP clock (register 0x096C)"
            fix = "autoexpose config check --camera rig.yaml   # says whether it can be driven"
            return Diagnosis("ptp", "warning", sentence, fix)
    sentence = f"{name} follows no PTP master (PtpStatus {status})"
    fix = "sudo ptp4l -i eth0 -m -S   # makes this computer one, on the cameras' interface: docs/do/triggering.md"
    return Diagnosis("ptp", "warning", sentence, fix)


def _judge_packets(interface: NetworkInterface, cameras: Sequence[GigeCamera], need: Need) -> Diagnosis:
    name, mtu_bytes, packet_bytes = interface.name, interface.mtu_bytes, need.packet_size_bytes
    if packet_bytes is not None and packet_bytes > mtu_bytes:
        sentence = f"transport.packet_size_bytes {packet_bytes} exceeds the MTU of {name}, {mtu_bytes} bytes"
        fix = f"sudo ip link set dev {name} mtu {packet_bytes}   # or lower transport.packet_size_bytes"
        return Diagnosis("gige-packets", "stops", sentence, fix)
    packets = packets_of(max(need.frame_bytes(camera.serial) for camera in cameras), packet_bytes or mtu_bytes)
    sentence = f"{name} has an MTU of {mtu_bytes} bytes"
    if packet_bytes is not None:
        return Diagnosis("gige-packets", "ok", f"{sentence}; the configuration asks for {packet_bytes}")
    if mtu_bytes >= JUMBO_BYTES:
        return Diagnosis("gige-packets", "ok", sentence)
    return Diagnosis(
        "gige-packets",
        "warning",
        f"{sentence}: a frame takes {packets} packets, any of which may be lost; with jumbo frames it takes a sixth",
        f"sudo ip link set dev {name} mtu 9000   # if card, switch and camera allow it",
    )


def _fragmented(interface: NetworkInterface, name: str, packet_bytes: int) -> Diagnosis:
    return Diagnosis(
        "gige-packets",
        "warning",
        f"{name} streams packets of {packet_bytes} bytes at present, more than the MTU of {interface.name}, "
        f"{interface.mtu_bytes} bytes: each travels in fragments, and is lost with any of them",
        f"sudo ip link set dev {interface.name} mtu {packet_bytes}   "
        f"# or transport.packet_size_bytes: {interface.mtu_bytes} in the configuration",
    )


def _judge_shares(
    interface: NetworkInterface, speed_mbps: float, serials: Sequence[str | None], packet_bytes: int, need: Need
) -> Iterator[Diagnosis]:
    """What the daemon refuses, though the link would carry it: cameras on other links may be charged to this one."""
    for serial in serials:
        share = bytes_per_s(speed_mbps, shares := need.planned_shares(serial))
        if (needed := need.bytes_per_s([serial], packet_bytes)) > share:
            yield Diagnosis(
                "gige-bandwidth",
                "warning",
                f"{need.name(serial)} needs {needed / 1e6:.0f} MB/s ({need.in_words([serial])}), and transport.plan "
                f"allows it {share / 1e6:.0f} MB/s of {interface.name}, its share among {shares} cameras: the "
                "daemon refuses that",
                "link: second   # with the cameras of other links, each link a name; or lower trigger.rate_hz",
            )


def _judge_bursts(
    interface: NetworkInterface, speed_mbps: float, cameras: Sequence[GigeCamera], need: Need
) -> Diagnosis:
    names = need.names([camera.serial for camera in cameras])
    share = bytes_per_s(speed_mbps, len(cameras)) / 1e6
    if need.plan and sum(1 / need.planned_shares(camera.serial) for camera in cameras) <= 1:
        return Diagnosis("gige-bursts", "ok", f"{names} each send at most their share of {interface.name}")
    if need.plan:
        return Diagnosis(
            "gige-bursts",
            "warning",
            f"{names} share {interface.name}, and the configuration gives them different links: together they may send "
            "more than it takes",
            "link: one   # with each of them, the same name",
        )
    return Diagnosis(
        "gige-bursts",
        "warning",
        f"{names} send to {interface.name} at the same instant, each as fast as its own cable allows: a switch with "
        "little memory drops packets",
        f"transport.plan: true   # in the configuration: each camera then sends at most {share:.0f} MB/s",
    )


def _unfiltered(interface: NetworkInterface, cameras: Sequence[GigeCamera], reason: str) -> Diagnosis:
    addresses = ", ".join(str(camera.address.ip) for camera in cameras)
    stranger = f'iifname "{interface.name}" meta l4proto udp ip saddr != {{ {addresses} }}'
    return Diagnosis(
        "stream-filter",
        "warning",
        f"the streams on {interface.name} accept packets from anyone, some of which crash the daemon: "
        f"a socket filter is refused: {reason}",
        "sudo nft 'add table inet autoexpose; "
        "add chain inet autoexpose input { type filter hook input priority 0 ; }; "
        f"add rule inet autoexpose input {stranger} drop'   # docs/understand/hostile-packets.md",
    )


def _judge_socket_buffer(largest_bytes: int | None, used: bool) -> Diagnosis:
    if largest_bytes is None:
        sentence = "net.core.rmem_max, the limit on socket buffers, cannot be read"
    else:
        sentence = f"net.core.rmem_max allows socket buffers of {largest_bytes} bytes"
        if largest_bytes >= SOCKET_BUFFER_BYTES:
            return Diagnosis("socket-buffer", "ok", sentence)
        sentence += f", less than the {SOCKET_BUFFER_BYTES} that a camera's stream asks for"
    so = ": packets get lost when the machine is busy"
    return _if_used("socket-buffer", sentence, used, "GigE", so=so, fix=_RAISE_SOCKET_BUFFER)
