"""The geometry of what odometry gets, and the user's own program that follows the camera."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evaluation.odometry.stereo import StereoCamera
from evaluation.rejudge import following
from evaluation.rejudge.camera import Rectifier
from evaluation.rejudge.following import CommandFollower
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.geometry import CameraGeometry

CAMERA = StereoCamera(860.0, (359.5, 269.5), 0.08)
UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def geometry(centre_x: float, baseline_m: float) -> CameraGeometry:
    k = (860.0, 0.0, centre_x, 0.0, 860.0, 269.5, 0.0, 0.0, 1.0)
    p = (860.0, 0.0, centre_x, -860.0 * baseline_m, 0.0, 860.0, 269.5, 0.0, 0.0, 0.0, 1.0, 0.0)
    return CameraGeometry(720, 540, "plumb_bob", (0.0,) * 5, k, UNTURNED, p)


def test_columns_that_a_calibration_moves_against_each_other_are_no_depth() -> None:
    """What is infinitely far is on both optical axes: column 359.5 of the left picture, 339.5 of the right one."""
    images = {side: np.zeros((540, 720), np.uint8) for side in ("left", "right")}
    images["left"][:, 359:361] = images["right"][:, 339:341] = 200
    setting = ExposureSetting(1000.0, 0.0)
    left, right = (Frame(image, 8, 0, 0, 0, 0, setting) for image in images.values())
    rectifier = Rectifier({"left": geometry(359.5, 0.0), "right": geometry(339.5, 0.08)}, (540, 720))
    seen_left, seen_right = rectifier.images(StereoPair(0, {"left": left, "right": right}))
    assert np.array_equal(seen_left, seen_right)
    assert rectifier.camera.centre_px == (359.5, 269.5)


def test_orb_slam3_is_given_no_file_that_another_process_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[tuple[str, Path]] = []

    def write(file: Path) -> None:
        assert not (tmp_path / "vocabulary.txt").exists()
        file.write_text("words")

    def slam(_camera: StereoCamera, vocabulary: Path, folder: Path, _interval_s: float) -> None:
        given.append((vocabulary.read_text(), folder))

    monkeypatch.setattr(following, "write_taught_vocabulary", write)
    monkeypatch.setattr(following, "OrbSlam3", slam)
    everyone = following.Following(following.ORB_SLAM3, CAMERA, 0.1, tmp_path)
    for name in ("fixed", "neves2009"):
        everyone.begin(name)
    assert given == [("words", tmp_path / "fixed"), ("words", tmp_path / "neves2009")]


def test_what_a_program_complains_about_need_not_be_utf_8(tmp_path: Path) -> None:
    slam = tmp_path / "slam.py"
    slam.write_text("import sys; sys.stderr.buffer.write(b'no vocabulary in m\\xfcll'); sys.exit(3)")
    follower = CommandFollower(f"{sys.executable} {slam}", tmp_path / "pictures", CAMERA)
    with pytest.raises(AutoexposeError, match=r"failed with exit code 3: no vocabulary in m.ll"):
        follower.end()


def test_ctrl_c_ends_the_users_program_too(tmp_path: Path) -> None:
    """It runs below a worker process, and here below a script of the user's, too."""
    lives, slam, main = tmp_path / "lives", tmp_path / "slam.sh", tmp_path / "main.py"
    os.mkfifo(lives)  # open for as long as a program lives
    slam.write_text(f"sh -c 'exec 3>{lives}; echo started >&3; exec sleep 1000'\necho ended\n")
    main.write_text(
        f"""
from pathlib import Path
from evaluation.pool import over_processes
from evaluation.rejudge.following import CommandFollower, StereoCamera

def follow(number):
    CommandFollower("sh {slam}", Path("{tmp_path}", str(number)), StereoCamera(860.0, (359.5, 269.5), 0.08)).end()

if __name__ == "__main__":
    for _ in over_processes(follow, [1, 2], 2):
        pass
"""
    )
    rejudge = subprocess.Popen([sys.executable, main], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        with lives.open() as programs:
            assert [programs.readline(), programs.readline()] == ["started\n"] * 2
            os.killpg(rejudge.pid, signal.SIGINT)
            assert rejudge.wait() != 0
            assert programs.read() == ""
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(rejudge.pid, signal.SIGKILL)
        rejudge.wait()
