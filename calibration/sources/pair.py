"""Two cameras that run freely side by side: pictures of one moment, well exposed."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.sources.session import Session
from imaging.errors import CameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import SIDES, Frame, Side

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

        Raises
        ------
        CameraError
            When a camera sends none, or fails.
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
