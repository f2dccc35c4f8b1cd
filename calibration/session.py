"""Cameras on a tripod, running freely: the shots that a calibration asks for."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sweep import Shot
from drivers.camera import Camera, CameraDescription
from drivers.genicam.metadata import FRAMES_AFTER
from drivers.setup import CameraSetup, TriggerSetup
from imaging.errors import CameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame
from imaging.geometry import SIDES, Side
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
    what stands in the way. `samples` says which samples of a frame its shots hold. Every method may raise
    `CameraError`, in one sentence.
    """

    def __init__(self, camera: Camera, samples: Callable[[Pixels, Layout], Pixels] = light_samples) -> None:
        self._samples = samples
        self._camera = camera
        self._present: ExposureSetting | None = None
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

    def take(self, setting: ExposureSetting, frames: int) -> list[Shot]:
        """This many shots in a row, all really taken with `setting` as the camera rounds it.

        If frames report their setting, it waits until they report this one. Otherwise it leaves out those that may
        still show the previous setting: more than any camera that can be controlled needs. Raises CameraError, also
        when the camera sends no frames, or never takes the setting.
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

        Raises CameraError when none arrives in time.
        """
        exposures_us = [setting.exposure_time_us for setting in (self._present, previous) if setting is not None]
        patience_s = PATIENCE_S + 2e-6 * sum(exposures_us)
        deadline_s = time.monotonic() + patience_s
        while (left_s := deadline_s - time.monotonic()) > 0:
            frame = self._camera.next_frame(min(left_s, _POLL_S))
            if isinstance(frame, Frame):
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


RATE_HZ, SLOWEST_HZ = 20.0, 2.0
LONGEST_US = 5000.0
"""Longer exposures blur a board held by hand."""
BRIGHT_GREY = 190.0
"""Aim for the brightest twentieth of the picture: paper shows all its detail, and nothing is white."""
_START = ExposureSetting(2000.0, 0.0)
_WAIT_NS = 100_000_000
_DRAIN_NS = 20_000_000
_PATIENCE_S = 5.0
_KEPT = 4
_BLACK_GREY, _WHITE_GREY = 8.0, 250.0
_LEAST_CHANGE = 0.4  # stops: each write delays the next picture


class PairOfCameras:
    """Pictures of both cameras, as near in time as free running allows: within half a period."""

    def __init__(self, sessions: Mapping[Side, Session]) -> None:
        self._sessions = sessions
        self._frames: dict[Side, deque[Frame]] = {side: deque(maxlen=_KEPT) for side in SIDES}
        self._present = {
            side: session.write(_within(session.limits, _START.level)) for side, session in sessions.items()
        }

    def next_pair(self) -> dict[Side, Frame]:
        """The newest pictures of both, each exposed according to the one before it.

        Raises CameraError when a camera sends none, or fails.
        """
        deadline_s = time.monotonic() + _PATIENCE_S
        until_ns = time.monotonic_ns() + _WAIT_NS
        while True:
            for side, session in self._sessions.items():  # what the second one sent meanwhile is waiting
                self._frames[side].extend(session.frames_until(max(until_ns, time.monotonic_ns() + _DRAIN_NS)))
            if all(self._frames.values()):
                break
            if time.monotonic() > deadline_s:
                silent = next(side for side, frames in self._frames.items() if not frames)
                serial = self._sessions[silent].description.serial
                raise CameraError(f"camera {serial}: no whole frame arrived within {_PATIENCE_S:g} s: check its cable")
            until_ns = time.monotonic_ns() + _WAIT_NS
        left, right = min(
            ((left, right) for left in self._frames["left"] for right in self._frames["right"]),
            key=lambda pair: abs(pair[0].host_time_ns - pair[1].host_time_ns),
        )
        for frames in self._frames.values():
            frames.clear()
        pair: dict[Side, Frame] = {"left": left, "right": right}
        for side, frame in pair.items():
            self._expose(side, frame)
        return pair

    def _expose(self, side: Side, frame: Frame) -> None:
        """Write another exposure if a picture that was taken with the present one is dark or white."""
        if not frame.setting.agrees_with(self._present[side]):
            return
        bright = float(np.percentile(frame.grey8()[::4, ::4], 95))
        change = -1.0 if bright > _WHITE_GREY else math.log2(BRIGHT_GREY / max(bright, _BLACK_GREY))
        session = self._sessions[side]
        wanted = _within(session.limits, self._present[side].level + change)
        if abs(change) > _LEAST_CHANGE and not wanted.agrees_with(self._present[side]):
            self._present[side] = session.write(wanted)


def whole_grey8(frame: Frame) -> NDArray[np.uint8]:
    """A frame in 8 bits and full size; what is between the greens of a mosaic is interpolated, in place."""
    grey = frame.grey8()
    height, width = frame.pixels.shape[:2]
    if (height, width) == grey.shape:
        return grey
    return np.asarray(
        cv2.resize(grey, (2 * grey.shape[1], 2 * grey.shape[0]), interpolation=cv2.INTER_LINEAR), np.uint8
    )


def _within(limits: ExposureLimits, level: float) -> ExposureSetting:
    """The setting for a level: exposed as long as a hand-held board allows, then gain."""
    longest_us = max(min(LONGEST_US, limits.max_time_us), limits.min_time_us)
    return replace(limits, max_time_us=longest_us).realise(level, longest_us)
