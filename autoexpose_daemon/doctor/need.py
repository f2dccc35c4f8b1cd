"""What the daemon will need from the host."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from autoexpose_daemon.config.document import Config, TriggerConfig
from drivers.frames import Side
from drivers.pixels.formats import PixelFormat

ASSUMED_WIDTH, ASSUMED_HEIGHT = 720, 540
"""A frame's size is known only once a camera is open; this is the size of the sensors this project is made for."""


@dataclass(frozen=True, slots=True)
class Need:
    """Cameras, rate and frames; without `serials` every camera found is needed."""

    serials: Mapping[Side, str] = field(default_factory=dict)
    rate_hz: float = TriggerConfig().rate_hz
    width: int = ASSUMED_WIDTH
    height: int = ASSUMED_HEIGHT
    bits_per_pixel: int = PixelFormat.MONO8.bits_per_pixel
    packet_size_bytes: int | None = None
    plan: bool = False

    @classmethod
    def of(cls, config: Config | None) -> Self:
        """The need of a configuration."""
        if config is None:
            return cls()
        binning = config.image.binning or 1
        return cls(
            serials={side: camera.serial for side, camera in config.sides.items()},
            rate_hz=config.trigger.rate_hz,
            width=ASSUMED_WIDTH // binning,
            height=ASSUMED_HEIGHT // binning,
            bits_per_pixel=(config.image.pixel_format or PixelFormat.MONO8).bits_per_pixel,
            packet_size_bytes=config.transport.packet_size_bytes,
            plan=config.transport.plan,
        )

    @property
    def frame_bytes(self) -> int:
        """Size of one frame."""
        return self.width * self.height * self.bits_per_pixel // 8

    @property
    def assumption(self) -> str:
        """The assumption behind `bandwidth_mb_per_s`."""
        return f"assuming {self.width}x{self.height} pixels of {self.bits_per_pixel} bits at {self.rate_hz:g} Hz"

    def bandwidth_mb_per_s(self, cameras: int) -> float:
        """What this many cameras send, in 10^6 bytes per second."""
        return cameras * self.frame_bytes * self.rate_hz / 1e6

    def wants(self, serial: str | None) -> bool:
        """Whether the daemon will open this camera."""
        return not self.serials or serial in self.serials.values()

    def name(self, serial: str | None) -> str:
        """A camera by its side, if it has one, and its serial number."""
        side = next((f"{side} " for side, known in self.serials.items() if known == serial), "")
        return f"{side}camera {serial or 'of unknown serial'}"
