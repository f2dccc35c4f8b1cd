"""The ChArUco board: a chessboard with a marker in each white square, so that a part is enough; and views of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, Side

DICTIONARIES: Final[tuple[str, ...]] = tuple(
    f"DICT_{bits}X{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)
)
MARKER_SHARE = 0.7
"""Side of a marker as a part of a square's: corners are measured in what is left around it."""
LEAST_MARKERS = 4
LEAST_CORNERS = 8
"""Fewer corners do not fix a pose against noise."""
_BLUR_PX = 1.0
"""Blur before corners are measured: as much as the lens of a real camera, against noise and aliasing."""
_WINDOW_PX = (2, 11)
_REFINED: Final = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)


DEFAULT_DICTIONARY: Final = "DICT_5X5_100"


@dataclass(frozen=True, slots=True)
class Board:
    """A board by its squares, sizes in metres; the default is 270 x 180 mm, and prints on A4.

    Raises ConfigurationError when there is no such board.
    """

    columns: int = 9
    rows: int = 6
    square_m: float = 0.030
    marker_m: float = MARKER_SHARE * 0.030
    dictionary: str = DEFAULT_DICTIONARY

    def __post_init__(self) -> None:
        if self.dictionary not in DICTIONARIES:
            raise ConfigurationError(
                f"there is no dictionary {self.dictionary!r}: give one of {', '.join(DICTIONARIES)}"
            )
        if min(self.columns, self.rows) < 3 or self.columns * self.rows // 2 > self.markers:
            raise ConfigurationError(
                f"a board of {self.columns}x{self.rows} squares: give at least 3x3, and at most twice as many squares "
                f"as {self.dictionary} has markers"
            )
        if not 0.001 <= self.square_m <= 1.0 or not 0.3 <= self.marker_m / self.square_m <= 0.9:
            raise ConfigurationError(
                f"squares of {1e3 * self.square_m:g} mm with markers of {1e3 * self.marker_m:g} mm: give squares of 1 "
                "to 1000 mm, and markers of 0.3 to 0.9 of that"
            )

    @property
    def markers(self) -> int:
        """How many markers its dictionary has."""
        return int(self.dictionary.rpartition("_")[2])

    @property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV knows it."""
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, dictionary)

    @property
    def points_m(self) -> NDArray[np.float32]:
        """Where the inner corners are on the board, by their numbers: shape (corners, 3), the last 0."""
        return np.asarray(self.charuco.getChessboardCorners(), np.float32)

    def holds_pose(self, numbers: NDArray[np.int64]) -> bool:
        """Whether these corners show how the board is turned: enough of them, and not all in a line."""
        if len(numbers) < LEAST_CORNERS:
            return False
        places = self.points_m[numbers, :2]
        return bool(np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] > self.square_m)

    def __str__(self) -> str:
        sizes = f"squares of {1e3 * self.square_m:g} mm, markers of {1e3 * self.marker_m:g} mm"
        return f"{self.columns}x{self.rows} {sizes}, {self.dictionary}"


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners of a board seen in a picture: their numbers, shape (n,), and pixels, shape (n, 2)."""

    numbers: NDArray[np.int64]
    pixels: NDArray[np.float64]


