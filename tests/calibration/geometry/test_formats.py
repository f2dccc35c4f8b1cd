"""Calibrations of others: what is read of each format, compared with each other, with OpenCV, and with geometry."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from calibration.geometry.file import check_pair, load_geometry, read_rig
from calibration.geometry.numbers import baseline_note
from calibration.geometry.opencv import ros_yaml
from calibration.geometry.slam import camchain_yaml
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry
from tests.calibration.geometry.written import (
    WRITERS,
    MadeRig,
    camchain,
    kalibr,
    made_rig,
    matrices,
    of_chain,
    ros,
    show,
    storage,
)

SMALL = st.floats(-0.05, 0.05)


def both(file: Path) -> list[CameraGeometry]:
    return [load_geometry(file, side) for side in SIDES]


def flat(geometry: CameraGeometry) -> np.ndarray:
    return np.concatenate([each.ravel() for each in matrices(geometry)])


@pytest.mark.parametrize("model", ["radtan", "equidistant"])
@pytest.mark.parametrize("name", WRITERS)
def test_one_rig_has_one_geometry_whoever_writes_it(tmp_path: Path, name: str, model: str) -> None:
    rig = made_rig(model=model)
    (tmp_path / "reference").mkdir()
    reference = both(kalibr(rig, tmp_path / "reference"))
    found = both(WRITERS[name](rig, tmp_path))
    for one, other in zip(found, reference, strict=True):
        assert astuple(one)[:3] == astuple(other)[:3]
        assert flat(one) == pytest.approx(flat(other), abs=1e-9)
    check_pair(found[0], found[1])
    for side, one in zip(SIDES, found, strict=True):
        (tmp_path / f"{side}.yaml").write_text(ros_yaml(one, side))
        assert load_geometry(tmp_path / f"{side}.yaml", side) == one


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    turn=st.tuples(SMALL, SMALL, SMALL), baseline_m=st.floats(0.004, 3.0), bent=st.tuples(SMALL, SMALL, SMALL, SMALL)
)
def test_a_chain_of_ours_is_read_back(tmp_path: Path, turn: Any, baseline_m: float, bent: Any) -> None:
    rig = made_rig(turn, baseline_m)
    rig = replace(rig, d=(list(bent), [0.1 * each for each in bent]))
    left, right = both(kalibr(rig, tmp_path))
    file = tmp_path / "ours.yaml"
    file.write_text(camchain_yaml(left, right, rig.rotation, rig.translation_m))
    assert both(file) == [left, right]
    assert right.baseline_m == pytest.approx(float(np.linalg.norm(rig.translation_m)), rel=1e-9)


def test_the_file_of_opencv_with_rectification_is_taken_as_it_is(tmp_path: Path) -> None:
    rig = made_rig()
    lenses = (rig.matrix(0), np.array(rig.d[0]), rig.matrix(1), np.array(rig.d[1]))
    r1, r2, p1, p2, q, *_ = cv2.stereoRectify(
        *lenses, rig.size, rig.rotation, rig.translation_m.reshape(3, 1), alpha=0.5
    )
    names = dict(zip(("M1", "D1", "M2", "D2"), lenses, strict=True))
    placed = {"R": rig.rotation, "T": rig.translation_m, "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q}
    size = {"image_width": 720, "image_height": 540}
    left, right = both(storage(tmp_path / "all.yml", {**names, **placed, **size}))
    assert left.projection == pytest.approx(p1.ravel())
    assert right.projection == pytest.approx(p2.ravel())
    assert right.rectification == pytest.approx(r2.ravel())


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_one_camera_of_opencv_stands_alone(tmp_path: Path, suffix: str) -> None:
    rig = made_rig()
    content = {
        "image_width": 720,
        "image_height": 540,
        "camera_matrix": rig.matrix(0),
        "flags": 0,
        "a time": "Sun Jan 1",
    }
    content = {key.replace(" ", "_"): value for key, value in content.items()}
    content["distortion_coefficients"] = np.array([[-0.2], [0.05], [0.001], [0.0005], [0.3]])
    geometry = load_geometry(storage(tmp_path / f"one{suffix}", content), "left")
    assert geometry.distortion == (-0.2, 0.05, 0.001, 0.0005, 0.3)
    assert geometry.projection[:3] == geometry.camera_matrix[:3]
    assert (geometry.width, geometry.height) == (720, 540)


@pytest.mark.parametrize(
    ("count", "model"),
    [(4, "plumb_bob"), (5, "plumb_bob"), (8, "rational_polynomial"), (12, "rational_polynomial"), (14, "plumb_bob")],
)
def test_coefficients_are_as_many_as_opencv_writes(tmp_path: Path, count: int, model: str) -> None:
    d = [0.1, 0.02, 0.001, 0.001, 0.01, 0.02, 0.03, 0.04][: 5 if count == 14 else 8]
    content = ros("left") | {"distortion_coefficients": (d + [0.0] * 14)[:count]}
    content.pop("distortion_model")
    file = tmp_path / "left.yaml"
    file.write_text(yaml.safe_dump(content))
    assert load_geometry(file, "left").distortion_model == model


@pytest.mark.parametrize("fisheye", [False, True])
def test_four_coefficients_are_of_a_fisheye_only_if_the_file_says_so(tmp_path: Path, fisheye: bool) -> None:
    rig = made_rig(model="equidistant")
    pair = {"K1": rig.matrix(0), "D1": np.array(rig.d[0]), "K2": rig.matrix(1), "D2": np.array(rig.d[1])}
    one = {"camera_matrix": rig.matrix(0), "distortion_coefficients": np.array(rig.d[0])}
    said = {"fisheye_model": 1} if fisheye else {}
    for name, content in (("pair", pair), ("one", one)):
        found = read_rig(storage(tmp_path / f"{name}.yml", {**content, **said, "image_size": rig.size}))
        models = {lens.distortion_model for lens in found.lenses.values()}
        assert models == {"equidistant" if fisheye else "plumb_bob"}
        assert any("for a fisheye lens, add" in note for note in found.notes) != fisheye


def test_a_message_of_ros_is_read_as_its_tools_print_it(tmp_path: Path) -> None:
    file_content = ros("right")
    for upper in (True, False):
        content = {
            "header": {"seq": 1, "frame_id": "right"},
            "width": 720,
            "height": 540,
            "distortion_model": "plumb_bob",
        }
        for key, name in (
            ("d", "distortion_coefficients"),
            ("k", "camera_matrix"),
            ("r", "rectification_matrix"),
            ("p", "projection_matrix"),
        ):
            content[key.upper() if upper else key] = file_content[name]["data"]
        (tmp_path / "echo.yaml").write_text(yaml.safe_dump(content) + "---\n")
        (tmp_path / "right.yaml").write_text(yaml.safe_dump(file_content))
        assert load_geometry(tmp_path / "echo.yaml", "right") == load_geometry(tmp_path / "right.yaml", "right")


def ini(name: str, content: dict[str, Any]) -> str:
    text = [f"[{name}]"]
    for key, columns in (("camera matrix", 3), ("distortion", 5), ("rectification", 3), ("projection", 4)):
        word = {"camera matrix": "camera_matrix", "distortion": "distortion_coefficients"}.get(key, f"{key}_matrix")
        rows = np.reshape(content[word]["data"], (-1, columns))
        text += ["", key, *(" ".join(repr(float(number)) for number in row) for row in rows)]
    return "\n".join(text)


def test_the_ini_of_ros_is_read_with_one_camera_or_two(tmp_path: Path) -> None:
    head = "# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n720\n\nheight\n540\n\n"
    sections = [ini(f"narrow_stereo/{side}", ros(side)) for side in SIDES]
    pair = tmp_path / "ost.txt"
    pair.write_text(head + "\n\n".join(sections))
    for side, section in zip(SIDES, sections, strict=True):
        (tmp_path / "one.ini").write_text(head + section)
        (tmp_path / "ros.yaml").write_text(yaml.safe_dump(ros(side)))
        expected = load_geometry(tmp_path / "ros.yaml", side)
        assert load_geometry(pair, side) == expected
        assert load_geometry(tmp_path / "one.ini", side) == expected


# Wide lenses.


def maps(geometry: CameraGeometry) -> list[np.ndarray]:
    """Where OpenCV looks in the raw picture for each pixel of the rectified one: columns and rows."""
    (k, d, r, p), size = matrices(geometry), (geometry.width, geometry.height)
    fisheye = geometry.distortion_model == "equidistant"
    init = cv2.fisheye.initUndistortRectifyMap if fisheye else cv2.initUndistortRectifyMap
    return list(init(k, d, r, p[:, :3], size, cv2.CV_32FC1))


def raw(geometry: CameraGeometry, rectified: np.ndarray) -> np.ndarray:
    """The raw pixels of some rectified ones, by OpenCV."""
    u, v = rectified.astype(np.float32).T
    return np.column_stack([cv2.remap(each, u, v, cv2.INTER_LINEAR).ravel() for each in maps(geometry)])


@pytest.mark.parametrize(
    ("size", "focal_px", "model", "d"),
    [
        ((848, 800), 286.0, "equidistant", [-0.005, 0.041, -0.038, 0.0062]),
        ((848, 800), 286.0, "equidistant", [0.0, 0.0, 0.0, 0.0]),
        ((1280, 1024), 330.0, "equidistant", [-0.01, -0.002, 0.001, -0.0005]),
        ((640, 480), 190.0, "equidistant", [0.0, 0.0, 0.0, 0.0]),
        ((752, 480), 458.0, "radtan", [-0.283, 0.074, 0.0002, 0.00002]),
        ((640, 480), 220.0, "radtan", [-0.3, 0.09, 0.0, 0.0]),
        ((640, 480), 220.0, "radtan", [-0.2, 0.01, 0.0, 0.0]),
        ((800, 600), 1800.0, "radtan", [0.0, 0.0, 0.0, 0.0]),
    ],
)
def test_a_wide_pair_keeps_half_of_its_focal_length_and_its_rows(
    size: tuple[int, int], focal_px: float, model: str, d: list[float]
) -> None:
    chain = camchain("none", (0.02, -0.03, 0.01))
    for place, name in enumerate(("cam0", "cam1")):
        k = [focal_px + place, focal_px - place, size[0] / 2 + 4.5, size[1] / 2 - 3.0]
        chain[name] |= {"intrinsics": k, "resolution": list(size), "distortion_model": model, "distortion_coeffs": d}
    left, right = (of_chain(chain, side) for side in SIDES)
    for one in (left, right):
        assert 0.5 * max(one.camera_matrix[0], one.camera_matrix[4]) <= one.projection[0] <= 2.0 * focal_px
        assert one.projection[0] == one.projection[5]
    pose = np.array(chain["cam1"]["T_cn_cnm1"])
    x, y = np.meshgrid(*(np.linspace(-0.3, 0.3, 9) * pixels / focal_px for pixels in size))
    points = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]) * 3.0
    turned = points @ np.reshape(left.rectification, (3, 3)).T
    shown = [
        (projection @ np.column_stack([turned, np.ones(len(turned))]).T).T
        for *_, projection in map(matrices, (left, right))
    ]
    first, second = (seen[:, :2] / seen[:, 2:] for seen in shown)
    here = ((first > 1) & (second > 1) & (first < np.array(size) - 2) & (second < np.array(size) - 2)).all(axis=1)
    assert here.sum() > 20
    assert np.abs(first - second)[:, 1].max() < 1e-9
    of_right = points @ pose[:3, :3].T + pose[:3, 3]
    for one, rectified, seen in ((left, first, points), (right, second, of_right)):
        assert np.abs(raw(one, rectified) - show(one, seen))[here].max() < 0.1


@pytest.mark.parametrize("d", [[-0.28, 0.07, 0.0002, 0.0], [0.1, -0.05, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize("focal_px", [460.0, 1200.0])
def test_all_pixels_are_valid_as_with_opencv(focal_px: float, d: list[float]) -> None:
    chain = camchain("none", (0.0, 0.0, 0.0))
    for name in ("cam0", "cam1"):
        chain[name] |= {"intrinsics": [focal_px, focal_px, 359.5, 269.5], "distortion_model": "radtan"}
        chain[name]["distortion_coeffs"] = d
    left = of_chain(chain)
    lens, pose = matrices(left)[:2], np.array(chain["cam1"]["T_cn_cnm1"])
    _, _, p1, *_ = cv2.stereoRectify(*lens, *lens, (720, 540), pose[:3, :3], pose[:3, 3:].copy(), alpha=0.0)
    assert left.projection[0] == pytest.approx(p1[0, 0], rel=3e-3)
    check_all_valid(left)


@pytest.mark.parametrize("d", [[-0.3, 0.1, 0.0, 0.0], [-0.3, 0.09, 0.002, -0.001], [-0.2, 0.01, 0.0, 0.0]])
def test_all_pixels_are_valid_where_opencv_loses_its_way(d: list[float]) -> None:
    chain = camchain("none", (0.0, 0.0, 0.0))
    for name in ("cam0", "cam1"):
        chain[name] |= {"intrinsics": [300.0, 300.0, 359.5, 269.5], "distortion_model": "radtan"}
        chain[name]["distortion_coeffs"] = d
    left = of_chain(chain)
    assert 150.0 <= left.projection[0] <= 300.0
    check_all_valid(left)


def check_all_valid(geometry: CameraGeometry) -> None:
    x, y = maps(geometry)
    assert -0.6 < x.min() < x.max() < geometry.width - 0.4
    assert -0.6 < y.min() < y.max() < geometry.height - 0.4


def test_a_rectified_pair_without_distortion_stays_as_it_is() -> None:
    chain = camchain("none", (0.0, 0.0, 0.0))
    chain["cam1"]["T_cn_cnm1"] = [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    for name in ("cam0", "cam1"):
        chain[name]["intrinsics"] = [800.0, 800.0, 350.0, 260.0]
    left = of_chain(chain)
    assert np.reshape(left.projection, (3, 4))[:, :3] == pytest.approx(np.reshape(left.camera_matrix, (3, 3)), abs=1e-3)


def test_the_lenses_of_a_pair_may_be_of_two_models() -> None:
    chain = camchain("radtan")
    chain["cam1"] |= {"distortion_model": "equidistant", "distortion_coeffs": [0.01, 0.0, 0.0, 0.0]}
    assert [of_chain(chain, side).distortion_model for side in SIDES] == ["plumb_bob", "equidistant"]


# Models that ROS does not have.

RAYS = np.column_stack([np.repeat(np.linspace(-1, 1, 9), 9), np.tile(np.linspace(-1, 1, 9), 9), np.ones(81)])
"""Up to 54 degrees from the axis."""


def wide(section: dict[str, Any]) -> CameraGeometry:
    return of_chain({name: {**camchain()[name], "resolution": [640, 480], **section} for name in ("cam0", "cam1")})


def away(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angle from the axis, and the direction away from it in the picture."""
    radius = np.hypot(points[:, 0], points[:, 1])
    return np.arctan2(radius, points[:, 2]), points[:, :2] / np.maximum(radius, 1e-12)[:, None]


