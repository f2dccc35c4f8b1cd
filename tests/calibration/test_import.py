"""Files of others: sweeps with their exposure times, and `autoexpose calibrate import`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from calibration.geometry.file import check_pair, load_geometry
from calibration.images import image_paths, read_images, timed_files
from calibration.response.file import ResponseFile, read_tum_table, tum_table
from calibration.vignetting.file import VignettingFile
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES
from imaging.response import ResponseFunction
from tests.calibration.command_line import done, refused
from tests.calibration.geometry.written import MadeRig, kalibr, made_rig, ros, storage, vins

GREY = np.arange(64, dtype=np.uint8).reshape(8, 8)


def write(path: Path, pixels: np.typing.NDArray[np.uint8] | np.typing.NDArray[np.uint16] = GREY) -> Path:
    assert cv2.imwrite(str(path), pixels)
    return path


def write_exif(path: Path, seconds: float, f_number: float | IFDRational = 2.8, iso: int = 100) -> None:
    image = Image.fromarray(GREY)
    exif = image.getexif()
    exif.get_ifd(0x8769).update({0x829A: seconds, 0x829D: f_number, 0x8827: iso})
    image.save(path, exif=exif.tobytes())


def times_us(source: Path) -> list[float]:
    return [shot.setting.exposure_time_us for shot in read_images(source).shots]


@pytest.mark.parametrize(
    ("name", "expected_us"),
    [
        ("img_0.0333s.png", 33_300),
        ("img_5000us.png", 5000),
        ("wall-2.5ms-b.tif", 2500),
        ("left3_20us.png", 20),
        ("2s.png", 2_000_000),
    ],
)
def test_names_tell_times(tmp_path: Path, name: str, expected_us: float) -> None:
    write(tmp_path / name)
    assert times_us(tmp_path) == pytest.approx([expected_us])


def test_exif_tells_times_in_the_order_of_names(tmp_path: Path) -> None:
    for name, seconds in (("b.jpg", 0.5), ("a.jpg", 2.0), ("c.png", 0.001)):
        write_exif(tmp_path / name, seconds)
    assert times_us(tmp_path) == pytest.approx([2e6, 5e5, 1e3])


def test_an_f_number_that_the_camera_does_not_know_is_the_same_in_all_images(tmp_path: Path) -> None:
    for name, seconds in (("a.jpg", 0.5), ("b.jpg", 0.25)):
        write_exif(tmp_path / name, seconds, f_number=IFDRational(0, 0))
    assert times_us(tmp_path) == pytest.approx([5e5, 2.5e5])


def test_a_list_of_names_and_times_goes_by_its_own_order(tmp_path: Path) -> None:
    for name in ("a.png", "with space.png"):
        write(tmp_path / name)
    (tmp_path / "list.txt").write_text("# seconds\nwith space.png 1/30\n\na.png 0.25  # the bright one\n")
    assert times_us(tmp_path / "list.txt") == pytest.approx([1e6 / 30, 250_000])


def test_times_alone_go_by_the_order_of_files(tmp_path: Path) -> None:
    for name in ("b.png", "a.png"):
        write(tmp_path / name)
    (tmp_path / "times.txt").write_text("0.5\n2")
    assert times_us(tmp_path / "times.txt") == pytest.approx([5e5, 2e6])


def test_depth_and_colour(tmp_path: Path) -> None:
    write(tmp_path / "1ms.png", np.full((8, 8), 4095, np.uint16))
    assert read_images(tmp_path).shots[0].bit_depth == 12
    write(tmp_path / "2ms.png", np.full((8, 8), 4096, np.uint16))
    assert [shot.bit_depth for shot in read_images(tmp_path).shots] == [16, 16]
    for path in tmp_path.iterdir():
        path.unlink()
    write(tmp_path / "1ms.png", np.stack([GREY, GREY + 50, GREY + 100], axis=2))
    shot = read_images(tmp_path).shots[0]
    assert shot.bit_depth == 8
    assert np.array_equal(shot.pixels, GREY + 50)  # green


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "list.txt: is empty"),
        ("a.png 0.1\nb.png fast", "list.txt: line 2: 'fast' is not an exposure time"),
        ("a.png 0.1\n\nb.png 0", "list.txt: line 3: '0' is not an exposure time"),
        ("a.png nan", "list.txt: line 1: 'nan' is not an exposure time"),
        ("a.png 0.1\nc.png 0.2", "list.txt: line 2: there is no image .*c.png"),
        ("a.png 0.1\na.png 0.2", "list.txt: line 2: names a.png again"),
        ("a.png 0.1\n0.2", "list.txt: line 2: names no image"),
        ("0.1\n0.2\n0.3", "list.txt: has 3 times, but 2 images lie next to it"),
    ],
)
def test_mistakes_in_lists_are_named(tmp_path: Path, text: str, message: str) -> None:
    for name in ("a.png", "b.png"):
        write(tmp_path / name)
    (tmp_path / "list.txt").write_text(text)
    with pytest.raises(ConfigurationError, match=message) as error:
        read_images(tmp_path / "list.txt")
    assert "\n" not in str(error.value)


def test_a_folder_that_cannot_be_read_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"gone: cannot be read \(No such file or directory\)"):
        image_paths(tmp_path / "gone")


def test_mistakes_in_folders_are_named(tmp_path: Path) -> None:
    def refusal() -> str:
        with pytest.raises(ConfigurationError) as error:
            read_images(tmp_path)
        return str(error.value)

    assert "holds no images" in refusal()
    write(tmp_path / "a.png")
    assert "a.png: has no exposure time" in refusal()
    (tmp_path / "a.png").rename(tmp_path / "a_2ms_3ms.png")
    assert "a_2ms_3ms.png: its name has 2 exposure times" in refusal()
    (tmp_path / "a_2ms_3ms.png").rename(tmp_path / "0us.png")
    assert "0us.png: its name has an exposure time of 0" in refusal()
    (tmp_path / "0us.png").write_bytes(b"no image")
    assert "0us.png: is not a readable image" in refusal()
    write(tmp_path / "0us.png").rename(tmp_path / "1ms.png")
    write(tmp_path / "2ms.png", np.zeros((8, 9), np.uint8))
    assert "2ms.png: is 9x8 pixels of 8 bits, 1ms.png is 8x8 pixels of 8 bits" in refusal()


def test_other_changes_than_of_time_are_refused(tmp_path: Path) -> None:
    write_exif(tmp_path / "a.jpg", 0.1)
    write_exif(tmp_path / "b.jpg", 0.2, f_number=4.0)
    with pytest.raises(ConfigurationError, match=r"b.jpg: its f-number is 4, that of a.jpg 2.8"):
        read_images(tmp_path)
    write_exif(tmp_path / "b.jpg", 0.2, iso=400)
    with pytest.raises(ConfigurationError, match=r"b.jpg: its ISO sensitivity is 400, that of a.jpg 100"):
        read_images(tmp_path)


@pytest.mark.parametrize("content", [None, b"\xff\xfe\x00"])
def test_a_source_that_is_neither_folder_nor_text_is_refused(tmp_path: Path, content: bytes | None) -> None:
    if content:
        (tmp_path / "list").write_bytes(content)
    with pytest.raises(ConfigurationError, match=r"list: (cannot be read|is not text)"):
        read_images(tmp_path / "list")


def test_a_damaged_image_in_a_list_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no image")
    (tmp_path / "list.txt").write_text("a.png 1")
    with pytest.raises(ConfigurationError, match=r"a.png: is not a readable image of 8 or 16 bits"):
        read_images(tmp_path / "list.txt")


@pytest.mark.parametrize(
    "text",
    [
        "a.png,0.01\nb.png,0.02\n",
        "a.png; 10ms\nb.png; 20 ms\n",
        "b.png\t1/50\na.png\t1/100 s\n",
        "filename,exposure_time_ms\na.png,10\nb.png,20\n",
        "timestamp,exposure (us),image file,gain\n17.5,10000,a.png,0\n18.5,20000,b.png,0\n",
        '"Name";"Shutter speed"\n"a.png";"1/100"\n"b.png";"1/50"\n',
        "exposure_us,\n10000,\n20000,\n",
        "time_s\n0.01\n0.02\n",
    ],
)
def test_tables_as_people_write_them(tmp_path: Path, text: str) -> None:
    for name in ("a.png", "b.png"):
        write(tmp_path / name)
    (tmp_path / "list.csv").write_text(text, encoding="utf-8-sig", newline="\r\n")
    assert sorted(times_us(tmp_path / "list.csv")) == pytest.approx([1e4, 2e4])


@pytest.mark.parametrize("source", [".", "times.txt"])
def test_a_sweep_of_the_tum_mono_data_set(tmp_path: Path, source: str) -> None:
    (tmp_path / "images").mkdir()
    for number in ("00000", "00001"):
        write(tmp_path / "images" / f"{number}.jpg")
    (tmp_path / "times.txt").write_text("00000 1460394400.5 0.05\n00001 1460394400.6 19.5\n")
    assert times_us(tmp_path / source) == pytest.approx([50, 19_500])
    (tmp_path / "images" / "00001.jpg").unlink()
    with pytest.raises(ConfigurationError, match=r"times.txt: line 2: there is no image .*images/00001: unpack"):
        read_images(tmp_path / source)


def test_a_short_line_of_a_table_is_named(tmp_path: Path) -> None:
    write(tmp_path / "a.png")
    (tmp_path / "list.csv").write_text("file,exposure_ms\na.png\n")
    with pytest.raises(ConfigurationError, match=r"list.csv: line 2: has 1 columns"):
        read_images(tmp_path / "list.csv")


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
    check_pair(pair["left"], pair["right"])
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
        ("vignette.png", "", "cannot be read|has no keys"),
        ("times.txt", "00000 1434039085.73\n", "line 1: has no exposure time"),
        ("times.txt", "00000 1.5 2\n00001 1.6 x\n", "line 2: has no exposure time"),
        ("times.txt", "7 1.5 2\n", "there is no image"),
        ("none.txt", None, "none.txt: cannot be read"),
        ("camera.txt", "\x00\x01\x02", "is not valid YAML"),
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
