"""The stream of frames of an opened camera: its packets, its buffers, and its share of the link."""

from __future__ import annotations

import logging
from typing import Any

from drivers.aravis.introspection import Aravis
from drivers.aravis.nodes import AravisNodes
from drivers.genicam.link_share import bytes_per_s, needed_bytes_per_s, packet_delay_ns
from drivers.genicam.nodes import hold, offered
from drivers.host.network import SOCKET_BUFFER_BYTES, addresses_of, interface_with
from drivers.host.stream_filter import StreamFilter, largest_packet_id
from drivers.setup import CameraSetup, LinkShare
from imaging.errors import CameraLostError, ConfigurationError, NodeError, UnsupportedCameraError

log = logging.getLogger(__name__)

_LIMIT, _LIMIT_MODE = "DeviceLinkThroughputLimit", "DeviceLinkThroughputLimitMode"


def keep_to_share(camera: Any, nodes: AravisNodes, share: LinkShare, payload_bytes: int, rate_hz: float | None) -> None:
    """Limit what a camera sends by its own throughput limit, or else by a pause after each packet.

    Parameters
    ----------
    camera
        Aravis' camera, with its packet size set.
    payload_bytes
        Size of a frame.
    rate_hz
        Frames per second; None: as many as it can take.

    Raises
    ------
    ConfigurationError
        When the speed of the link is not known, or frames at this rate do not fit.
    """
    mbps = share.mbps or _interface_mbps(camera, nodes.serial)
    packet_bytes = nodes.call("read the packet size", camera.gv_get_packet_size)
    needed, allowed = needed_bytes_per_s(payload_bytes, packet_bytes, rate_hz or 0.0), bytes_per_s(mbps, share.cameras)
    if needed > allowed:
        raise ConfigurationError(
            f"transport.plan: camera {nodes.serial} sends {needed / 1e6:.1f} MB/s at {rate_hz:g} Hz, and its share of "
            f"a link of {mbps:g} Mb/s is {allowed / 1e6:.1f} MB/s: lower trigger.rate_hz, choose binning or a smaller "
            "pixel format; where each camera has a link of its own, leave out transport.plan"
        )
    if "On" in offered(nodes, _LIMIT_MODE):
        hold(nodes, _LIMIT_MODE, "On")
    if nodes.is_integer(_LIMIT) and nodes.writable(_LIMIT):
        least, most = nodes.integer_bounds(_LIMIT)
        if least > allowed:
            raise ConfigurationError(
                f"transport.plan: camera {nodes.serial} sends at least {least / 1e6:.1f} MB/s, and its share of a link "
                f"of {mbps:g} Mb/s is {allowed / 1e6:.1f} MB/s: give each camera a link of its own"
            )
        step = max(nodes.integer_increment(_LIMIT), 1)
        hold(nodes, _LIMIT, min(least + (int(allowed) - least) // step * step, most))
        how = f"{_LIMIT} {nodes.read_integer(_LIMIT)} B/s"
    else:
        delay_ns = packet_delay_ns(packet_bytes, allowed, _own_bytes_per_s(nodes))
        nodes.call("set the packet delay", camera.gv_set_packet_delay, delay_ns)
        how = f"a packet delay of {delay_ns} ns"
    log.info(
        "camera %s needs %.1f MB/s and may send %.1f MB/s of a link of %g Mb/s: %s",
        nodes.serial, needed / 1e6, allowed / 1e6, mbps, how,
    )  # fmt: skip


def _interface_mbps(camera: Any, serial: str) -> float:
    address = str(camera.get_device().get_interface_address().get_address().to_string())
    interface = interface_with(address)
    if interface is not None and interface.speed_mbps is not None:
        return interface.speed_mbps
    raise ConfigurationError(
        f"transport.plan: the speed of the link to camera {serial} at {address} is not known: give transport.link_mbps"
    )


def _own_bytes_per_s(nodes: AravisNodes) -> float | None:
    """How fast the camera's own cable is, according to the standard's nodes; None: they do not say."""
    for name, unit in (("DeviceLinkSpeed", 1.0), ("GevLinkSpeed", 1e6 / 8)):
        if nodes.available(name):
            speed = nodes.read_float(name) if nodes.is_float(name) else nodes.read_integer(name)
            if speed > 0:
                return speed * unit
    return None


BUFFERS = 16
"""A quarter of a second at 60 Hz: longer than any pause of the reading thread that is worth surviving."""
PACKET_TIMEOUT_US = 2_000
"""A packet this late is requested again. With Aravis' default of 20 ms one lost packet delays its frame, and the next
ones, by two periods at 60 Hz."""
DROPPED_PACKETS = 50
"""As many in a row, without a frame, are no remains of resending."""
FRAME_RETENTION_US = 50_000
"""A GigE Vision frame incomplete this long after its last packet is given up; frames behind it wait until then."""


def create_stream(camera: Any, nodes: AravisNodes, setup: CameraSetup) -> tuple[Any, StreamFilter | None]:
    """Create the stream and its buffers, and what keeps others out of it, where the transport needs that.

    Chunks and format must be set before, as they decide the payload size.
    """
    if not nodes.is_integer("PayloadSize"):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has no PayloadSize, and so does not say how many bytes a frame has"
        )
    guard = None
    if camera.is_gv_device():
        # The kernel serves packet sockets in 5 ms blocks; a plain socket is quicker.
        camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        if setup.packet_size_bytes is None:
            nodes.call("find the packet size", camera.gv_auto_packet_size)
        else:
            nodes.call("set the packet size", camera.gv_set_packet_size, setup.packet_size_bytes)
    stream = nodes.call("open the stream", camera.create_stream, None, None)
    payload_bytes = nodes.call("read the payload size", camera.get_payload)
    if camera.is_gv_device():
        if setup.link_share is not None:
            keep_to_share(camera, nodes, setup.link_share, payload_bytes, setup.trigger.rate_hz)
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", SOCKET_BUFFER_BYTES)
        stream.set_property("packet-timeout", PACKET_TIMEOUT_US)
        stream.set_property("frame-retention", FRAME_RETENTION_US)
        packet_bytes = nodes.call("read the packet size", camera.gv_get_packet_size)
        _compare_with_mtu(camera, nodes.serial, packet_bytes)
        # While there are no buffers, Aravis ignores packets.
        guard = _guard(stream, camera, nodes, largest_packet_id(payload_bytes, packet_bytes))
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(payload_bytes))
    return stream, guard


