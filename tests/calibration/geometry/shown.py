"""The fakes' board, as their cameras see it, without a wire; and the truth about them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.board import Board, BoardFinder, BoardView
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.board import BoardPath, board_on_a_wall
from fake_camera.world.sensor import Sensor, SensorModel
from fake_camera.world.simulation import RoomView, SimulatedCamera
from imaging.frames import SIDES, Side

SIZE = (720, 540)
FOCAL_PX, CENTRE_PX, BASELINE_M = 860.0, (359.5, 269.5), 0.08
"""Of the fakes."""

_FRAME = ImageSettings(1500.0, 0.0, 0.0, 1.0, "Mono8", 0, 0, *SIZE, 1, 1)

Show = Callable[[float, int], dict[Side, NDArray[np.uint8]]]
"""Both pictures at a time (s), with the noise of a number."""


def shown(path: BoardPath) -> Show:
    """Cameras that are moved along a path."""
    light = LightScript((Change(0.0, 150.0),))
    cameras = {
        side: SimulatedCamera(RoomView(_renderer(), path, side), light, Sensor(SensorModel(), 2 * path.seed + place))
        for place, side in enumerate(SIDES)
    }

    def show(time_s: float, number: int) -> dict[Side, NDArray[np.uint8]]:
        return {side: camera.take(time_s, _FRAME, number).astype(np.uint8) for side, camera in cameras.items()}

    return show


@cache
def _renderer() -> Renderer:
    return Renderer(board_on_a_wall(0), Pinhole(*SIZE))


def views(path: BoardPath, count: int, board: Board | None = None) -> list[BoardView]:
    """The board at the rests of a path."""
    finder, show = BoardFinder(board or Board()), shown(path)
    found = []
    for number in range(count):
        pictures = show(number * (path.hold_s + path.move_s) + path.hold_s / 2, number)
        corners = {side: seen for side, grey in pictures.items() if (seen := finder.find(grey)) is not None}
        found.append(BoardView(f"{number:03}", corners))
    return found