class BoardFinder:
    """Finds the corners of a board in pictures."""

    def __init__(self, board: Board) -> None:
        self.board = board
        self.without: NDArray[np.uint8] | None = None  # the last picture in which it found no board
        self._detector = cv2.aruco.CharucoDetector(board.charuco)
        self._points_m = board.points_m[:, :2]

    def find(self, grey: NDArray[np.uint8]) -> Corners | None:
        """The corners in a picture of shape (height, width); None if hardly anything of the board is seen."""
        found, numbers, _, _ = self._detector.detectBoard(grey)
        order = np.array([], np.int64) if numbers is None else np.asarray(numbers).ravel().astype(np.int64)
        if not self.board.holds_pose(order):
            self.without = grey
            return None
        pixels = np.array(found, np.float32).reshape(-1, 1, 2)
        window = self._window_px(order, pixels.reshape(-1, 2))
        blurred = cv2.GaussianBlur(grey, (0, 0), _BLUR_PX)
        refined = cv2.cornerSubPix(blurred, pixels, (window, window), (-1, -1), _REFINED)
        return Corners(order, np.asarray(refined).reshape(-1, 2).astype(np.float64))

    def what_else(self) -> str:
        """The markers seen where no board was found, in words: of another dictionary, or another board; or nothing."""
        if self.without is None:
            return ""
        for name in (self.board.dictionary, *DICTIONARIES):
            dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
            _, found, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(self.without)
            if found is not None and len(found) >= LEAST_MARKERS:
                other = "another board's" if name == self.board.dictionary else f"those of {name}"
                return f"there are {len(found)} markers in its last picture, but they are {other}"
        return ""

    def _window_px(self, numbers: NDArray[np.int64], pixels: NDArray[Any]) -> int:
        """Half the side of the largest window around a corner that no marker reaches into, anywhere in the picture."""
        place = self._points_m[numbers]
        apart_m = np.linalg.norm(place[:, None] - place[None], axis=2)
        apart_px = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
        neighbours = (apart_m > 0) & (apart_m < 1.1 * self.board.square_m)
        if not neighbours.any():
            return _WINDOW_PX[0]
        margin = (1.0 - self.board.marker_m / self.board.square_m) / 2
        return int(np.clip(margin * apart_px[neighbours].min(), *_WINDOW_PX))


CELLS: Final = (6, 8)
"""Rows and columns of parts of the picture in which corners must have been seen."""
TILTED_DEG = 15.0
"""A board turned by less hardly tells the focal length from the distance."""
TILTS: Final = ("left", "right", "up", "down")
_GUESSED_WIDTHS = 1.2
"""A focal length that is good enough to see which way a board is tilted, in widths of the picture."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """The board at one moment: its corners in the pictures of the cameras that see it."""

    name: str
    corners: Mapping[Side, Corners]

    @property
    def by_both(self) -> bool:
        """Whether both cameras see the board."""
        return len(self.corners) == 2


def covered(corners: Iterable[Corners], size: tuple[int, int]) -> NDArray[np.bool_]:
    """The parts of a picture of this width and height in which corners were seen, shape `CELLS`."""
    cells = np.zeros(CELLS, np.bool_)
    for seen in corners:
        place = seen.pixels / size * CELLS[::-1]
        columns, rows = np.clip(place.astype(int), 0, np.array(CELLS[::-1]) - 1).T
        cells[rows, columns] = True
    return cells


def tilts(normal: NDArray[np.float64]) -> list[str]:
    """The directions, of `TILTS`, in which a board is turned by `TILTED_DEG`, from its normal in the camera's axes."""
    x_deg, y_deg = np.degrees(np.arctan2(normal[:2], normal[2]))
    turned = (x_deg < -TILTED_DEG, x_deg > TILTED_DEG, y_deg < -TILTED_DEG, y_deg > TILTED_DEG)
    return [name for name, true in zip(TILTS, turned, strict=True) if true]


def guessed_lens(size: tuple[int, int]) -> NDArray[np.float64]:
    """K of a camera before it is calibrated."""
    focal_px = _GUESSED_WIDTHS * size[0]
    return np.array([[focal_px, 0.0, (size[0] - 1) / 2], [0.0, focal_px, (size[1] - 1) / 2], [0.0, 0.0, 1.0]])


def pose(
    board: Board, seen: Corners, k: NDArray[np.float64], distortion: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation (3, 3) and translation (3,) in metres from the board to a camera with this lens."""
    _, turned, moved = cv2.solvePnP(board.points_m[seen.numbers], seen.pixels, k, distortion)
    return np.asarray(cv2.Rodrigues(turned)[0], np.float64), np.asarray(moved, np.float64).ravel()


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
    """The views taken so far of a board, in pictures of a size (width, height)."""

    def __init__(self, board: Board, size: tuple[int, int]) -> None:
        self.views: list[BoardView] = []  # the board as both cameras see it, or one alone, which still shows its lens
        self.advice = SHOW  # what to do next, in a few words
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
