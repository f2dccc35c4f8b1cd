"""`autoexpose calibrate import` as a user meets it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from calibration.geometry.file import check_pair, load_geometry
from calibration.images import timed_files
from calibration.response.file import ResponseFile, read_tum_table, tum_table
from calibration.vignetting.file import VignettingFile
from imaging.errors import ConfigurationError
from imaging.frames import SIDES
from imaging.response import ResponseFunction
from tests.calibration.command_line import done, refused
from tests.calibration.geometry.written import MadeRig, kalibr, made_rig, ros, storage, vins


def imported(folder: Path, *arguments: object) -> tuple[str, ...]:
    """The arguments to import into a folder `out`."""
    return ("import", *map(str, arguments), "-o", str(folder / "out"))


def test_a_chain_becomes_the_files_of_a_pair(tmp_path: Path) -> None:
    chain = kalibr(made_rig(), tmp_path)
    output = done(*imported(tmp_path, chain))
    for side in SIDES:
        assert load_geometry(tmp_path / "out" / f"{side}.yaml", side) == load_geometry(chain, side)
        assert f"cameras.{side}.calibration: {tmp_path}/out/{side}.yaml" in output
    assert "a chain of Kalibr: cam0, cam1, 720x540 pixels" in output
    assert "baseline: 80.0312 mm" in output
    done(*imported(tmp_path, chain))
    (tmp_path / "out" / "left.yaml").write_text("mine: 1\n")
    assert "it is not a calibration file to replace" in refused(*imported(tmp_path, chain))


def halves(rig: MadeRig, folder: Path, unit_m: float) -> list[Path]:
    """What OpenCV's sample of a stereo calibration writes."""
    lenses = rig.matrix(0), np.array([rig.d[0]]), rig.matrix(1), np.array([rig.d[1]])
    t = rig.translation_m.reshape(3, 1) / unit_m
    r1, r2, p1, p2, q, *_ = cv2.stereoRectify(*lenses, rig.size, rig.rotation, t, alpha=0.0)
    placed = {"R": rig.rotation, "T": t, "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q}
    intrinsics = dict(zip(("M1", "D1", "M2", "D2"), lenses, strict=True))
    return [storage(folder / "intrinsics.yml", intrinsics), storage(folder / "extrinsics.yml", placed)]


def test_the_two_files_of_opencvs_sample_are_joined(tmp_path: Path) -> None:
    rig = made_rig()
    files = halves(rig, tmp_path, 0.001)
    assert "say --size" in refused(*imported(tmp_path, *files))
    output = done(*imported(tmp_path, *files, "--size", "720x540", "--unit", "mm"))
    right = load_geometry(tmp_path / "out" / "right.yaml", "right")
    assert right.baseline_m == pytest.approx(float(np.linalg.norm(rig.translation_m)), rel=1e-9)
    assert "note:" not in output
    assert "note: the baseline is 80.03 m" in done(*imported(tmp_path, *reversed(files), "--size", "720x540"))


def test_two_cameras_of_ros_and_two_sensors_of_euroc_become_a_pair(tmp_path: Path) -> None:
    for side in SIDES:
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(ros(side)))
    done(*imported(tmp_path, tmp_path / "left.yaml", tmp_path / "right.yaml"))
    assert load_geometry(tmp_path / "out" / "right.yaml", "right") == load_geometry(tmp_path / "right.yaml", "right")
    assert "would be replaced: choose another folder" in refused(
        "import", str(tmp_path / "left.yaml"), "-o", str(tmp_path)
    )
    rig = made_rig()
    sensors = []
    for side, body in enumerate((np.eye(4), np.linalg.inv(rig.pose))):
        (tmp_path / f"cam{side}").mkdir()
        content = {"T_BS": {"rows": 4, "cols": 4, "data": body.ravel().tolist()}, "intrinsics": rig.k[side]}
        content |= {"resolution": [720, 540], "camera_model": "pinhole", "distortion_model": "radial-tangential"}
        sensors.append(tmp_path / f"cam{side}" / "sensor.yaml")
        sensors[-1].write_text(yaml.safe_dump(content | {"distortion_coefficients": rig.d[side]}))
    done(*imported(tmp_path, *sensors))
    pair = {side: load_geometry(tmp_path / "out" / f"{side}.yaml", side) for side in SIDES}
    check_pair(pair)
    (tmp_path / "k").mkdir()
    assert pair["right"].projection == pytest.approx(
        load_geometry(kalibr(rig, tmp_path / "k"), "right").projection, abs=1e-9
    )


def test_cameras_of_a_chain_are_chosen(tmp_path: Path) -> None:
    chain = kalibr(made_rig(), tmp_path)
    content = yaml.safe_load(chain.read_text())
    pose = np.linalg.inv(np.array(content["cam1"].pop("T_cn_cnm1")))
    chain.write_text(yaml.safe_dump({"cam0": content["cam1"], "cam1": content["cam0"] | {"T_cn_cnm1": pose.tolist()}}))
    assert "--cameras LEFT,RIGHT" in refused(*imported(tmp_path, chain))
    done(*imported(tmp_path, chain, "--cameras", "cam1,cam0"))
    assert load_geometry(tmp_path / "out" / "left.yaml", "left").camera_matrix[0] == 861.5


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    """A set as of the TUM mono data set."""
    folder = tmp_path / "tum"
    (folder / "images").mkdir(parents=True)
    (folder / "camera.txt").write_text("0.35 0.4375 0.5 0.5 0.93\n1280 1024\ncrop\n640 480\n")
    (folder / "pcalib.txt").write_text(" ".join(str(255 * (grey / 255) ** 1.8) for grey in range(256)) + " \n")
    y, x = np.mgrid[:512, :640]
    light = (1 + ((x - 330) ** 2 + (y - 250) ** 2) / 400.0**2) ** -2.0
    cv2.imwrite(str(folder / "vignette.png"), (65535 * light).astype(np.uint16))
    for number in range(3):
        cv2.imwrite(str(folder / "images" / f"{number:05}.jpg"), np.zeros((8, 8), np.uint8))
    (folder / "times.txt").write_text("".join(f"{n:05} {1434039085.73 + n} {2.5 * (n + 1)}\n" for n in range(3)))
    return folder


