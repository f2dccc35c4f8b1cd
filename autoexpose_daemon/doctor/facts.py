"""What the host offers, what the daemon will need of it, and what the doctor reports."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from ipaddress import IPv4Interface
from pathlib import Path
from typing import Literal

from autoexpose_daemon.config.document import Config, TriggerConfig
from drivers.host import stream_filter
from drivers.host.network import (
    Control,
    GigeCamera,
    control_of,
    find_interfaces,
    largest_socket_buffer_bytes,
    needed_bytes_per_s,
    ptp_status_of,
    search,
    streamed_packet_bytes,
)
from drivers.host.usb import UsbFacts, find_usb
from drivers.setup import FeatureSetting
from imaging.frames import CameraName
from imaging.pixels import PixelFormat
from imaging.python310 import Self


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


Severity = Literal["ok", "warning", "stops"]
"""`stops`: the daemon would not run; `warning`: it would run, and may lose frames or fail for another user."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """One finding in a sentence; `check` names what was checked, `fix` is the command that fixes it."""

    check: str
    severity: Severity
    sentence: str
    fix: str | None = None


ASSUMED_WIDTH, ASSUMED_HEIGHT = 720, 540
"""A sensor's size is known only once a camera is open; this is the size of those this project is made for."""


@dataclass(frozen=True, slots=True)
class Size:
    """Width and height of a camera's frames, and whether the configuration says so."""

    width: int = ASSUMED_WIDTH
    height: int = ASSUMED_HEIGHT
    known: bool = False

    @classmethod
    def of(cls, features: Sequence[FeatureSetting], binning: int) -> Self:
        """The size that `features:` set; a region in them is in pixels after binning and decimation."""
        last = {feature.name: feature.value for feature in features if not feature.selectors}

        def shrunk(assumed: int, direction: str) -> int:
            factors = [_number(last.get(f"{way}{direction}")) or 1 for way in ("Binning", "Decimation")]
            return assumed // (binning * math.prod(factors))

        width, height = _number(last.get("Width")), _number(last.get("Height"))
        known = width is not None and height is not None
        return cls(width or shrunk(ASSUMED_WIDTH, "Horizontal"), height or shrunk(ASSUMED_HEIGHT, "Vertical"), known)


@dataclass(frozen=True, slots=True)
class Need:
    """Cameras, rate and frames; without `serials` every camera found is needed.

    `sizes` and `links` are by serial number; a camera without one has the assumed size, and shares the common link.
    """

    serials: Mapping[CameraName, str] = field(default_factory=dict)
    rate_hz: float = TriggerConfig().rate_hz
    sizes: Mapping[str, Size] = field(default_factory=dict)
    links: Mapping[str, str | None] = field(default_factory=dict)
    pixel_format: PixelFormat = PixelFormat.MONO8
    packet_size_bytes: int | None = None
    plan: bool = False
    link_mbps: float | None = None
    ptp: bool = False

    @classmethod
    def of(cls, config: Config | None) -> Self:
        """What a configuration needs."""
        if config is None:
            return cls()
        binning = config.image.binning or 1
        return cls(
            serials={name: camera.serial for name, camera in config.cameras.items()},
            rate_hz=config.trigger.rate_hz,
            sizes={camera.serial: Size.of(camera.features, binning) for camera in config.cameras.values()},
            links={camera.serial: camera.link for camera in config.cameras.values()},
            pixel_format=config.image.pixel_format or PixelFormat.MONO8,
            packet_size_bytes=config.transport.packet_size_bytes,
            plan=config.transport.plan,
            link_mbps=config.transport.link_mbps,
            ptp=config.trigger.mode == "ptp",
        )

    def frame_bytes(self, serial: str | None) -> int:
        """Size of one frame of a camera."""
        size = self._size(serial)
        return self.pixel_format.image_bytes(size.width, size.height)

    def in_words(self, serials: Sequence[str | None]) -> str:
        """The frames behind `bytes_per_s`, and whether their size is an assumption."""
        sizes = dict.fromkeys(self._size(serial) for serial in serials)
        assumed = "" if all(size.known for size in sizes) else "assuming "
        pixels = " and ".join(f"{size.width}x{size.height}" for size in sizes)
        return f"{assumed}{pixels} pixels of {self.pixel_format.bits_per_pixel} bits at {self.rate_hz:g} Hz"

    def bytes_per_s(self, serials: Sequence[str | None], packet_bytes: int | None = None) -> float:
        """What these cameras send, with the headers of packets of the given size (GigE Vision)."""
        frames = [self.frame_bytes(serial) for serial in serials]
        if packet_bytes is None:
            return self.rate_hz * sum(frames)
        return sum(needed_bytes_per_s(frame_bytes, packet_bytes, self.rate_hz) for frame_bytes in frames)

    def _size(self, serial: str | None) -> Size:
        return self.sizes.get(serial or "", Size())

    def wants(self, serial: str | None) -> bool:
        """Whether the daemon will open this camera."""
        return not self.serials or serial in self.serials.values()

    def name(self, serial: str | None) -> str:
        """A camera by its name, if it has one, and its serial number."""
        camera = next((f"{camera} " for camera, known in self.serials.items() if known == serial), "")
        return f"{camera}camera {serial or 'of unknown serial'}"

    def names(self, serials: Sequence[str | None]) -> str:
        """Cameras as `name` has them, in a list."""
        *most, last = map(self.name, serials)
        return f"{', '.join(most)} and {last}" if most else last

    def planned_shares(self, serial: str | None) -> int:
        """By how many cameras `transport.plan` divides the link of this one: all that name the same, or none."""
        link = self.links.get(serial or "")
        return sum(self.links.get(other) == link for other in self.serials.values())


def _number(value: object) -> int | None:
    """A size or factor, if it is one; bounds and increments are for the camera to judge."""
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 1 else None