def row_padding_bytes(buffer: Any) -> int:
    """By how many bytes a frame says its rows are padded; 0 with Aravis 0.8.20, which does not pass that on."""
    return int(buffer.get_image_padding()[0]) if hasattr(buffer, "get_image_padding") else 0


class DroppedFrames:
    """Notices that Aravis drops whole frames of a GigE Vision camera, whose numbers stand still or begin again.

    It takes a number up to 100 below the last one for that of a frame which is late.
    """

    def __init__(self, serial: str) -> None:
        self._serial = serial
        self._ignored = 0
        self._said = False

    def arrived(self, stream: Any) -> None:
        """A frame has come through."""
        self._ignored = _ignored_packets(stream)

    def waited(self, stream: Any) -> None:
        """None did for a while."""
        if not self._said and _ignored_packets(stream) - self._ignored > DROPPED_PACKETS:
            self._said = True
            log.warning(
                "camera %s: its frames arrive, but Aravis drops them, since their numbers (block ids) do not go on "
                "from the last frame's: the camera is at fault",
                self._serial,
            )


def _ignored_packets(stream: Any) -> int:
    if not isinstance(stream, Aravis.GvStream):
        return 0
    return int(stream.get_info_uint64_by_name("n_ignored_packets"))


def _compare_with_mtu(camera: Any, serial: str, packet_bytes: int) -> None:
    interface = interface_with(_ip(camera.get_device().get_interface_address()))
    if interface is not None and packet_bytes > interface.mtu_bytes:
        log.warning(
            "camera %s: its packets of %d bytes exceed the MTU of %s, %d bytes: each travels in fragments, and is lost "
            "with any of them: `sudo ip link set dev %s mtu %d`, or transport.packet_size_bytes: %d",
            serial, packet_bytes, interface.name, interface.mtu_bytes,
            interface.name, packet_bytes, interface.mtu_bytes,
        )  # fmt: skip


def _guard(stream: Any, camera: Any, nodes: AravisNodes, largest_id: int) -> StreamFilter | None:
    device = camera.get_device()
    discovered = _ip(device.get_device_address())
    listening = _ip(device.get_interface_address()), stream.get_port()
    addresses = sorted({discovered, *addresses_of(discovered)})
    if len(addresses) > 1:
        log.info("camera %s: frames are taken from %s", nodes.serial, " and ".join(addresses))
    try:
        return StreamFilter(addresses, _source_port(nodes), largest_id, listening)
    except OSError as error:
        log.warning(
            "camera %s: its stream takes packets from anyone, as no filter could be attached: %s; "
            "keep strangers off its network: docs/hostile-packets.md",
            nodes.serial,
            error.strerror or error,
        )
        return None


def _ip(address: Any) -> str:
    return str(address.get_address().to_string())


def _source_port(nodes: AravisNodes) -> int:
    """The port that the stream is sent from; 0 if the camera does not say."""
    try:
        return nodes.read_integer("GevSCSP")
    except CameraLostError:
        raise
    except NodeError:
        return 0
