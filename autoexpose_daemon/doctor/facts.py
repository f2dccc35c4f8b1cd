"""The facts that the doctor judges."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from ipaddress import IPv4Interface
from pathlib import Path

from drivers.host import stream_filter
from drivers.host.network import (
    Control,
    GigeCamera,
    control_of,
    find_interfaces,
    largest_socket_buffer_bytes,
    ptp_status_of,
    search,
    streamed_packet_bytes,
)
from drivers.host.usb import UsbFacts, find_usb


@dataclass(frozen=True, slots=True)
class GigeFacts:
    """GigE Vision cameras and what the host's network offers them.

    `control` and `ptp`, the state of its PTP clock, are known for reachable cameras, `packet_bytes` for those that
    stream at present; `failures` says why an interface could not be searched, `no_filter` why a stream cannot be
    protected from other senders' packets.
    """

    cameras: tuple[GigeCamera, ...] = ()
    control: Mapping[IPv4Interface, Control] = field(default_factory=dict)
    ptp: Mapping[IPv4Interface, str | None] = field(default_factory=dict)
    packet_bytes: Mapping[IPv4Interface, int] = field(default_factory=dict)
    failures: Mapping[str, str] = field(default_factory=dict)
    largest_socket_buffer_bytes: int | None = None
    no_filter: str | None = None


@dataclass(frozen=True, slots=True)
class Facts:
    """All facts that were found."""

    usb: UsbFacts
    gige: GigeFacts

    @property
    def serials(self) -> list[str]:
        """Serial numbers of the cameras found, where known."""
        found = [*(camera.serial for camera in self.usb.cameras), *(camera.serial for camera in self.gige.cameras)]
        return sorted({serial for serial in found if serial is not None})


def gather(root: Path = Path("/"), wanted: Collection[str] = ()) -> Facts:
    """Gather the facts of the host, in about a second; files are read below `root`.

    It takes three seconds if a GigE Vision camera of the `wanted` serial numbers is not found.
    """
    usb = find_usb(root)
    found = search(find_interfaces(), wanted=set(wanted) - {camera.serial for camera in usb.cameras})
    reachable = [camera.address for camera in found.cameras if camera.reachable]
    return Facts(
        usb=usb,
        gige=GigeFacts(
            cameras=found.cameras,
            control={address: control_of(str(address.ip)) for address in reachable},
            ptp={address: ptp_status_of(str(address.ip)) for address in reachable},
            packet_bytes={
                address: size for address in reachable if (size := streamed_packet_bytes(str(address.ip))) is not None
            },
            failures=found.failures,
            largest_socket_buffer_bytes=largest_socket_buffer_bytes(root),
            no_filter=stream_filter.why_not(),
        ),
    )