def stereographic(angle: np.ndarray) -> np.ndarray:
    return 2.0 * np.tan(angle / 2.0)


@pytest.mark.parametrize(
    ("section", "law"),
    [
        # A mirror of xi = 1 is the stereographic projection, of half the focal length; so is a sphere of alpha = 1/2.
        ({"camera_model": "omni", "intrinsics": [1.0, 400.0, 400.0, 320.0, 240.0]}, stereographic),
        ({"camera_model": "eucm", "intrinsics": [0.5, 1.0, 200.0, 200.0, 320.0, 240.0]}, stereographic),
        ({"camera_model": "ds", "intrinsics": [0.0, 0.5, 200.0, 200.0, 320.0, 240.0]}, stereographic),
        ({"camera_model": "omni", "intrinsics": [0.0, 200.0, 200.0, 320.0, 240.0]}, np.tan),
        ({"camera_model": "ds", "intrinsics": [0.0, 0.0, 200.0, 200.0, 320.0, 240.0]}, np.tan),
        (
            {"distortion_model": "fov", "distortion_coeffs": [0.9], "intrinsics": [200.0, 200.0, 320.0, 240.0]},
            lambda angle: np.arctan(2.0 * np.tan(0.45) * np.tan(angle)) / 0.9,
        ),
    ],
)
def test_a_model_that_ros_does_not_have_becomes_equidistant(
    section: dict[str, Any], law: Callable[[np.ndarray], np.ndarray]
) -> None:
    geometry = wide({"distortion_model": "none", "distortion_coeffs": [], **section})
    assert geometry.distortion_model == "equidistant"
    angle, direction = away(RAYS)
    expected = 200.0 * law(angle)[:, None] * direction + (320.0, 240.0)
    inside = ((expected >= 0) & (expected <= (639, 479))).all(axis=1)
    assert inside.sum() >= 25
    assert np.abs(show(geometry, RAYS) - expected)[inside].max() < 0.5


