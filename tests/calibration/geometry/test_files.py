"""Calibration files: what they mean, and one sentence for each way to be wrong."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from calibration.geometry.file import check_camera, check_pair, load_geometry
from calibration.geometry.opencv import read_camera, ros_yaml
from calibration.geometry.slam import read_camchain
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, Side
from tests.calibration.geometry.written import LENSES, camchain, matrices, of_chain, of_ros, ros, show

NUMBERS = st.floats(-0.3, 0.3)


def load(tmp_path: Path, content: object, side: Side = "left") -> CameraGeometry:
    file = tmp_path / "camera.yaml"
    file.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return load_geometry(file, side)


def rectified_pixel(geometry: CameraGeometry, raw: np.ndarray) -> np.ndarray:
    k, d, r, p = matrices(geometry)
    turn = cv2.fisheye.undistortPoints if geometry.distortion_model == "equidistant" else cv2.undistortPoints
    return np.asarray(turn(raw.reshape(1, 1, 2), k, d, R=r, P=p[:, :3])).ravel()


@pytest.mark.parametrize("model", LENSES)
@given(point=st.tuples(NUMBERS, NUMBERS, st.floats(0.7, 5.0)))
def test_a_point_lies_in_one_row_of_both_rectified_pictures_by_its_depth(
    model: str, point: tuple[float, float, float]
) -> None:
    chain = camchain(model)
    pose = np.array(chain["cam1"]["T_cn_cnm1"])
    left, right = (of_chain(chain, side) for side in SIDES)
    x = np.array(point)
    (u, v), (u_right, v_right) = (
        rectified_pixel(geometry, show(geometry, seen))
        for geometry, seen in ((left, x), (right, pose[:3, :3] @ x + pose[:3, 3]))
    )
    assert v == pytest.approx(v_right, abs=0.02)
    depth_m = (np.reshape(left.rectification, (3, 3)) @ x)[2]
    assert u - u_right == pytest.approx(-right.projection[3] / depth_m, abs=0.02)
    assert right.baseline_m == pytest.approx(math.dist((0, 0, 0), (0.08, 0.001, -0.002)), rel=1e-6)


@settings(max_examples=30)
@given(st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=5), st.floats(300, 3000), st.text("0123456789", min_size=1))
def test_what_is_written_is_read_back(distortion: list[float], focal_px: float, serial: str) -> None:
    geometry = replace(
        of_ros(ros("right")),
        distortion=tuple(distortion),
        camera_matrix=(focal_px, 0.0, 300.0, 0.0, focal_px, 200.0, 0.0, 0.0, 1.0),
        serial=serial,
    )
    assert of_ros(yaml.safe_load(ros_yaml(geometry, "right"))) == geometry


def test_a_chain_of_one_camera_is_not_turned() -> None:
    chain = camchain()
    del chain["cam1"]
    left = read_camchain(chain).lenses["cam0"]
    assert np.reshape(left.projection, (3, 4))[:, :3].ravel().tolist() == list(left.camera_matrix)
    assert left.rectification == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    with pytest.raises(ConfigurationError, match="the key cam1 is missing"):
        of_chain(chain)


def test_numbers_as_programs_in_other_languages_write_them_are_read(tmp_path: Path) -> None:
    text = yaml.safe_dump(ros("left"), default_flow_style=None).replace("0.0005", "5e-04")
    assert load(tmp_path, text).distortion[3] == 5e-4


def test_four_coefficients_of_plumb_bob_mean_that_the_fifth_is_zero() -> None:
    document = ros("left")
    document["distortion_coefficients"]["data"].pop()
    assert of_ros(document).distortion == (-0.2, 0.05, 0.001, 0.0005, 0.0)


def spoilt(side: Side, key: str, value: object) -> dict[str, Any]:
    document = ros(side)
    if isinstance(document.get(key), dict):
        document[key]["data"] = value
    else:
        document[key] = value
    return document


UP = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("image_width", "wide", "image_width is 'wide': give a whole number of pixels"),
        ("camera_name", "narrow_stereo/right", "camera_name is 'narrow_stereo/right', but this is the left camera"),
        ("distortion_model", "scaramuzza", r"distortion_model is 'scaramuzza': only radtan \(plumb_bob\), rational_"),
        ("distortion_model", "omni", "its model, omni, has xi, .* here are 0, "),
        ("distortion_coefficients", [0.1] * 6, "distortion_coefficients has 6 numbers: the model has 4, 5, 8, 12, 14"),
        ("distortion_coefficients", [0.1] * 12, "has a thin prism or a tilted sensor"),
        ("distortion_coefficients", [1e9, 0, 0, 0, 0], "distortion_coefficients is beyond any lens"),
        ("distortion_coefficients", [0.1, float("nan"), 0, 0, 0], "holds nan: give finite"),
        ("distortion_coefficients", "x", "distortion_coefficients holds 'x': give finite numbers"),
        ("camera_matrix", [860.0] * 8, "camera_matrix is .*: give a list of 9 numbers, not 8"),
        ("camera_matrix", [860.0, 3, 360, 0, 860, 270, 0, 0, 1], "camera_matrix is not of the form fx 0 cx"),
        ("camera_matrix", [8.6, 0, 360, 0, 8.6, 270, 0, 0, 1], "focal lengths of 8.6 and 8.6 pixels: no lens has them"),
        ("camera_matrix", [860, 0, 900, 0, 860, 270, 0, 0, 1], r"principal point at \(900, 270\), outside of 720x540"),
        ("rectification_matrix", [1, 0, 0, 0, 1, 0, 0, 0, -1], "rectification_matrix is no rotation"),
        ("projection_matrix", [0.0] * 12, "projection_matrix is not of the form"),
        (
            "projection_matrix",
            [860.0, 0, 360, 0, 0, 860, 270, -69, 0, 0, 1, 0],
            "a baseline that is not along the rows",
        ),
        ("serial", 7, "serial is 7: give it in quotes"),
        ("camera_matrix", None, "camera_matrix.data is None: give a list"),
    ],
)
def test_a_ros_file_that_cannot_be_is_refused_by_key(tmp_path: Path, key: str, value: object, words: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"camera.yaml: .*{words}") as caught:
        load(tmp_path, spoilt("left", key, value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "key", "value", "words"),
    [
        ("cam0", "camera_model", "scaramuzza", "cam0.camera_model is 'scaramuzza': only radtan"),
        ("cam0", "camera_model", "omni", r"cam0.intrinsics is .*: give a list of 5 numbers, not 4"),
        ("cam1", "camera_model", "fov", "cam1: its model, fov, has w, .* here are 4, "),
        ("cam0", "intrinsics", [1, 2, 3], "cam0.intrinsics is .*: give a list of 4 numbers"),
        ("cam0", "intrinsics", [860, 860, 1e9, 270], "cam0: camera_matrix has its principal point"),
        ("cam1", "resolution", [720], "cam1.resolution is .*: give width and height"),
        ("cam1", "resolution", [640, 540], "cam0 has 720x540 pixels and cam1 has 640x540"),
        ("cam1", "T_cn_cnm1", [[1, 2], [3]], "cam1.T_cn_cnm1 is .*: give a list of 12 or 16 numbers"),
        ("cam1", "T_cn_cnm1", np.ones((4, 4)).tolist(), "cam1.T_cn_cnm1 is no rotation and translation"),
        ("cam1", "T_cn_cnm1", (np.eye(4) + 0.08 * np.eye(4)[[0]].T @ np.eye(4)[[3]]).tolist(), "check which camera is"),
        (
            "cam1",
            "T_cn_cnm1",
            (np.eye(4) - 0.08 * np.eye(4)[[1]].T @ np.eye(4)[[3]]).tolist(),
            "80 mm below and 0 mm ahead of it",
        ),
    ],
)
def test_a_camchain_that_cannot_be_is_refused_by_key(
    tmp_path: Path, name: str, key: str, value: object, words: str
) -> None:
    chain = camchain()
    chain[name][key] = value
    with pytest.raises(ConfigurationError, match=rf"camera.yaml: .*{words}"):
        load(tmp_path, chain, "right")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("image_width: 720", "has no camera in its keys .'image_width'.: give a camera-info file"),
        ("- 1", "has no keys"),
        ("cam0: [1]", "cam0 is .1.: give keys and values"),
        ("camera_matrix: {data: !!python/object:os.system {}}", "is not valid YAML"),
        ("cam0: {a: 1, a: 2}", "the key 'a' appears twice"),
    ],
)
def test_another_file_is_refused(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        load(tmp_path, text)


@settings(max_examples=30)
@given(st.recursive(st.none() | st.booleans() | st.floats() | st.integers() | st.text(), st.lists, max_leaves=5))
def test_nothing_under_a_key_is_worse_than_a_sentence(value: object) -> None:
    ros_file, chain = ros("left"), camchain()
    for key in ros_file:
        with contextlib.suppress(ConfigurationError):
            read_camera({**ros_file, key: value})
    for key in chain["cam1"]:
        with contextlib.suppress(ConfigurationError):
            of_chain({**chain, "cam1": {**chain["cam1"], key: value}})


def test_files_of_other_cameras_and_sizes_are_refused() -> None:
    left = replace(of_ros(ros("left")), serial="A")
    check_camera(left, "A", (720, 540))
    check_camera(left, "A")
    with pytest.raises(ConfigurationError, match="serial is A, but this is camera B"):
        check_camera(left, "B")
    with pytest.raises(ConfigurationError, match="for frames of 720x540 pixels, but camera A sends 360x270: calibrate"):
        check_camera(left, "A", (360, 270))


def test_files_that_are_no_pair_are_refused() -> None:
    left, right = of_ros(ros("left")), of_ros(ros("right"))
    check_pair(left, right)
    check_pair(left, None)
    check_pair(None, right)
    p = left.projection
    wrong: list[tuple[CameraGeometry | None, CameraGeometry | None, str]] = [
        (right, None, "cameras.left.calibration: projection_matrix has a baseline"),
        (None, left, "cameras.right.calibration: projection_matrix has no baseline"),
        (
            left,
            replace(right, projection=(*p[:3], -right.projection[3], *p[4:])),
            "puts this camera 0.08003 m to the left of the other .its fourth number is .*: exchange left and right",
        ),
        (replace(left, width=640), right, "640x540 pixels, cameras.right.calibration for 720x540"),
        (replace(left, projection=(p[0] + 1, *p[1:])), right, "project differently"),
    ]
    for one, other, words in wrong:
        with pytest.raises(ConfigurationError, match=words):
            check_pair(one, other)


def test_the_cameras_of_a_pair_are_named_as_the_rig_names_them() -> None:
    left, right = of_ros(ros("left")), of_ros(ros("right"))
    check_pair(left, right, "rear_left", "rear_right")
    with pytest.raises(ConfigurationError, match=r"cameras\.rear_left\.calibration: projection_matrix has a baseline"):
        check_pair(right, None, "rear_left", "rear_right")
    with pytest.raises(ConfigurationError, match=r"rear_left.* and cameras\.rear_right\.calibration project"):
        check_pair(replace(left, projection=(1.0, *left.projection[1:])), right, "rear_left", "rear_right")
