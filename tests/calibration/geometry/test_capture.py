"""Which views are taken of what two cameras see, and what the user is told."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.commands.measure_geometry import progress_text
from calibration.geometry import board as module
from calibration.geometry.board import Board, Capture
from calibration.session import whole_grey8
from fake_camera.world.scene.board import BoardPath
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from tests.calibration.geometry.shown import SIZE, shown

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


def test_the_terminal_shows_what_is_covered_and_what_to_do() -> None:
    capture, show = Capture(Board(), SIZE), shown(PATH)
    empty = progress_text(capture)
    assert empty.count("#") == 0
    assert empty.endswith("show the board to both cameras")
    for time_s in times_s(0)[:2]:
        capture.look(show(time_s, 0))
    text = progress_text(capture)
    assert text.count("#") == capture.covered("left").sum() + capture.covered("right").sum() > 0
    assert "1 views by both cameras" in text
    assert text.splitlines()[-1] == "taken: move on to where the left picture has dots"


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