def test_the_mirror_of_a_real_lens_is_read() -> None:
    """Numbers like those of MEI files for 752x480 pixels: some tangential distortion, 72 degrees to the corners."""
    intrinsics, bent = [1.45, 896.0, 897.4, 372.2, 238.3], [-0.344, 0.0623, 0.00126, -0.0002]
    section = {"camera_model": "omni", "intrinsics": intrinsics, "distortion_model": "radtan", "resolution": [752, 480]}
    assert wide({**section, "distortion_coeffs": bent}).camera_matrix[0] == pytest.approx(366.0, abs=2.0)


def test_tangential_distortion_of_a_wide_lens_is_refused_by_its_model_and_misfit() -> None:
    section = {"camera_model": "omni", "intrinsics": [1.0, 400.0, 400.0, 320.0, 240.0], "distortion_model": "radtan"}
    assert wide({**section, "distortion_coeffs": [0.01, -0.002, 0.0001, 0.0]}).distortion_model == "equidistant"
    with pytest.raises(
        ConfigurationError, match=r"cam0: its model is omni, which ROS does not have, .* off by [\d.]+ pix"
    ):
        wide({**section, "distortion_coeffs": [0.01, -0.002, 0.05, 0.0]})


# One camera of the TUM mono data set, of DSO, of VINS-Fusion and of EuRoC.


