"""Choosing views from what two cameras see: a board at rest in a new place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.board import TILTS, Board, BoardFinder, BoardView, Corners, covered, guessed_lens, pose, tilts
from imaging.frames import SIDES, Side

ENOUGH_VIEWS, MOST_VIEWS = 40, 100
ENOUGH_COVERED = 0.85
ENOUGH_TILTED = 4
STILL_PX = 0.5
"""By how much corners may move from one look to the next: the cameras do not expose at exactly the same time."""
SHOW = "show the board to both cameras"
BLANK_LOOKS = 20
"""After this many looks without corners, a search for other markers, which takes a second, is worthwhile."""
NEW_SHARE = 0.06
"""By how much of the width corners must have moved from every view taken."""


class Capture:
    """The views taken so far.

    Parameters
    ----------
    board
        What is shown.
    size
        Width and height of the pictures.

    Attributes
    ----------
    views
        The board as both cameras see it, or one alone, which still shows its lens.
    advice
        What to do next, in a few words.
    """

    def __init__(self, board: Board, size: tuple[int, int]) -> None:
        self.views: list[BoardView] = []
        self.advice = SHOW
        self.finders: dict[Side, BoardFinder] = {side: BoardFinder(board) for side in SIDES}
        self._board, self._size = board, size
        self._blank = 0
        self._before: Mapping[Side, Corners] = {}
        self._tilted: dict[Side, Counter[str]] = {side: Counter() for side in SIDES}

    def look(self, pictures: Mapping[Side, NDArray[np.uint8]]) -> dict[Side, Corners]:
        """Look at the pictures of one moment, and keep the view if the board rests in a new place."""
        corners = {side: found for side in SIDES if (found := self.finders[side].find(pictures[side])) is not None}
        still = bool(corners) and all(
            side in self._before and _moved_px(found, self._before[side]) < STILL_PX for side, found in corners.items()
        )
        self._before = corners
        self._blank = 0 if corners else self._blank + 1
        view = BoardView(f"{len(self.views) + 1:03}", corners)
        if not corners:
            if self._blank == 1:
                self.advice = SHOW
            elif self._blank % BLANK_LOOKS == 0:
                self.advice = next(filter(None, (each.what_else() for each in self.finders.values())), SHOW)
        elif not self._new(view):
            self.advice = f"taken: move on {self._missing()}".rstrip()
        elif not still:
            self.advice = "hold it still"
        else:
            self._keep(view)
        return corners

    def covered(self, side: Side) -> NDArray[np.bool_]:
        """The parts of a picture in which corners were seen."""
        return covered((view.corners[side] for view in self.views if side in view.corners), self._size)

    def tilted(self, side: Side) -> dict[str, int]:
        """In how many views the board was turned, by direction."""
        return {name: self._tilted[side][name] for name in TILTS}

    @property
    def by_both(self) -> int:
        """How many views both cameras have."""
        return sum(view.by_both for view in self.views)

    @property
    def complete(self) -> bool:
        """Whether there are enough views of all kinds, or more than enough of some."""
        return (self.by_both >= ENOUGH_VIEWS and not self._missing()) or len(self.views) >= MOST_VIEWS

    def _keep(self, view: BoardView) -> None:
        self.views.append(view)
        lens = guessed_lens(self._size)
        for side, corners in view.corners.items():
            self._tilted[side].update(tilts(pose(self._board, corners, lens, np.zeros(5))[0][:, 2]))
        self.advice = f"taken: move on {self._missing()}".rstrip()

    def _new(self, view: BoardView) -> bool:
        """Whether the board is elsewhere than in all views kept by the same cameras."""
        kept = [other.corners for other in self.views if view.corners.keys() <= other.corners.keys()]
        least_px = NEW_SHARE * self._size[0]
        return all(
            any(_moved_px(found, other[side]) > least_px for side, found in view.corners.items()) for other in kept
        )

    def _missing(self) -> str:
        """What is missing most; empty if nothing is."""
        for side in SIDES:
            few = [name for name in TILTS if self._tilted[side][name] < ENOUGH_TILTED]
            if self.covered(side).mean() < ENOUGH_COVERED:
                return f"to where the {side} picture has dots"
            if few:
                return f"and turn the board to the {few[0]}" if few[0] in TILTS[:2] else f"and tip the board {few[0]}"
        return ""


def _moved_px(now: Corners, before: Corners) -> float:
    """How far the corners seen in both moved on average; infinite if there are none."""
    _, of_now, of_before = np.intersect1d(now.numbers, before.numbers, return_indices=True)
    if not len(of_now):
        return np.inf
    return float(np.linalg.norm(now.pixels[of_now] - before.pixels[of_before], axis=1).mean())
