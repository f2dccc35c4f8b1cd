"""What the daemon will need from the host."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

from autoexpose_daemon.config.document import Config, TriggerConfig
from drivers.frames import Side

ASSUMED_WIDTH, ASSUMED_HEIGHT = 720, 540
"""A frame's size is known only once a camera is open; this is the size of the sensors this project is made for."""


@dataclass(frozen=True, slots=True)
class Need:
    """Cameras, rate and frames; without `serials` every camera found counts as needed."""

    serials: Mapping[Side, str] = field(default_factory=dict)
    rate_hz: float = TriggerConfig().rate_hz
    width: int = ASSUMED_WIDTH
    height: int = ASSUMED_HEIGHT
    bytes_per_pixel: int = 1
    packet_size_bytes: int | None = None

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
            bytes_per_pixel=2 if config.image.pixel_format in ("Mono12", "Mono16") else 1,
            packet_size_bytes=config.transport.packet_size_bytes,
        )

    @property
    def frame_bytes(self) -> int:
        """Size of one frame."""
        return self.width * self.height * self.bytes_per_pixel

    @property
    def assumption(self) -> str:
        """What `bandwidth_mb_per_s` assumes."""
        return f"assuming {self.width}x{self.height} pixels of {8 * self.bytes_per_pixel} bits at {self.rate_hz:g} Hz"

    def bandwidth_mb_per_s(self, cameras: int) -> float:
        """What this many cameras send, in 10^6 bytes per second."""
        return cameras * self.frame_bytes * self.rate_hz / 1e6

    def wants(self, serial: str | None) -> bool:
        """Whether the daemon will open that camera."""
        return not self.serials or serial in self.serials.values()

    def name(self, serial: str | None) -> str:
        """A camera by its side, if it has one, and its serial."""
        side = next((f"{side} " for side, known in self.serials.items() if known == serial), "")
        return f"{side}camera {serial or 'of unknown serial'}"
