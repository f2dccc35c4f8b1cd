"""How fast each of several cameras may send over one link, so that nothing before it overflows.

Hardware triggers make cameras send at the same instant, each as fast as its own cable allows. A switch keeps what the
common cable to the host cannot take at once, in a buffer that holds less than a frame, and drops the rest.
"""

from __future__ import annotations

import math

USABLE_SHARE = 0.9
"""Share of a GigE Vision link: the rest is for packets that are sent again, and for other traffic."""

USB3_MBPS = 5000
"""The speed of SuperSpeed."""

USB3_USABLE_SHARE = 0.64
"""Share left by line coding and protocol: about 400 of SuperSpeed's 625 MB/s, 40 of the 60 MB/s of USB 2."""

_HEADERS_BYTES = 36
"""Headers of IP, UDP and GVSP, which count as part of a packet's size."""

_FRAMING_BYTES = 38
"""What Ethernet adds: preamble, header, checksum and gap."""


def bytes_per_s(mbps: float, cameras: int) -> float:
    """What each of this many cameras may send over a GigE Vision link of this many megabits per second."""
    return USABLE_SHARE * mbps * 1e6 / 8 / cameras


def usb_bytes_per_s(mbps: float, cameras: int) -> float:
    """What each of this many cameras can send over a bus of this many megabits per second."""
    return USB3_USABLE_SHARE * mbps * 1e6 / 8 / cameras


def packet_delay_ns(packet_bytes: int, share_bytes_per_s: float, own_bytes_per_s: float | None) -> int:
    """How long a camera has to pause after each packet to keep to its share.

    Parameters
    ----------
    packet_bytes
        Size of a stream packet, headers included.
    share_bytes_per_s
        What the camera may send.
    own_bytes_per_s
        How fast it sends a packet by itself; None: unknown, then no time is allowed for it.
    """
    on_the_wire = packet_bytes + _FRAMING_BYTES
    sending_s = 0.0 if own_bytes_per_s is None else on_the_wire / own_bytes_per_s
    return max(math.ceil(1e9 * (on_the_wire / share_bytes_per_s - sending_s)), 0)


def packets_of(frame_bytes: int, packet_bytes: int) -> int:
    """How many stream packets of a size, headers included, carry a frame."""
    return math.ceil(frame_bytes / (packet_bytes - _HEADERS_BYTES))


def needed_bytes_per_s(frame_bytes: int, packet_bytes: int, rate_hz: float) -> float:
    """What a camera sends on average, with the headers of its packets."""
    return rate_hz * (frame_bytes + packets_of(frame_bytes, packet_bytes) * (_HEADERS_BYTES + _FRAMING_BYTES))
