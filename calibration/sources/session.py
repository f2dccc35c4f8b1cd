"""A camera on a tripod, running freely: the shots that a calibration asks it for."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType

from calibration.sources.sweep import Shot
from drivers.camera import Camera, CameraDescription
from drivers.genicam.metadata import FRAMES_AFTER
from drivers.setup import CameraSetup, TriggerSetup
from imaging.errors import CameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, SettingSource
from imaging.pixels import Layout, PixelFormat, Pixels, light_samples

PATIENCE_S = 3.0
"""How late a frame may be, beyond its own exposure and that of the previous setting."""
FRAMES_TO_OBEY = 16
"""A camera that takes none of this many frames with a setting that it read back never will."""
LATE_NS = 100_000_000
"""If the start of an exposure is inferred from a frame's arrival, one that had to queue seems to start this late."""
_POLL_S = 0.5  # how often a wait for a long exposure checks that the camera is still there


def session_setup(pixel_format: PixelFormat | None = None, rate_hz: float | None = None) -> CameraSetup:
    """How to open a camera for a `Session`: without triggers, at a rate or as fast as each exposure allows (None).

    A `pixel_format` of None keeps the camera's own.
    """
    return CameraSetup(TriggerSetup("free_run", rate_hz=rate_hz), pixel_format)


class Session:
    """One opened camera (see `session_setup`), started now and closed by `close` or at the end of a ``with`` block.

    Opening has switched off the camera's own auto exposure, auto gain and gamma, or says in `description.limitations`
    what stands in the way. Every method may raise `CameraError`, in one sentence.

    Parameters
    ----------
    camera
        Opened, not yet started.
    samples
        Which samples of a frame its shots hold.
    """

    def __init__(self, camera: Camera, samples: Callable[[Pixels, Layout], Pixels] = light_samples) -> None:
        self._samples = samples
        self._camera = camera
        self._present: ExposureSetting | None = None
        self._source: SettingSource | None = None
        camera.start()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def description(self) -> CameraDescription:
        """Who the camera is, and its limitations."""
        return self._camera.description

    @property
    def limits(self) -> ExposureLimits:
        """The camera's own bounds and increments of exposure time and gain."""
        return self._camera.limits

    @property
    def setting_source(self) -> SettingSource | None:
        """How the setting of the shots is known: "chunk", the frames say so; "ledger", from when they were taken.

        None before the first frame.
        """
        return self._source

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        """This many shots in a row, all really taken with `setting` as the camera rounds it.

        If frames report their setting, it waits until they report this one. Otherwise it leaves out those that may
        still show the previous setting: more than any camera that can be controlled needs.

        Raises
        ------
        CameraError
            Also when the camera sends no frames, or never takes the setting.
        """
        previous, taken = self._present, self.write(setting)
        written_ns = time.monotonic_ns()
        shots: list[Shot] = []
        since_write = 0
        while len(shots) < frames:
            frame = self.next_frame(previous)
            since_write += frame.host_time_ns > written_ns + LATE_NS
            if frame.setting_source == "ledger":
                obeyed = previous == taken or since_write > FRAMES_AFTER
            else:
                obeyed = frame.setting.agrees_with(taken)
            if obeyed:
                samples = self._samples(frame.pixels, frame.layout)
                shots.append(Shot(samples, frame.bit_depth, frame.setting, frame.host_time_ns * 1e-9))
            elif since_write > FRAMES_TO_OBEY:
                raise CameraError(
                    f"camera {self.description.serial}: it read back {taken}, but {FRAMES_TO_OBEY} frames later still "
                    f"exposes with {frame.setting}: switch off what else sets it (auto functions, sequencer, user sets)"
                )
        return shots

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write exposure time and gain, and return what the camera's nodes read back."""
        self._present = None  # unknown, should a node refuse half-way
        self._present = self._camera.write(setting)
        return self._present

    def next_frame(self, previous: ExposureSetting | None = None) -> Frame:
        """The next whole frame, awaited for as long as the present setting takes, and `previous` if it may still apply.

        Raises
        ------
        CameraError
            When none arrives in time.
        """
        exposures_us = [setting.exposure_time_us for setting in (self._present, previous) if setting is not None]
        patience_s = PATIENCE_S + 2e-6 * sum(exposures_us)
        deadline_s = time.monotonic() + patience_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._camera.next_frame(min(left_s, _POLL_S))
            if isinstance(frame, Frame):
                self._source = frame.setting_source
                return frame
        raise CameraError(
            f"camera {self.description.serial}: no whole frame arrived within {patience_s:.1f} s: check its cable and "
            "link with autoexpose doctor"
        )

    def frames_until(self, host_time_ns: int) -> list[Frame]:
        """The whole frames that arrive until a moment of CLOCK_MONOTONIC; returns then, or at once if it is past."""
        frames = []
        while (left_ns := host_time_ns - time.monotonic_ns()) > 0:
            frame = self._camera.next_frame(min(left_ns * 1e-9, _POLL_S))
            if isinstance(frame, Frame):
                frames.append(frame)
        return frames

    def latch_clock(self) -> None:
        """Measure again how the camera's clock maps to the host's; it may drift by 3 ms a minute."""
        self._camera.latch_clock()

    def close(self) -> None:
        """Stop the camera and give it back; safe to call twice."""
        self._camera.close()