def test_a_set_of_the_tum_mono_data_set_becomes_our_files(tum: Path, tmp_path: Path) -> None:
    names = ("camera.txt", "pcalib.txt", "vignette.png", "times.txt")
    output = done(*imported(tmp_path, *(tum / name for name in names), "--side", "right"))
    out = tmp_path / "out"
    response = ResponseFile.load(out / "right.response.yaml").response
    greys = np.arange(1, 256)
    assert response.light(greys.astype(float)) == pytest.approx((greys / 255) ** 1.8, rel=1e-4)
    vignetting = VignettingFile.load(out / "right.vignetting.yaml")
    truth = cv2.imread(str(tum / "vignette.png"), cv2.IMREAD_UNCHANGED) / 65535
    light = vignetting.vignetting.relative_light(512, 640)
    assert np.abs(light / light.mean() / truth * truth.mean() - 1).max() < max(2 * vignetting.error, 0.005)
    assert load_geometry(out / "right.yaml", "right").distortion_model == "equidistant"
    assert [file.exposure_s for file in timed_files(out / "images.txt")] == pytest.approx([0.0025, 0.005, 0.0075])
    for key in ("calibration", "response", "vignetting"):
        assert f"cameras.right.{key}: {out}/right." in output


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("pcalib.txt", "1 2 3 " * 80, "has 240 numbers: give 256"),
        ("pcalib.txt", "0 " + "1 " * 255, ""),
        ("pcalib.txt", "0 2 1 " + " ".join(map(str, range(3, 256))), "must rise from one grey level to the next"),
        ("pcalib.txt", "0 " * 256, "its numbers do not rise"),
        ("pcalib.txt", "0 nan " + " ".join(map(str, range(2, 256))), "has no keys|must rise|not a YAML"),
        ("vignette.png", "", "cannot be read|has no keys"),
        ("times.txt", "00000 1434039085.73\n", "line 1: has no exposure time"),
        ("times.txt", "00000 1434039085.73 x\n", "has no keys"),
        ("times.txt", "00000 1.5 2\n00001 1.6 x\n", "line 2: has no exposure time"),
        ("times.txt", "7 1.5 2\n", "there is no image"),
        ("none.txt", None, "none.txt: cannot be read"),
        ("camera.txt", "\x00\x01\x02", "not a YAML file"),
    ],
)
def test_a_bad_file_is_refused_by_name_and_nothing_is_written(
    tum: Path, tmp_path: Path, name: str, content: str | None, words: str
) -> None:
    if content is not None:
        (tum / name).write_text(content)
    if not words:
        done(*imported(tmp_path, tum / name))
        return
    output = refused(*imported(tmp_path, tum / name))
    assert any(word in " ".join(output.split()) for word in words.split("|")), output
    assert name in output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size", "720"], "--size 720: give width x height"),
        (["--cameras", "cam0"], "--cameras cam0: give two of cam0, cam1"),
        (["--cameras", "cam0,cam7"], "the key cam7 is missing: it has cam0, cam1"),
    ],
)
def test_a_bad_option_is_refused(tmp_path: Path, arguments: list[str], words: str) -> None:
    assert words in refused(*imported(tmp_path, kalibr(made_rig(), tmp_path), *arguments))


def test_files_that_contradict_each_other_or_know_too_little_are_refused(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    one, other = kalibr(made_rig(), tmp_path / "a"), kalibr(made_rig(model="equidistant"), tmp_path / "b")
    assert "cam0 is in another of these files too, with other numbers: leave it out" in refused(
        *imported(tmp_path, one, other)
    )
    vins(made_rig(), tmp_path)
    assert "says nothing of where left is" in refused(
        *imported(tmp_path, tmp_path / "cam0_pinhole.yaml", tmp_path / "cam1_pinhole.yaml")
    )
    assert "no file has a lens" in refused(*imported(tmp_path, halves(made_rig(), tmp_path, 1.0)[1]))


@pytest.mark.parametrize("black_level", [0, 16])
def test_a_table_that_we_export_is_read_back(black_level: int) -> None:
    response = ResponseFunction.linear(black_level)
    found = read_tum_table(tum_table(response))
    assert (found.black_level, found.saturation) == (black_level, 255)
    greys = np.arange(black_level, 256)
    assert found.inverse(greys) == pytest.approx(response.inverse(greys), abs=2e-3)


def test_a_table_may_be_in_any_unit_and_between_commas() -> None:
    text = "\n".join(f"{grey * 1e-4}," for grey in range(256))
    assert read_tum_table(text).inverse(np.array([51])) == pytest.approx(np.log2(0.2))
    with pytest.raises(ConfigurationError, match="holds what is no number"):
        read_tum_table("x " * 256)