def test_the_camera_of_the_tum_mono_data_set_is_read(tmp_path: Path) -> None:
    file = tmp_path / "camera.txt"
    file.write_bytes(b"\xef\xbb\xbf0.35 0.4375 0.5 0.5 0.93\r\n1280 1024\r\ncrop\r\n640 480\r\n")
    geometry = load_geometry(file, "left")
    assert (geometry.width, geometry.height, geometry.distortion_model) == (1280, 1024, "equidistant")
    angle, direction = away(RAYS)
    law = np.arctan(2.0 * np.tan(0.465) * np.tan(angle)) / 0.93
    expected = 448.0 * law[:, None] * direction + (639.5, 511.5)
    inside = ((expected >= 0) & (expected <= (1279, 1023))).all(axis=1)
    assert np.abs(show(geometry, RAYS) - expected)[inside].max() < 0.5


@pytest.mark.parametrize(
    ("line", "model", "d"),
    [
        ("Pinhole 860 861 359.5 269.5 0", "plumb_bob", (0, 0, 0, 0, 0)),
        ("860 861 359.5 269.5 0", "plumb_bob", (0, 0, 0, 0, 0)),
        ("RadTan 860 861 359.5 269.5 -0.2 0.05 0.001 0.0005", "plumb_bob", (-0.2, 0.05, 0.001, 0.0005, 0)),
        ("EquiDistant 860 861 359.5 269.5 0.1 0.01 0 0", "equidistant", (0.1, 0.01, 0, 0)),
        ("KannalaBrandt 860 861 359.5 269.5 0.1 0.01 0 0", "equidistant", (0.1, 0.01, 0, 0)),
    ],
)
def test_a_camera_of_dso_is_read(tmp_path: Path, line: str, model: str, d: tuple[float, ...]) -> None:
    file = tmp_path / "camera.txt"
    file.write_text(f"{line}\n720 540\nnone\n720 540\n")
    geometry = load_geometry(file, "left")
    assert (geometry.distortion_model, geometry.distortion) == (model, d)
    assert geometry.camera_matrix == (860, 0, 359.5, 0, 861, 269.5, 0, 0, 1)


