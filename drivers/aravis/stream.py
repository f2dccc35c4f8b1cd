"""The stream of frames of an opened camera: its packets, its buffers, and its share of the link."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from drivers.aravis.nodes import Aravis, AravisNodes
from drivers.camera import RefusedPackets
from drivers.genicam.nodes import hold, is_number, offered
from drivers.host.network import (
    SOCKET_BUFFER_BYTES,
    addresses_of,
    bytes_per_s,
    interface_with,
    needed_bytes_per_s,
    packet_delay_ns,
    packets_of,
)
from drivers.host.stream_filter import StreamFilter, largest_packet_id
from drivers.setup import CameraSetup, LinkShare
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError

log = logging.getLogger(__name__)

_LIMIT, _LIMIT_MODE = "DeviceLinkThroughputLimit", "DeviceLinkThroughputLimitMode"

BUFFERS = 16
"""A quarter of a second at 60 Hz: longer than any pause of the reading thread that is worth surviving."""
PACKET_TIMEOUT_US = 2_000
"""A packet this late is requested again. With Aravis' default of 20 ms one lost packet delays its frame, and the next
ones, by two periods at 60 Hz."""
DROPPED_FRAMES = 3
"""The packets of so many, without a frame between them, are no remains of one that a busy host gave up."""
FRAME_RETENTION_US = 50_000
"""A GigE Vision frame incomplete this long after its last packet is given up; frames behind it wait until then."""


class FrameStream:
    """The buffers of a camera as they fill, and what keeps others out of them, where the transport needs that."""

    def __init__(self, serial: str, stream: Any, guard: StreamFilter | None, frame_packets: int) -> None:
        self._serial = serial
        self._stream = stream
        self._guard = guard
        self._frame_packets = frame_packets
        self._ignored = 0  # packets that Aravis ignored up to the last buffer
        self._said = False

    @contextmanager
    def next_buffer(self, timeout_s: float) -> Iterator[Any]:
        """The next buffer, which is given back when the block ends; None if none comes in time."""
        buffer = self._stream.timeout_pop_buffer(int(timeout_s * 1e6))
        ignored = self._ignored_packets()
        if buffer is None:
            self._warn_of_dropped_frames(ignored)
            yield None
            return
        self._ignored = ignored
        try:
            yield buffer
        finally:
            buffer.set_timestamp(0)  # still 0 if the next frame in this buffer arrives without its leader
            self._stream.push_buffer(buffer)

    def refused(self) -> RefusedPackets | None:
        """What was sent to it since the last call and looked foreign; None: nothing."""
        return None if self._guard is None else self._guard.refused()

    def close(self) -> None:
        """Free the stream, whose thread must end while the device still exists."""
        if self._guard is not None:
            self._guard.close()
        self._stream = None

    def _ignored_packets(self) -> int:
        if not isinstance(self._stream, Aravis.GvStream):
            return 0
        return int(self._stream.get_info_uint64_by_name("n_ignored_packets"))

    def _warn_of_dropped_frames(self, ignored: int) -> None:
        """Aravis drops whole frames of a GigE Vision camera whose numbers stand still or begin again.

        It takes a number up to 100 below the last one for that of a frame which is late.
        """
        if not self._said and ignored - self._ignored > DROPPED_FRAMES * self._frame_packets:
            self._said = True
            log.warning(
                "camera %s: its frames arrive, but Aravis drops them, since their numbers (block ids) do not go on "
                "from the last frame's: unless this machine was held up for a while, the camera is at fault",
                self._serial,
            )


def create_stream(nodes: AravisNodes, setup: CameraSetup) -> FrameStream:
    """Create the stream and its buffers.

    Chunks and format must be set before, as they decide the payload size. Raises UnsupportedCameraError when the camera
    does not say how large a frame is; ConfigurationError when its share of a link is not known, or is too small.
    """
    if not is_number(nodes, "PayloadSize", "integer"):
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has no PayloadSize, and so does not say how many bytes a frame has"
        )
    is_gige = nodes.camera.is_gv_device()
    if is_gige:
        # The kernel serves packet sockets in 5 ms blocks; a plain socket is quicker.
        nodes.camera.gv_set_stream_options(Aravis.GvStreamOption.PACKET_SOCKET_DISABLED)
        if setup.packet_size_bytes is None:
            nodes.call("find the packet size", nodes.camera.gv_auto_packet_size)
        else:
            nodes.call("set the packet size", nodes.camera.gv_set_packet_size, setup.packet_size_bytes)
    stream = nodes.call("open the stream", nodes.camera.create_stream, None, None)
    payload_bytes = nodes.call("read the payload size", nodes.camera.get_payload)
    guard, frame_packets = None, 1
    if is_gige:
        if setup.link_share is not None:
            keep_to_share(nodes, setup.link_share, payload_bytes, setup.trigger.rate_hz)
        stream.set_property("socket-buffer", Aravis.GvStreamSocketBuffer.FIXED)
        stream.set_property("socket-buffer-size", SOCKET_BUFFER_BYTES)
        stream.set_property("packet-timeout", PACKET_TIMEOUT_US)
        stream.set_property("frame-retention", FRAME_RETENTION_US)
        packet_bytes = nodes.call("read the packet size", nodes.camera.gv_get_packet_size)
        frame_packets = packets_of(payload_bytes, packet_bytes)
        _compare_with_mtu(nodes, packet_bytes)
        # While there are no buffers, Aravis ignores packets.
        guard = _guard(nodes, stream.get_port(), largest_packet_id(payload_bytes, packet_bytes))
    for _ in range(BUFFERS):
        stream.push_buffer(Aravis.Buffer.new_allocate(payload_bytes))
    return FrameStream(nodes.serial, stream, guard, frame_packets)


def keep_to_share(nodes: AravisNodes, share: LinkShare, payload_bytes: int, rate_hz: float | None) -> None:
    """Limit what a camera sends by its own throughput limit, or else by a pause after each packet.

    Its packet size must be set; it sends frames of `payload_bytes`, as many as it can take if `rate_hz` is None. Raises
    ConfigurationError when the speed of the link is not known, or frames at this rate do not fit.
    """
    mbps = share.mbps or _interface_mbps(nodes)
    packet_bytes = nodes.call("read the packet size", nodes.camera.gv_get_packet_size)
    needed, allowed = needed_bytes_per_s(payload_bytes, packet_bytes, rate_hz or 0.0), bytes_per_s(mbps, share.cameras)
    if needed > allowed:
        raise ConfigurationError(
            f"transport.plan: camera {nodes.serial} sends {needed / 1e6:.1f} MB/s at {rate_hz:g} Hz, and its share of "
            f"a link of {mbps:g} Mb/s is {allowed / 1e6:.1f} MB/s: lower trigger.rate_hz, choose binning or a smaller "
            "pixel format; where each camera has a link of its own, leave out transport.plan"
        )
    if "On" in offered(nodes, _LIMIT_MODE):
        hold(nodes, _LIMIT_MODE, "On")
    if is_number(nodes, _LIMIT, "integer") and nodes.writable(_LIMIT):
        least, most = map(int, nodes.bounds(_LIMIT))
        if least > allowed:
            raise ConfigurationError(
                f"transport.plan: camera {nodes.serial} sends at least {least / 1e6:.1f} MB/s, and its share of a link "
                f"of {mbps:g} Mb/s is {allowed / 1e6:.1f} MB/s: give each camera a link of its own"
            )
        step = max(int(nodes.increment(_LIMIT)), 1)
        hold(nodes, _LIMIT, min(least + (int(allowed) - least) // step * step, most))
        how = f"{_LIMIT} {nodes.read(_LIMIT)} B/s"
    else:
        delay_ns = packet_delay_ns(packet_bytes, allowed, own_bytes_per_s(nodes))
        nodes.call("set the packet delay", nodes.camera.gv_set_packet_delay, delay_ns)
        how = f"a packet delay of {delay_ns} ns"
    log.info(
        "camera %s needs %.1f MB/s and may send %.1f MB/s of a link of %g Mb/s: %s",
        nodes.serial, needed / 1e6, allowed / 1e6, mbps, how,
    )  # fmt: skip


def _interface_mbps(nodes: AravisNodes) -> float:
    address = _ip(nodes.device.get_interface_address())
    interface = interface_with(address)
    if interface is not None and interface.speed_mbps is not None:
        return interface.speed_mbps
    raise ConfigurationError(
        f"transport.plan: the speed of the link to camera {nodes.serial} at {address} is not known: give "
        "transport.link_mbps"
    )


def own_bytes_per_s(nodes: AravisNodes) -> float | None:
    """How fast the camera's own cable is, according to the standard's nodes; None: they do not say."""
    for name, unit in (("DeviceLinkSpeed", 1.0), ("GevLinkSpeed", 1e6 / 8)):
        if is_number(nodes, name) and (speed := float(nodes.read(name))) > 0:
            return speed * unit
    return None


def _compare_with_mtu(nodes: AravisNodes, packet_bytes: int) -> None:
    interface = interface_with(_ip(nodes.device.get_interface_address()))
    if interface is not None and packet_bytes > interface.mtu_bytes:
        log.warning(
            "camera %s: its packets of %d bytes exceed the MTU of %s, %d bytes: each travels in fragments, and is lost "
            "with any of them: `sudo ip link set dev %s mtu %d`, or transport.packet_size_bytes: %d",
            nodes.serial, packet_bytes, interface.name, interface.mtu_bytes,
            interface.name, packet_bytes, interface.mtu_bytes,
        )  # fmt: skip


def _guard(nodes: AravisNodes, port: int, largest_id: int) -> StreamFilter | None:
    discovered = _ip(nodes.device.get_device_address())
    listening = _ip(nodes.device.get_interface_address()), port
    addresses = sorted({discovered, *addresses_of(discovered)})
    if len(addresses) > 1:
        log.info("camera %s: frames are taken from %s", nodes.serial, " and ".join(addresses))
    try:
        return StreamFilter(addresses, _source_port(nodes), largest_id, listening)
    except OSError as error:
        log.warning(
            "camera %s: its stream takes packets from anyone, as no filter could be attached: %s; "
            "keep strangers off its network: docs/understand/hostile-packets.md",
            nodes.serial,
            error.strerror or error,
        )
        return None


def _ip(address: Any) -> str:
    return str(address.get_address().to_string())


def _source_port(nodes: AravisNodes) -> int:
    """The port that the stream is sent from; 0 if the camera does not say."""
    try:
        return int(nodes.read("GevSCSP"))
    except NodeError:
        return 0
