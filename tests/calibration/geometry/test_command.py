"""`autoexpose calibrate geometry` and `calibrate board` as a user meets them."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from calibration.geometry import board
from calibration.geometry.board import Board, BoardFinder
from calibration.geometry.file import check_pair, load_geometry
from fake_camera.world.scene.board import BoardPath
from imaging.geometry import SIDES
from tests.calibration.command_line import done, refused
from tests.calibration.geometry.test_calibrate import BASELINE_M, FOCAL_PX, shown
from tests.fakes import fake_camera, unique

STEADY = {"light": [{"at_s": 0, "lux": 150}]}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders `left` and `right` with 20 pictures each."""
    folder, path = tmp_path_factory.mktemp("pictures"), BoardPath(4)
    show = shown(path)
    for side in SIDES:
        (folder / side).mkdir()
    for number in range(20):
        pair = show(number * (path.hold_s + path.move_s), number)
        for side in SIDES:
            cv2.imwrite(str(folder / side / f"{number:02}.png"), pair[side])
    return folder


def from_folders(
    folder: Path, output: Path, *options: str, left: str = "left", right: str = "right"
) -> tuple[str, ...]:
    """The arguments to calibrate from pictures in two folders."""
    return ("geometry", "--left", str(folder / left), "--right", str(folder / right), "-o", str(output), *options)


def test_pictures_become_files_for_ros_and_kalibr_and_a_report(pictures: Path, tmp_path: Path) -> None:
    output = done(*from_folders(pictures, tmp_path / "out"))
    assert "verdict: believe it" in output
    assert re.search(r"baseline: (79\.9|80\.0)\d mm, if squares are 30 mm", output)
    pair = {side: load_geometry(tmp_path / "out" / f"{side}.yaml", side) for side in SIDES}
    check_pair(pair["left"], pair["right"])
    assert pair["right"].baseline_m == pytest.approx(BASELINE_M, rel=1e-3)
    assert pair["left"].camera_matrix[0] == pytest.approx(FOCAL_PX, rel=1e-3)
    for side in SIDES:
        of_chain = load_geometry(tmp_path / "out" / "camchain.yaml", side)
        assert of_chain.projection == pytest.approx(pair[side].projection, abs=1e-6)
    report = (tmp_path / "out" / "geometry.html").read_text()
    assert "Believe it" in report
    assert report.count("held out</td>") == 4
    assert "http" not in report.replace("http://www.w3.org", "")


def test_a_full_disk_leaves_former_files_whole(pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full_disk(_descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    done(*from_folders(pictures, tmp_path))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr(os, "fsync", full_disk)
    assert "left.yaml: cannot be written (No space left on device)" in refused(
        *from_folders(pictures, tmp_path, "--square-mm", "60", "--marker-mm", "42")
    )
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_refused_set_leaves_a_report_and_no_files(pictures: Path, tmp_path: Path) -> None:
    assert "markers in its last picture, but they are another board's" in refused(
        *from_folders(pictures, tmp_path / "out", "--squares", "11x8")
    )
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["geometry.html"]
    assert "Refused" in (tmp_path / "out" / "geometry.html").read_text()


def test_impossible_input_is_one_sentence(pictures: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    cv2.imwrite(str(other / "00.png"), np.zeros((8, 8), np.uint8))
    for arguments, words in (
        (("geometry", "-o", str(tmp_path / "out")), "say what to calibrate: one of --config, --camera"),
        (("geometry", "-o", str(tmp_path / "out"), "--left", str(pictures / "left")), "--left and --right belong"),
        (("geometry", "-o", str(tmp_path / "out"), "--camera", "A"), "a pair has two cameras, left and right: 1 given"),
        (("geometry", "-o", str(tmp_path / "out"), "--camera", "A", "--camera", "A"), "the same camera, A"),
        (("geometry", "-o", str(tmp_path / "no" / "out"), "--camera", "A"), "out: cannot be made"),
        (("board", str(tmp_path / "board.txt")), "name a .pdf or .png file"),
        (("board", str(tmp_path / "no" / "board.png")), "cannot be written"),
        (("board", str(tmp_path / "board.png"), "--squares", "9"), "--squares '9': give columns x rows"),
        (("board", str(tmp_path / "board.png"), "--squares", "99x99"), "at most twice as many squares"),
        (("board", str(tmp_path / "board.png"), "--dictionary", "DICT_9"), "there is no dictionary 'DICT_9'"),
        (("board", str(tmp_path / "board.png"), "--marker-mm", "30"), "markers of 0.3 to 0.9 of that"),
    ):
        output = refused(*arguments)
        assert (words in output, output.count("\n")) == (True, 0)
    for left, right, words in (
        (other, pictures / "right", "hold 1 and 20 pictures, and only one has 01: give the two pictures"),
        (tmp_path / "none", pictures / "right", "none: is not a folder"),
    ):
        assert words in refused(*from_folders(tmp_path, tmp_path / "out", left=str(left), right=str(right)))
    (tmp_path / "half").mkdir()
    for name in ("00", "01"):
        cv2.imwrite(str(tmp_path / "half" / f"{name}.png"), np.zeros((270, 360), np.uint8))
        cv2.imwrite(str(other / f"{name}.png"), np.zeros((540, 720), np.uint8))
    output = refused(*from_folders(tmp_path, tmp_path / "out", left="other", right="half"))
    assert "half/00.png: is 360x270 pixels" in output


def test_another_file_is_not_replaced(pictures: Path, tmp_path: Path) -> None:
    (tmp_path / "left.yaml").write_text("cameras: {}")
    assert "it is not a calibration file to replace" in refused(*from_folders(pictures, tmp_path))
    assert (tmp_path / "left.yaml").read_text() == "cameras: {}"


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_measured(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda _path, mode: mode != os.W_OK)  # root may write anywhere
    output = refused(*from_folders(pictures, tmp_path))
    assert output.endswith("cannot be written: name a folder that you may write to")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["board.pdf", "board.png"])
def test_a_board_is_drawn_to_scale(tmp_path: Path, name: str) -> None:
    output = done("board", str(tmp_path / name), "--squares", "7x5", "--square-mm", "40")
    assert "written: " in output
    assert "300 x 220 mm: print it at 100 %" in output
    if name.endswith("pdf"):
        assert b"/MediaBox [ 0 0 850.39" in (tmp_path / name).read_bytes(), "300 mm in points"
        return
    drawn = cv2.imread(str(tmp_path / name), cv2.IMREAD_GRAYSCALE)
    found = BoardFinder(Board(7, 5, 0.040, 0.028)).find(drawn.astype(np.uint8))
    assert len(found.numbers) == 6 * 4
    assert np.ptp(found.pixels, axis=0) == pytest.approx((5 * 400, 3 * 400), abs=1.0)


@pytest.mark.wire
def test_two_cameras_are_watched_until_views_suffice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(board, "MOST_VIEWS", 1)
    light = tmp_path / "light.yaml"
    light.write_text(yaml.safe_dump(STEADY))
    wire, options = unique("wire"), ["--scene", "board", "--light", str(light)]
    with contextlib.ExitStack() as stack:
        left, right = (stack.enter_context(fake_camera(side=side, line0=wire, options=options)) for side in SIDES)
        output = refused("geometry", "--camera", left.serial, "--camera", right.serial, "-o", str(tmp_path / "out"))
    assert "of 720x540 pixels" in output
    assert "both cameras see the board in 1 views: show it in at least 15" in output
    assert (tmp_path / "out" / "geometry.html").exists()
