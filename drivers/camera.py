"""What the rig asks of a camera, whatever transport it hangs on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Frame
from drivers.pixel_format import PixelFormat


@dataclass(frozen=True, slots=True)
class IncompleteFrame:
    """A frame that arrived with holes: its image cannot be used, but its trigger is known to have been taken."""

    frame_id: int
    host_time_ns: int | None


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """Who a camera is, the pixel format it sends, and its limitations, in words for the user."""

    vendor: str
    model: str
    serial: str
    limitations: tuple[str, ...] = ()
    pixel_format: PixelFormat | None = None


class Camera(Protocol):
    """An opened camera.

    Two threads use it: one calls `next_frame`, the other everything else, so that a thread owns the nodes.
    Every method may raise `CameraLostError`.
    """

    @property
    def description(self) -> CameraDescription:
        """Who the camera is."""

    @property
    def limits(self) -> ExposureLimits:
        """The camera's own bounds and increments of exposure time and gain."""

    def start(self) -> None:
        """Start acquisition: from here on triggers make frames."""

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """Wait for the next frame; None when none came within `timeout_s`."""

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write exposure time and gain, and return what the camera's nodes read back."""

    def latch_clock(self) -> None:
        """Measure anew how the camera's clock maps to the host's."""

    def close(self) -> None:
        """Stop acquisition, give control back and free everything; safe to call on a lost camera, and twice.

        It is final: every later call raises `CameraLostError`.
        """
