"""The geometry of a pair from views of a board: which are taken, the truth of the fakes, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry import board as module
from calibration.geometry.board import Board, BoardFinder, BoardView, Capture, Corners, tilts
from calibration.geometry.fit import GeometryResult, calibrate_geometry, common, overall, score
from calibration.session import whole_grey8
from fake_camera.imaging import ImageSettings
from fake_camera.world.lighting import Change, LightScript
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.board import BoardPath, board_on_a_wall
from fake_camera.world.sensor import Sensor, SensorModel
from fake_camera.world.simulation import RoomView, SimulatedCamera
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.geometry import SIDES, Side

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


BOARD = Board()


@pytest.fixture(scope="module")
def good() -> list[BoardView]:
    return views(BoardPath(1), 40)


@pytest.fixture(scope="module")
def result(good: list[BoardView]) -> GeometryResult:
    return calibrate_geometry(BOARD, good, SIZE, {"left": "A", "right": "B"})


def test_lens_and_baseline_of_the_fakes_are_recovered_to_a_thousandth(result: GeometryResult) -> None:
    assert (result.verdict, result.findings) == ("believe it", ())
    for side, serial in zip(SIDES, "AB", strict=True):
        geometry = result.geometries[side]
        fx, _, cx, _, fy, cy, *_ = geometry.camera_matrix
        assert (fx, fy) == pytest.approx((FOCAL_PX, FOCAL_PX), rel=1e-3)
        assert (cx, cy) == pytest.approx(CENTRE_PX, abs=1e-3 * SIZE[0])
        assert np.abs(geometry.distortion).max() < 0.03
        assert geometry.serial == serial
    assert result.geometries["right"].baseline_m == pytest.approx(BASELINE_M, rel=1e-3)


def test_stated_errors_of_the_focal_length_are_as_large_as_true_ones(result: GeometryResult) -> None:
    for lens in result.fit.lenses.values():
        true_error = abs(lens.geometry.camera_matrix[0] / FOCAL_PX - 1)
        assert true_error < 4 * lens.focal_error < 2e-3


def test_a_fifth_of_the_views_is_held_out_and_agrees(result: GeometryResult) -> None:
    assert (len(result.used), len(result.held_out)) == (32, 8)
    assert {each.name for each in result.used}.isdisjoint(each.name for each in result.held_out)
    for scores in (result.used, result.held_out):
        error_px, rows_px, scale = overall(scores)
        assert error_px < 0.15
        assert rows_px < 0.1
        assert abs(scale) < 1e-3


def test_another_set_of_views_agrees_and_shows_a_wrong_calibration(result: GeometryResult) -> None:
    others = views(BoardPath(9), 6)
    error_px, rows_px, scale = overall(score(BOARD, result.geometries, others))
    assert error_px < 0.15
    assert rows_px < 0.1
    assert abs(scale) < 1e-3
    p = result.geometries["right"].projection
    longer = replace(result.geometries["right"], projection=(*p[:3], 1.01 * p[3], *p[4:]))
    _, _, scale = overall(score(BOARD, {**result.geometries, "right": longer}, others))
    assert scale == pytest.approx(0.01, abs=1e-3)


def synthetic(left: tuple[float, ...], right: tuple[float, ...], turn: tuple[float, ...]) -> list[BoardView]:
    """Views by lenses with distortion, the right one 120 mm away and turned (rad); 0.05 pixels of noise."""
    rng, path = np.random.default_rng(5), BoardPath(5, distance_m=(0.4, 0.7))
    k = np.array([[FOCAL_PX, 0.0, 350.0], [0.0, FOCAL_PX, 280.0], [0.0, 0.0, 1.0]])
    rotation = cv2.Rodrigues(np.array(turn))[0]
    places: dict[Side, tuple[NDArray[Any], NDArray[Any], tuple[float, ...]]] = {
        "left": (np.eye(3), np.zeros(3), left),
        "right": (rotation, -rotation @ [0.12, 0.002, -0.003], right),
    }
    middle = np.array([BOARD.columns, BOARD.rows, 0]) * BOARD.square_m / 2
    made = []
    for number in range(40):
        pose = path.pose(number * (path.hold_s + path.move_s))
        seen_m = (BOARD.points_m - middle - pose[:3, 3]) @ pose[:3, :3]
        corners: dict[Side, Corners] = {}
        for side, (turned, moved_m, distortion) in places.items():
            pixels, _ = cv2.projectPoints(seen_m, turned, moved_m, k, np.array(distortion))
            noisy = np.asarray(pixels).reshape(-1, 2) + rng.normal(0, 0.05, (len(seen_m), 2))
            inside = np.flatnonzero(((noisy >= 0) & (noisy < SIZE)).all(axis=1))
            if BOARD.holds_pose(inside):
                corners[side] = Corners(inside, noisy[inside])
        made.append(BoardView(f"{number:03}", corners))
    return made


def test_distorting_and_turned_cameras_are_recovered() -> None:
    distortions = (-0.25, 0.08, 0.001, -0.0005), (-0.2, 0.05, 0.0, 0.001)
    turn = (0.01, -0.03, 0.02)
    found = calibrate_geometry(BOARD, synthetic(*distortions, turn), SIZE)
    assert (found.verdict, found.findings) == ("believe it", ())
    for side, distortion in zip(SIDES, distortions, strict=True):
        geometry = found.geometries[side]
        assert geometry.distortion[:4] == pytest.approx(distortion, abs=0.01)
        assert geometry.camera_matrix[0] == pytest.approx(FOCAL_PX, rel=1e-3)
    assert found.fit.rotation == pytest.approx(cv2.Rodrigues(np.array(turn))[0], abs=1e-3)
    assert found.geometries["right"].baseline_m == pytest.approx(np.linalg.norm([0.12, 0.002, 0.003]), rel=1e-3)
    _, rows_px, _ = overall(found.held_out)
    assert rows_px < 0.15


def test_corners_in_a_line_hold_no_pose() -> None:
    row = np.arange(BOARD.columns - 1)
    assert not BOARD.holds_pose(row)
    assert not BOARD.holds_pose(row[:7])
    assert BOARD.holds_pose(np.concatenate([row, row + BOARD.columns - 1, row + 2 * BOARD.columns - 2]))


Spoil = Callable[[list[BoardView]], list[BoardView]]


def swap(good: list[BoardView]) -> list[BoardView]:
    return [BoardView(one.name, {"left": one.corners["right"], "right": one.corners["left"]}) for one in both(good)]


def shift(good: list[BoardView]) -> list[BoardView]:
    """The right camera a moment later."""
    pairs = zip(both(good), both(good)[1:], strict=False)
    return [BoardView(one.name, {**one.corners, "right": other.corners["right"]}) for one, other in pairs]


def both(good: list[BoardView]) -> list[BoardView]:
    return [view for view in good if view.by_both]


def in_the_middle(good: list[BoardView]) -> list[BoardView]:
    def cut(corners: Corners) -> Corners:
        kept = (np.abs(corners.pixels - CENTRE_PX) < (150, 120)).all(axis=1)
        return Corners(corners.numbers[kept], corners.pixels[kept])

    kept = [BoardView(view.name, {side: cut(corners) for side, corners in view.corners.items()}) for view in good]
    return [view for view in kept if min(len(corners.numbers) for corners in view.corners.values()) >= 8]


def bent(good: list[BoardView]) -> list[BoardView]:
    """A board that is not flat."""

    def bend(corners: Corners) -> Corners:
        off = 8.0 * np.sin(BOARD.points_m[corners.numbers, 0] / 0.03)
        return Corners(corners.numbers, corners.pixels + np.column_stack([off, np.zeros(len(off))]))

    return [BoardView(view.name, {side: bend(corners) for side, corners in view.corners.items()}) for view in good]


@pytest.mark.parametrize(
    ("spoil", "reason", "words"),
    [
        (lambda good: [], "never_seen", "the left camera never saw the board: it must be in the picture"),
        (
            lambda good: [BoardView(one.name, {"left": one.corners["left"]}) for one in good],
            "never_seen",
            "the right camera",
        ),
        (lambda good: good[:12], "few_views", "both cameras see the board in 12 views: show it in at least 15"),
        (in_the_middle, "poor_coverage", "of the left picture: show the board in all of its parts"),
        (swap, "no_geometry", "the right camera is -80 mm to the right of the left one.*which camera is which"),
        (shift, "not_together", "the cameras fit alone .* but not together"),
        (bent, "reprojection", "corners are off by .* pixels rms: check the board's squares"),
    ],
)
def test_bad_sets_are_refused(good: list[BoardView], spoil: Spoil, reason: str, words: str) -> None:
    result = calibrate_geometry(BOARD, spoil(good), SIZE)
    assert result.verdict == "refused"
    (finding, *_) = [each for each in result.findings if each.reason == reason]
    assert finding.severity == "refused"
    assert re.search(words, finding.text)
    assert "\n" not in finding.text


def test_a_board_that_was_never_turned_is_refused() -> None:
    result = calibrate_geometry(BOARD, views(BoardPath(1, tilt_deg=4.0), 18), SIZE)
    assert [each.reason for each in result.findings if each.severity == "refused"] == ["no_tilt", "no_tilt"]
    assert "hardly saw the board turned by 15 degrees to the left, right, up, down" in result.findings[-1].text


def test_a_blurred_view_is_named(good: list[BoardView]) -> None:
    left = good[7].corners["left"]
    noise = np.random.default_rng(1).normal(0, 2, left.pixels.shape)
    blurred = BoardView("007", {**good[7].corners, "left": Corners(left.numbers, left.pixels + noise)})
    result = calibrate_geometry(BOARD, [*good[:7], blurred, *good[8:]], SIZE)
    assert result.verdict == "with care"
    assert any(each.reason == "outliers" and "007" in each.text for each in result.findings)


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (Board(11, 8), "but they are another board's"),
        (Board(dictionary="DICT_4X4_50"), "but they are those of DICT_5X5_50"),
    ],
)
def test_another_board_is_named(board: Board, words: str) -> None:
    finder = BoardFinder(board)
    assert finder.what_else() == ""
    assert finder.find(shown(BoardPath(1))(0.0, 0)["left"]) is None
    assert words in finder.what_else()
    result = calibrate_geometry(board, [], SIZE, instead={"left": finder.what_else()})
    assert words in result.findings[0].text


def test_a_wall_without_markers_is_nothing_else() -> None:
    finder = BoardFinder(BOARD)
    assert finder.find(np.full((540, 720), 90, np.uint8)) is None
    assert finder.what_else() == ""


def test_turns_are_named_as_a_camera_sees_them() -> None:
    tilted = {
        name: tilts(np.array([x, y, 1.0]))
        for name, x, y in (("left", -0.5, 0), ("right", 0.5, 0), ("up", 0, -0.5), ("down", 0, 0.5), ("", 0.2, 0.2))
    }
    assert tilted == {"left": ["left"], "right": ["right"], "up": ["up"], "down": ["down"], "": []}


def test_common_corners_are_in_one_order() -> None:
    pixels = np.arange(10.0).reshape(5, 2)
    left, right = Corners(np.array([4, 2, 9, 1, 7]), pixels), Corners(np.array([1, 9, 3]), pixels[:3])
    of_left, of_right = common(BoardView("", {"left": left, "right": right}))
    assert of_left.numbers.tolist() == of_right.numbers.tolist() == [1, 9]
    assert of_left.pixels.tolist() == [[6, 7], [4, 5]]
    assert of_right.pixels.tolist() == [[0, 1], [2, 3]]


PATH = BoardPath(2)
BLACK = np.zeros(SIZE[::-1], np.uint8)


def times_s(rest: int) -> tuple[float, float, float]:
    """A moment after a rest has begun, one later in it, and one on the way to the next."""
    start_s = rest * (PATH.hold_s + PATH.move_s)
    return start_s + 0.2, start_s + 0.4, start_s + PATH.hold_s + PATH.move_s / 2


def test_a_view_is_taken_at_each_rest_and_only_there() -> None:
    capture, show = Capture(Board(), SIZE), shown(PATH)
    for rest in range(5):
        for number, time_s in enumerate(times_s(rest)):
            before = len(capture.views)
            capture.look(show(time_s, 3 * rest + number))
            assert len(capture.views) - before == (number == 1)
            assert capture.advice.startswith("taken: move on" if number == 1 else "hold it still")
    assert capture.by_both == 5
    assert [view.name for view in capture.views] == [f"{number:03}" for number in range(1, 6)]
    for number in range(2):
        capture.look(show(times_s(3)[number], 99 + number))
    assert len(capture.views) == 5, "the board has been there before"
    assert sum(capture.tilted("left").values()) > 2
    assert not capture.complete


def test_a_view_of_one_camera_counts_for_its_lens_alone() -> None:
    capture, show = Capture(Board(), SIZE), shown(PATH)
    for time_s in times_s(1)[:2]:
        capture.look({"left": show(time_s, 0)["left"], "right": BLACK})
    assert (len(capture.views), capture.by_both) == (1, 0)
    assert not capture.covered("right").any()


def test_who_shows_nothing_or_another_board_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BLANK_LOOKS", 2)
    picture = shown(PATH)(0.0, 0)
    for board, pictures, words in (
        (Board(), {"left": BLACK, "right": BLACK}, "show the board to both cameras"),
        (Board(11, 8), picture, "markers in its last picture, but they are another board's"),
    ):
        capture = Capture(board, SIZE)
        for _ in range(2):
            capture.look(pictures)  # type: ignore[arg-type]
        assert capture.advice.endswith(words)


def test_it_ends_when_all_is_covered_or_much_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    capture, show = Capture(Board(), SIZE), shown(PATH)
    for time_s in times_s(0)[:2]:
        capture.look(show(time_s, 0))
    assert not capture.complete
    with monkeypatch.context() as patch:
        patch.setattr(module, "MOST_VIEWS", 1)
        assert capture.complete
    monkeypatch.setattr(module, "ENOUGH_VIEWS", 1)
    monkeypatch.setattr(module, "ENOUGH_COVERED", 0.05)
    assert not capture.complete, "it lacks tilts"
    monkeypatch.setattr(module, "ENOUGH_TILTED", 0)
    assert capture.complete


def test_a_mosaic_is_seen_in_full_size_with_everything_in_its_place() -> None:
    ramp = np.add.outer(np.arange(40), 3 * np.arange(60)).astype(np.uint8)
    for layout in ("grey", "RGGB", "GBRG"):
        frame = Frame(ramp, 8, 0, 0, 0, 0, ExposureSetting(1000.0, 0.0), layout=layout)  # type: ignore[arg-type]
        whole = whole_grey8(frame)
        assert whole.shape == ramp.shape
        assert np.abs(whole[2:-2, 2:-2].astype(int) - ramp[2:-2, 2:-2]).max() <= 1
