"""Whether cameras that are exposed together see the same light."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from imaging.frames import CameraName, Frame, FrameSet
from imaging.response import ResponseFunction

LOOK_NS = 200_000_000
"""Light that differs for good is seen as well by five sets a second."""
REMEMBERED_S = 3.0
"""A view past a lamp, or one that turns before the other, is over by then."""
APART_STOPS = 1.5
"""One exposure still serves cameras whose light differs by less."""
TOGETHER_STOPS = 1.0
"""It differed by more, and is said to be over from here on."""
BLACK_GREY, WHITE_GREY = 1.0, 254.0
"""Frames whose mean is beyond have next to nothing in them."""


class LightSpread:
    """Remembers the mean light that each camera sees, and names those that see stops more than others of their group.

    One exposure cannot serve both: the brighter one is white, or the darker one black.
    """

    def __init__(
        self, groups: Collection[Collection[CameraName]], responses: Mapping[CameraName, ResponseFunction]
    ) -> None:
        self.sentences: dict[CameraName, str] = {}  # what is wrong, in words to follow "left camera: "
        self._groups = [group for group in groups if len(group) > 1]
        self._light = {camera: np.exp2(response.log2_exposure) for camera, response in responses.items()}
        self._stops: dict[CameraName, float] = {}
        self._apart: dict[CameraName, float] = {}  # as told
        self._due_ns = 0
        self._looked_ns: dict[CameraName, int] = {}
        self._mean_grey: dict[CameraName, float] = {}

    def look(self, frames: FrameSet) -> None:
        """Look at the frames of a trigger, now and then."""
        now_ns = frames.reference.arrival_time_ns
        if not self._groups or now_ns < self._due_ns:
            return
        self._due_ns = now_ns + LOOK_NS
        for camera, frame in frames.frames.items():
            self._see(camera, frame, now_ns)
        for group in self._groups:
            if present := {camera: self._stops[camera] for camera in group if camera in frames.frames}:
                self._judge(present)

    def _see(self, camera: CameraName, frame: Frame, now_ns: int) -> None:
        """Note the mean light of a frame (stops): of a white one it is at least that, of a black one at most."""
        grey = frame.sparse_grey8()
        self._mean_grey[camera] = float(grey.mean())
        seen = float(np.log2(self._light[camera][grey].mean())) - frame.setting.level
        share = min((now_ns - self._looked_ns.get(camera, now_ns)) * 1e-9 / REMEMBERED_S, 1.0)
        before = self._stops.get(camera, seen)
        self._stops[camera] = before + share * (seen - before)
        self._looked_ns[camera] = now_ns

    def _judge(self, stops: Mapping[CameraName, float]) -> None:
        darkest = min(stops, key=stops.__getitem__)
        for camera in stops:
            apart, said = stops[camera] - stops[darkest], self._apart.get(camera)
            if self._mean_grey[camera] < BLACK_GREY or self._mean_grey[darkest] > WHITE_GREY:
                apart = 0.0  # nobody knows
            if apart <= (APART_STOPS if said is None else TOGETHER_STOPS):
                self._apart.pop(camera, None)
                self.sentences.pop(camera, None)
            elif said is None or abs(apart - said) >= 1.0:  # not each change is told
                self._apart[camera] = apart
                self.sentences[camera] = (
                    f"sees at least {apart:.1f} stops more light than the {darkest} camera, with which it is exposed: "
                    f"give one of them a `group` of its own, or, if a filter is before {darkest}, its `offset_stops`"
                )
