"""Having a GigE Vision camera send no faster than its share of the link to the host."""

from __future__ import annotations

import logging
from typing import Any

from drivers.aravis.nodes import AravisNodes
from drivers.genicam.hold import hold, offered
from drivers.genicam.link_share import bytes_per_s, needed_bytes_per_s, packet_delay_ns
from drivers.host.network import interface_with
from drivers.setup import LinkShare
from imaging.errors import ConfigurationError

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
