"""What the rig needs from a camera, whatever its transport."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame
from imaging.pixels import PixelFormat


@dataclass(frozen=True, slots=True)
class IncompleteFrame:
    """A frame that arrived with holes: its image is useless, but the camera did take its trigger."""

    frame_id: int
    host_time_ns: int | None


@dataclass(frozen=True, slots=True)
class PtpState:
    """What a camera says about its PTP clock: its PtpStatus, and its time minus its master's (ns), if it gives that."""

    status: str
    offset_ns: int | None

    def __str__(self) -> str:
        return self.status if self.offset_ns is None else f"{self.status} {self.offset_ns / 1000:+.1f} us"


@dataclass(frozen=True, slots=True)
class ClockReading:
    """How a camera's clock maps to the host's: CLOCK_MONOTONIC is `host_offset_ns` ahead of it."""

    host_offset_ns: int
    ptp: PtpState


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """A camera's identity, its limitations as phrases for the user, its pixel format, and the node behind its gain.

    `size` is width and height of its frames in pixels, if known; `action_queue` how many scheduled triggers it keeps;
    `link_mbps` how fast it says its link is.
    """

    vendor: str
    model: str
    serial: str
    limitations: tuple[str, ...] = ()
    pixel_format: PixelFormat | None = None
    gain_node: str | None = None
    size: tuple[int, int] | None = None
    action_queue: int = 1
    link_mbps: float | None = None


@dataclass(frozen=True, slots=True)
class RefusedPackets:
    """Packets that someone sent to a camera's stream and that the host refused, since they did not look like its own.

    `senders` sent most of them (ADDRESS:PORT); `addresses` are the camera's own.
    """

    count: int
    senders: tuple[str, ...]
    addresses: tuple[str, ...]

    def __str__(self) -> str:
        own, others = " and ".join(self.addresses), " and ".join(self.senders)
        return f"packets for its stream come from {others} and are refused: its own are expected from {own}"


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

    def schedule(self, device_time_ns: int) -> None:
        """Take a frame when the camera's clock shows this; for one that was set up with the trigger mode "ptp"."""

    def latch_clock(self) -> ClockReading | None:
        """Measure again how the camera's clock maps to the host's; returns that in the trigger mode "ptp"."""

    def temperature_c(self) -> float | None:
        """How warm it is inside, degrees Celsius; None if it does not say."""

    def refused_packets(self) -> RefusedPackets | None:
        """What was sent to its stream since the last call and looked foreign; None: nothing."""

    def close(self) -> None:
        """Stop acquisition, release control and free everything; safe on a lost camera, and to call twice.

        It is final: every later call raises `CameraLostError`.
        """