def test_a_sensor_of_euroc_is_read(tmp_path: Path) -> None:
    content = {
        "sensor_type": "camera",
        "T_BS": {"cols": 4, "rows": 4, "data": np.eye(4).ravel().tolist()},
        "resolution": [752, 480],
        "camera_model": "pinhole",
        "intrinsics": [458.0, 457.0, 367.0, 248.0],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [-0.283, 0.074, 0.0002, 0.00002],
    }
    file = tmp_path / "sensor.yaml"
    file.write_text("%YAML:1.0\n" + yaml.safe_dump(content))
    assert load_geometry(file, "left").distortion == (-0.283, 0.074, 0.0002, 0.00002, 0.0)
    assert np.allclose(read_rig(file).places["camera"], np.eye(4))


# Numbers as people and programs write them.


@pytest.mark.parametrize(
    ("written", "instead"),
    [
        ("[720, 540]", "['720', '540.0']"),
        ("[861.5, 862.5, 355.5, 266.25]", "'861.5 862.5, 355.5; 2.6625e+02'"),
        ("pinhole", "Pinhole"),
        ("radtan", "radial-tangential"),
        ("cam_overlaps: []", "cam_overlaps: []  \t# none"),
    ],
)
def test_numbers_and_names_are_read_however_they_are_written(tmp_path: Path, written: str, instead: str) -> None:
    file = kalibr(made_rig(), tmp_path)
    text = yaml.safe_dump(yaml.safe_load(file.read_text()), default_flow_style=None, width=999)
    file.write_text(text)
    before = both(file)
    file.write_text(text.replace(written, instead))
    assert both(file) == before


