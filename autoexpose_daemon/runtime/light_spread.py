"""Whether cameras that are exposed together see the same light."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from itertools import permutations

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
    """Remembers how much more light a camera sees than others of its group, and names those that see stops more.

    One exposure cannot serve both: the brighter one is white, or the darker one black. Frames are compared with those
    of the same trigger, so that light which changes makes no difference.
    """

    def __init__(
        self, groups: Collection[Collection[CameraName]], responses: Mapping[CameraName, ResponseFunction]
    ) -> None:
        self.sentences: dict[CameraName, str] = {}  # what is wrong, in words to follow "left camera: "
        self._groups = [group for group in groups if len(group) > 1]
        self._light = {camera: np.exp2(response.log2_exposure) for camera, response in responses.items()}
        self._more: dict[tuple[CameraName, CameraName], float] = {}  # by how much the first sees more (stops)
        self._compared_ns: dict[tuple[CameraName, CameraName], int] = {}
        self._apart: dict[CameraName, float] = {}  # as told
        self._due_ns = 0

    def look(self, frames: FrameSet) -> None:
        """Look at the frames of a trigger, now and then."""
        now_ns = frames.reference.arrival_time_ns
        if not self._groups or now_ns < self._due_ns:
            return
        self._due_ns = now_ns + LOOK_NS
        for group in self._groups:
            seen = {camera: self._seen(camera, frame) for camera, frame in frames.frames.items() if camera in group}
            for camera, other in permutations(seen, 2):
                self._compare(camera, other, seen[camera][0] - seen[other][1], now_ns)
            self._judge(seen.keys())

    def _seen(self, camera: CameraName, frame: Frame) -> tuple[float, float]:
        """The mean light of a frame, at least and at most (stops): a white one tells no most, a black one no least."""
        grey = frame.sparse_grey8()
        stops = float(np.log2(self._light[camera][grey].mean())) - frame.setting.level
        mean_grey = grey.mean()
        return -math.inf if mean_grey < BLACK_GREY else stops, math.inf if mean_grey > WHITE_GREY else stops

    def _compare(self, camera: CameraName, other: CameraName, more: float, now_ns: int) -> None:
        """Remember that one camera sees at least so much more light than another (stops)."""
        if more == -math.inf:
            return
        pair = camera, other
        share = min((now_ns - self._compared_ns.get(pair, now_ns)) * 1e-9 / REMEMBERED_S, 1.0)
        before = self._more.get(pair, more)
        self._more[pair] = before + share * (more - before)
        self._compared_ns[pair] = now_ns

    def _judge(self, cameras: Collection[CameraName]) -> None:
        for camera in cameras:
            more = {other: self._more.get((camera, other), 0.0) for other in cameras if other != camera}
            darkest = max(more, key=more.__getitem__, default=camera)
            apart, said = more.get(darkest, 0.0), self._apart.get(camera)
            if apart <= (APART_STOPS if said is None else TOGETHER_STOPS):
                self._apart.pop(camera, None)
                self.sentences.pop(camera, None)
            elif said is None or abs(apart - said) >= 1.0:  # not each change is told
                self._apart[camera] = apart
                self.sentences[camera] = (
                    f"sees at least {apart:.1f} stops more light than the {darkest} camera, with which it is exposed: "
                    f"give one of them a `group` of its own, or, if a filter is before {darkest}, its `offset_stops`"
                )
