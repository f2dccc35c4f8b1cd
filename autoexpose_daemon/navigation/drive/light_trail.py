"""What a drive saw of the light, along the path."""

from __future__ import annotations

from typing import Final

from autoexpose_daemon.control.light_ahead import MOST_STOPS
from autoexpose_daemon.control.registration import Registration
from autoexpose_daemon.control.view import View
from autoexpose_daemon.navigation.maps.light import EVERY_M, LightRow
from imaging.frames import Frame, Side
from imaging.response import ResponseFunction

SIDE: Final[Side] = "left"

BLIND_SHARE: Final = 0.8
"""With this share of a frame's pixels black or saturated, changes of the light do not show ..."""

MOST_WAITING: Final = 120
"""... and its place waits for that, but no more than so many."""


class LightTrail:
    """Collects how the light changed on a drive, and the exposure levels of its frames."""

    def __init__(self) -> None:
        self._rows: list[LightRow] = []
        self._waiting: list[LightRow] = []
        self._next_m = self._risen = 0.0
        self._seen_by: tuple[View, Registration] | None = None

    def see(self, distance_m: float, frame: Frame, response: ResponseFunction) -> None:
        """The left frame taken after this distance along the path."""
        if distance_m < self._next_m:
            return
        self._next_m = distance_m + EVERY_M
        view, registration = self._seen_by = self._seen_by or (View(response), Registration({SIDE: response}))
        look = view.look(SIDE, frame)
        light = registration.change(look, frame.setting.level)
        change = light.stops if light else 0.0
        self._risen += change
        here = distance_m, frame.setting.level, self._risen
        if sum(view.shares.measure(look.image, look.weights)) >= BLIND_SHARE:
            self._waiting.append(here)
            self._add(self._waiting[:-MOST_WAITING])
            self._waiting = self._waiting[-MOST_WAITING:]
            return
        # What only shows now had changed when nothing was seen.
        later = [(place_m, level, risen + change) for place_m, level, risen in self._waiting[1:]]
        self._add([*self._waiting[:1], *later, here])
        self._waiting = []

    def new_rows(self, *, ended: bool = False) -> list[LightRow]:
        """What was found since this was last asked; the newest places wait if nothing shows there, or for the end."""
        if ended:
            self._add(self._waiting)
            self._waiting = []
        rows, self._rows = self._rows, []
        return rows

    def _add(self, rows: list[LightRow]) -> None:
        self._rows += [row for row in rows if abs(row[1]) <= MOST_STOPS]