def test_a_rotation_may_be_a_vector(tmp_path: Path) -> None:
    rig = made_rig()
    values = {"K1": rig.matrix(0), "D1": np.array(rig.d[0]), "K2": rig.matrix(1), "D2": np.array(rig.d[1])}
    values |= {"R": cv2.Rodrigues(rig.rotation)[0], "T": rig.translation_m}
    found = both(storage(tmp_path / "om.yml", {**values, "image_size": rig.size}))
    reference = both(kalibr(rig, tmp_path))
    assert flat(found[1]) == pytest.approx(flat(reference[1]), abs=1e-9)


def test_rounding_in_another_program_is_no_baseline(tmp_path: Path) -> None:
    content = ros("left")
    for place in (3, 7, 11, 1):
        content["projection_matrix"]["data"][place] = 1e-12
    content["camera_matrix"]["data"][1] = -1e-14
    file = tmp_path / "left.yaml"
    file.write_text(yaml.safe_dump(content))
    assert load_geometry(file, "left").projection[3] == 0.0
    check_pair(load_geometry(file, "left"), None)


@pytest.mark.parametrize(
    ("baseline_m", "named"),
    [(0.003, True), (0.0051, False), (0.08, False), (0.499, False), (7.5, True), (120.0, True)],
)
def test_a_baseline_that_few_rigs_have_is_named(tmp_path: Path, baseline_m: float, named: bool) -> None:
    left, right = both(kalibr(made_rig(baseline_m=baseline_m), tmp_path))
    check_pair(left, right)
    note = baseline_note(right)
    assert (note is not None) == named
    assert note is None or f"{right.baseline_m:.4g} m" in note


# What is refused.


