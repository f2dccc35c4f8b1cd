"""The demo's options on the command line."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from autoexpose_daemon.demo.fakes import MOST_CAMERAS
from documents.files import check_writable
from imaging.errors import ConfigurationError
from imaging.pixels import PIXEL_FORMATS

SECONDS = (2.0, 3600.0)
NAVIGATE_SECONDS = (60.0, 3600.0)
RATES_HZ = (2.0, 200.0)
_LARGEST_SEED = 2**64 - 1
_LARGEST_SCRIPT_BYTES = 1 << 18

Transport = Literal["gige", "usb3"]
SIZES = ("720x540", "1440x1080", "2048x1536", "2448x2048")
"""The sizes that the fake cameras' sensors can have."""


@dataclass(frozen=True, slots=True)
class DemoOptions:
    """The options; `rate_hz` None: the rate that this machine can sustain.

    Raises ConfigurationError for a number out of bounds, and for a file that cannot be read or written.
    """

    seconds: float
    policy: str
    summary: Path | None
    plot: Path | None
    scene: str
    light: Path | None
    seed: int
    transport: Transport
    rate_hz: float | None
    still: bool
    publish: bool
    record: Path | None
    navigate: bool = False
    pixel_format: str = "Mono8"
    size: str = SIZES[0]
    bracket: bool = False
    cameras: int = 2

    def __post_init__(self) -> None:
        _check_within("--seconds", self.seconds, NAVIGATE_SECONDS if self.navigate else SECONDS, "s")
        if self.navigate and (self.still or self.light is not None or self.record is not None or self.scene != "room"):
            raise ConfigurationError(
                "--navigate itself decides how cameras move and how bright the room is, and records nothing: "
                "leave out --still, --light, --scene, --record and --bracket"
            )
        if self.navigate and (self.size != SIZES[0] or not self.pixel_format.startswith("Mono")):
            raise ConfigurationError(
                f"--navigate drives with grey views of {SIZES[0]}: leave out --size, --pixel-format"
            )
        self._check_pair()
        if self.pixel_format not in PIXEL_FORMATS:
            raise ConfigurationError(
                f"--pixel-format {self.pixel_format} is not supported: see docs/look-up/configuration.md"
            )
        if self.size not in SIZES:
            raise ConfigurationError(f"--size {self.size} cannot be simulated: give one of {', '.join(SIZES)}")
        if self.rate_hz is not None:
            _check_within("--rate-hz", self.rate_hz, RATES_HZ, "Hz")
        if not 0 <= self.seed <= _LARGEST_SEED:
            raise ConfigurationError(f"--seed {self.seed} is not within 0 to {_LARGEST_SEED}")
        if self.scene != "room":
            _check_readable("--scene", Path(self.scene), "name a Radiance .hdr file, or `room`")
        if self.light is not None:
            _check_readable("--light", self.light, "name a light script (docs/do/fake-camera.md)")
            if self.light.stat().st_size > _LARGEST_SCRIPT_BYTES:
                raise ConfigurationError(f"--light {self.light} is longer than {_LARGEST_SCRIPT_BYTES >> 10} KiB")
        for file in (self.summary, self.plot):
            if file is not None:
                check_writable(file)

    def _check_pair(self) -> None:
        if not 1 <= self.cameras <= MOST_CAMERAS:
            raise ConfigurationError(f"--cameras {self.cameras} is not within 1 to {MOST_CAMERAS}")
        if self.cameras != 2 and (self.navigate or self.bracket or self.scene != "room"):
            raise ConfigurationError(
                "--navigate, --bracket and --scene are for a stereo pair: leave them out, or --cameras"
            )

    @property
    def width_height(self) -> tuple[int, int]:
        """The size of the cameras' images, pixels."""
        width, height = self.size.split("x")
        return int(width), int(height)


def _check_within(option: str, number: float, bounds: tuple[float, float], unit: str) -> None:
    low, high = bounds
    if not low <= number <= high:
        raise ConfigurationError(f"{option} {number:g} is not within {low:g} to {high:g} {unit}")


def _check_readable(option: str, file: Path, instead: str) -> None:
    """Check for a regular file: a pipe or device could keep a camera waiting forever."""
    if not file.is_file():
        raise ConfigurationError(f"{option} {file} is not a file: {instead}")
    if not os.access(file, os.R_OK):
        raise ConfigurationError(f"{option} {file} is not readable by this user")
