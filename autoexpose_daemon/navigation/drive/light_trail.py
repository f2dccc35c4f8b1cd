"""Which exposure levels would have served along a drive, found in hindsight."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.light_ahead import MOST_STOPS
from autoexpose_daemon.control.registration import Registration
from autoexpose_daemon.control.view import View
from autoexpose_daemon.navigation.maps.light import EVERY_M, LightRow
from calibration.response import ResponseFunction
from drivers.frames import Frame, Side

SETTLED_STOPS: Final = 0.5
"""A frame taken this close to what was then decided on it shows what served. Others are from when control followed the
light, led it, or probed."""

BLIND_SHARE: Final = 0.8
"""With this share of a frame's pixels black or saturated, what was decided on it was a guess."""

LONGEST_UNSETTLED_M: Final = 1.0
"""If exposure did not settle for longer than this, what served is not known."""

SIDE: Final[Side] = "left"


@dataclass(slots=True)
class _Place:
    """Of a frame: how far along the path, and by how much the light had risen since the start, stops."""

    distance_m: float
    risen: float


class LightTrail:
    """Collects the levels that would have served on a drive.

    Where exposure had settled, that is what was decided. From one such place to the next it follows the light, as
    frames show it, and what then remains is spread over the way. Decisions themselves would not do: they lag behind a
    fast change, and by more with a slow camera.
    """

    def __init__(self) -> None:
        self._rows: list[LightRow] = []
        self._next_m = 0.0
        self._risen = 0.0
        self._unsettled: deque[_Place] = deque()
        self._blind: list[_Place] = []
        self._settled: tuple[float, float] | None = None  # distance, and the level less the rise of the light
        self._view: View | None = None
        self._registration: Registration | None = None

    def see(self, distance_m: float, frame: Frame, decision: Decision | None, response: ResponseFunction) -> None:
        """The left frame taken after this distance along the path, and what was decided on it, if anything was."""
        if decision is None or distance_m < self._next_m or not abs(decision.level) <= MOST_STOPS:
            return
        self._next_m = distance_m + EVERY_M
        change = self._change(frame, response)
        self._risen += change
        place = _Place(distance_m, self._risen)
        self._unsettled.append(place)
        while self._unsettled[0].distance_m < distance_m - LONGEST_UNSETTLED_M:
            self._unsettled.popleft()
        if decision.saturated_share + decision.black_share >= BLIND_SHARE:
            self._blind.append(place)
            return
        for blind in self._blind[1:]:  # what only shows now had changed when nothing was seen
            blind.risen += change
        self._blind = []
        if abs(decision.level - frame.setting.level) <= SETTLED_STOPS:
            self._settle(distance_m, decision.level + self._risen)

    def new_rows(self) -> list[LightRow]:
        """What was found since this was last asked."""
        rows, self._rows = self._rows, []
        return rows

    def _change(self, frame: Frame, response: ResponseFunction) -> float:
        """By how much the light has risen since the frame before, stops."""
        if self._view is None or self._registration is None:
            self._view, self._registration = View(response), Registration({SIDE: response})
        change = self._registration.change(self._view.look(SIDE, frame), frame.setting.level)
        return change.stops if change else 0.0

    def _settle(self, distance_m: float, content: float) -> None:
        """`content`: the level that would serve here in the light of the start, stops."""
        before_m, before = self._settled or (distance_m, content)
        for place in self._unsettled:
            there = float(np.interp(place.distance_m, [before_m, distance_m], [before, content]))
            self._rows.append((place.distance_m, there - place.risen))
        self._unsettled.clear()
        self._settled = distance_m, content