def spoil(rig: MadeRig, folder: Path, **changes: Any) -> Path:
    values: dict[str, Any] = {
        "K1": rig.matrix(0),
        "D1": np.array(rig.d[0]),
        "K2": rig.matrix(1),
        "D2": np.array(rig.d[1]),
    }
    values |= {"R": rig.rotation, "T": rig.translation_m, "image_size": rig.size} | changes
    return storage(folder / "pair.yml", {key: value for key, value in values.items() if value is not None})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"image_size": None}, "does not say the size of the pictures: add image_size"),
        ({"image_size": (540, 720)}, "the size is 540x720 pixels, but .* in the middle of 720x540: give width before"),
        ({"R": np.array([0.0, 0.0, 0.0, 1.0])}, "R is .*: give a list of 3 or 9 numbers, not 4"),
        ({"T": np.array([0.08, 0.0, 0.0])}, "the right camera is -80 mm to the right of the left one"),
        ({"T": np.array([0.0, -0.08, 0.0])}, "it must be mostly to its right: check which camera is which"),
        ({"T": np.array([-1e300, 0.0, 0.0])}, "T holds -1e.300, which nothing in a calibration is"),
        ({"R": None, "T": None}, "says nothing of where left is"),
        ({"D1": None}, "has K1, but no distortion coefficients of the left camera"),
        ({"D2": np.arange(6.0)}, "K2, D2: distortion_coefficients has 6 numbers: the model has 4, 5, 8, 12, 14"),
        ({"K1": np.eye(3)}, "K1, D1: camera_matrix has focal lengths of 1 and 1 pixels"),
        ({"model": "spline"}, "model is 'spline': only radtan"),
        ({"K1": None, "K2": None, "D1": None}, "says where the cameras are, but has no lens: join it"),
    ],
)
def test_a_pair_of_opencv_that_cannot_be_is_refused_by_key(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"pair.yml: .*{words}") as caught:
        both(spoil(replace(made_rig(), k=([860.0, 860.0, 360.0, 270.0],) * 2), tmp_path, **changes))
    assert len(str(caught.value).replace(str(tmp_path), "")) < 400


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<!DOCTYPE x [<!ENTITY a 'b'>]><opencv_storage><K>&a;</K></opencv_storage>", "is XML with declarations"),
        ("<opencv_storage><a>", "not an XML file: "),
        ("<opencv_storage><a>1</a><a>2</a></opencv_storage>", "the key a appears twice"),
        ("<a>" * 99 + "</a>" * 99, "nested deeper than 16 levels"),
        ("[image]\nwidth\n720\n", "has no section with a camera matrix"),
        ("FOV 1 2 3\n640 480\n", "has no keys|is not valid YAML"),
        ("FOV 1 2 3 4 5 6 7\n640 480\n", "line 1 .* give a list of 5 or 8 numbers, not 7"),
        ("Pinhole 1 2 3 4 0\n640\n", "line 2 is .*: give width and height"),
        ("RadTan 860 861 359.5 269.5 0\n720 540\n", "line 1 has 5 numbers after RadTan"),
        ("model_type: SCARAMUZZA\n", "model_type is 'SCARAMUZZA': only PINHOLE, PINHOLE_FULL, KANNALA_BRANDT, MEI"),
        ("model_type: MEI\n", "the key projection_parameters is missing"),
        ("cam0_calib: none.yaml\n", "none.yaml: cannot be read"),
        ("cam1_calib: a.yaml\ncam0_calib: camera.yaml\n", "the key model_type is missing"),
        ("Camera.type: Rectified\nCamera.fx: 1\n", "Camera.type is 'Rectified', which leaves the lenses out"),
        ("Camera.fx: 1\nCamera.type: PinHole\nCamera.width: 3\n", "the key Camera.height is missing"),
        ("value0: {T_imu_cam: [], intrinsics: []}\n", "has no camera in its keys .'value0'."),
    ],
)
def test_what_is_not_such_a_file_is_refused_in_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_geometry(file, "left")
    said = str(caught.value)
    assert ".yaml: " in said
    assert "\n" not in said
    assert math.isfinite(len(said))
