"""Frames, and the set of them that one trigger makes, each with the exposure it was actually taken with."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imaging.exposure import ExposureSetting
from imaging.pixels import Layout, Pixels, grey_plane, sparse

CameraName = str
"""What a configuration calls a camera, such as `left` or `front_left`."""

SettingSource = Literal["chunk", "ledger"]
ClockTroubleKind = Literal["counter", "stamps", "wrap", "reading", "jump"]


@dataclass(frozen=True, slots=True)
class ClockTrouble:
    """What of a camera's numbers and time stamps is not believed, by kind, and a sentence that begins with "its"."""

    kind: ClockTroubleKind
    sentence: str


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image and how it was taken."""

    # grey levels or a colour mosaic, shape (height, width), or more samples to a pixel, shape (height, width, samples);
    # uint8, or uint16 where a sample has more than 8 bits
    pixels: Pixels
    bit_depth: int  # significant bits of a sample, as in `PixelFormat`
    # the camera's frame counter, unwrapped: it never restarts while the camera stays open. As counted by the host where
    # the camera's is not believed
    frame_id: int
    # the camera's own time stamp of this frame, on its own clock; where it is not believed, the one before it continued
    device_time_ns: int
    host_time_ns: int  # when its exposure began, CLOCK_MONOTONIC: `device_time_ns` mapped, or by its arrival
    arrival_time_ns: int  # when the frame was complete in the host's memory, CLOCK_MONOTONIC
    setting: ExposureSetting  # exposure time and gain that this frame was taken with
    # how that is known: "chunk", the frame itself says so; "ledger", inferred from when settings were written
    setting_source: SettingSource = "chunk"
    layout: Layout = "grey"  # what the samples are, as in `PixelFormat`
    # whether `host_time_ns` is late by the time of readout and transfer, as the camera's clock is not known
    by_arrival: bool = False
    clock_trouble: ClockTrouble | None = None  # what of it is not believed, told with one frame
    ptp_time_ns: int | None = None  # when its exposure began, in PTP time; None: it is not told by a PTP clock

    def grey8(self, saturation: int = 255) -> NDArray[np.uint8]:
        """What control sees of the pixels: 8-bit grey levels (see `grey_plane`), at half size for a colour mosaic.

        `saturation` is the 8-bit level from which a colour is clipped.
        """
        return grey_plane(self.pixels, self.bit_depth, self.layout, saturation)

    def sparse_grey8(self) -> NDArray[np.uint8]:
        """A sixteenth of the pixels as 8-bit grey levels, from all over the frame: for statistics."""
        return grey_plane(sparse(self.pixels, self.layout), self.bit_depth, self.layout)


@dataclass(frozen=True, slots=True, eq=False)
class FrameSet:
    """The frames of one trigger, by camera, in the order of the configuration; at least one.

    A camera is absent if the rig does not have it, or its frame did not arrive.
    """

    trigger: int
    frames: Mapping[CameraName, Frame]

    @property
    def reference_camera(self) -> CameraName:
        """The camera that decisions refer to: the first one present."""
        return next(iter(self.frames))

    @property
    def reference(self) -> Frame:
        """The frame of `reference_camera`."""
        return self.frames[self.reference_camera]

    @property
    def mismatched(self) -> bool:
        """Whether the frames were taken with different settings."""
        setting = self.reference.setting
        return not all(frame.setting.agrees_with(setting) for frame in self.frames.values())

    def of(self, cameras: Collection[CameraName]) -> FrameSet | None:
        """The part of it that some cameras made; None: no frame of theirs."""
        frames = {camera: frame for camera, frame in self.frames.items() if camera in cameras}
        return FrameSet(self.trigger, frames) if frames else None
