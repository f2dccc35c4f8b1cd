"""What a camera is set to before its first frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivers.config.feature import FeatureSetting
from drivers.exposure.gain_scale import GainScale
from drivers.pixels.formats import PixelFormat

TriggerMode = Literal["external", "free_run", "software", "ptp"]


@dataclass(frozen=True, slots=True)
class TriggerSetup:
    """What starts an exposure.

    Attributes
    ----------
    mode
        "external": every rising edge on `line`; "free_run": the camera's own clock at `rate_hz`; "software": each
        `Camera.trigger`; "ptp": when its clock, synchronised by PTP, shows the time of a `Camera.schedule`.
    line
        The camera's input line, by the name of its TriggerSource entry.
    rate_hz
        Frame rate (Hz); written to the camera only in a free run, otherwise that of its triggers. None, in a free run:
        as fast as exposure and readout allow, so that exposures may have any length.
    longest_exposure_us
        The longest exposure time that will be asked for.
    output_line
        In a free run, the output line that the camera holds active while it exposes, to trigger another camera;
        None: none.
    """

    mode: TriggerMode
    line: str = "Line0"
    rate_hz: float | None = 60.0
    longest_exposure_us: float = 0.0
    output_line: str | None = None


@dataclass(frozen=True, slots=True)
class ActionKeys:
    """What an action command and a camera must have in common: both keys, and a bit of the mask."""

    device: int
    group: int
    mask: int


ACTION_KEYS = ActionKeys(0xAE, 1, 1)
"""Any will do: commands are sent to each camera alone."""


@dataclass(frozen=True, slots=True)
class LinkShare:
    """The link to the host that several cameras share.

    Attributes
    ----------
    cameras
        How many.
    mbps
        Its speed, megabits per second; None: that of the host's network interface.
    """

    cameras: int
    mbps: float | None = None


@dataclass(frozen=True, slots=True)
class CameraSetup:
    """Trigger wiring, image format and transport of one camera; None keeps what the camera has.

    Attributes
    ----------
    trigger
        What starts an exposure.
    pixel_format
        Its PixelFormat.
    binning
        `binning` x `binning` pixels are read as one, over the whole sensor.
    packet_size_bytes
        GigE Vision only: size of a stream packet, headers included; None uses the largest that gets through.
    link_share
        GigE Vision only: the link that its stream has to share; None: it sends as fast as it can.
    features
        Features to set before everything else, in this order.
    gain_scale
        What a gain that is not in dB means; None leaves such a gain alone. "own numbers" drives it in the numbers of
        its node, as if they were dB, so that their meaning can be measured.
    exposure_count_us
        Microseconds in a count of an exposure time whose unit the camera does not give; None: there is none such.
    """

    trigger: TriggerSetup
    pixel_format: PixelFormat | None = None
    binning: int | None = None
    packet_size_bytes: int | None = None
    link_share: LinkShare | None = None
    features: tuple[FeatureSetting, ...] = ()
    gain_scale: GainScale | Literal["own numbers"] | None = None
    exposure_count_us: float | None = None
