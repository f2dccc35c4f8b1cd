"""What the rig needs from a camera, whatever its transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame
from drivers.pixels.formats import PixelFormat


@dataclass(frozen=True, slots=True)
class IncompleteFrame:
    """A frame that arrived with holes: its image is useless, but the camera did take its trigger."""

    frame_id: int
    host_time_ns: int | None


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera's identity, its limitations as phrases for the user, its pixel format, and what node drives its gain.

    `size` is width and height of its frames in pixels, if known.
    """

    vendor: str
    model: str
    serial: str
    limitations: tuple[str, ...] = ()
    pixel_format: PixelFormat | None = None
    gain_node: str | None = None
    size: tuple[int, int] | None = None


class Camera(Protocol):
    """An opened camera.

    Two threads use it: one calls `next_frame`, the other everything else, so that one thread owns the nodes.
    Every method may raise `CameraLostError`.
    """

    @property
    def description(self) -> CameraDescription:
        """The camera's identity and limitations."""

    @property
    def limits(self) -> ExposureLimits:
        """The camera's own bounds and increments of exposure time and gain."""

    def start(self) -> None:
        """Start acquisition: from now on triggers make frames."""

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """Wait for the next frame; None if none arrives within `timeout_s`."""

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write exposure time and gain, and return what the camera's nodes read back."""

    def trigger(self) -> None:
        """Take a frame now; for a camera that was set up with the trigger mode "software"."""

    def latch_clock(self) -> None:
        """Measure again how the camera's clock maps to the host's."""

    def close(self) -> None:
        """Stop acquisition, release control and free everything; safe on a lost camera, and to call twice.

        It is final: every later call raises `CameraLostError`.
        """
