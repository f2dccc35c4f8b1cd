"""What a drive saw of the light, along the path."""

from __future__ import annotations

from collections import deque
from typing import Final

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.light_ahead import MOST_STOPS
from autoexpose_daemon.control.policies.hindsight import Hindsight, Moment
from autoexpose_daemon.navigation.maps.light import EVERY_M, LightRow
from calibration.response import ResponseFunction
from drivers.frames import Frame, Side

SIDE: Final[Side] = "left"


class LightTrail:
    """Collects how the light changed on a drive, and the levels that would have served."""

    def __init__(self) -> None:
        self._rows: list[LightRow] = []
        self._next_m = self._motion_px = 0.0
        self._waiting_m: deque[float] = deque()
        self._hindsight: Hindsight | None = None

    def see(self, distance_m: float, frame: Frame, decision: Decision | None, response: ResponseFunction) -> None:
        """The left frame taken after this distance along the path, and what was decided on it, if anything was."""
        if decision is None or not decision.motion_px >= 0.0:
            return
        self._motion_px += decision.motion_px
        if distance_m < self._next_m:
            return
        self._next_m = distance_m + EVERY_M
        if self._hindsight is None:
            self._hindsight = Hindsight(SIDE, response)
        self._waiting_m.append(distance_m)
        for moment in self._hindsight.see(frame, self._motion_px):
            self._add(moment)
        self._motion_px = 0.0

    def new_rows(self, *, ended: bool = False) -> list[LightRow]:
        """What was found since this was last asked; the newest places wait for frames after them, or for the end."""
        if ended and self._hindsight is not None:
            for moment in self._hindsight.rest():
                self._add(moment)
        rows, self._rows = self._rows, []
        return rows

    def _add(self, moment: Moment) -> None:
        distance_m = self._waiting_m.popleft()
        if abs(moment.served) <= MOST_STOPS:
            self._rows.append((distance_m, moment.served, moment.risen))
