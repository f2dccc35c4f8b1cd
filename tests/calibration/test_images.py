"""Sweeps from files: exposure times from EXIF, names and lists, and every mistake one sentence."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from calibration.images import image_paths, read_images
from imaging.errors import ConfigurationError
from tests.calibration.sweeps import TIMES_US, Bench, solve_response

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


def test_images_written_and_read_give_the_curve(tmp_path: Path) -> None:
    for shot in Bench("gamma").sweep(TIMES_US, frames=1).shots:
        write(tmp_path / f"img_{shot.setting.exposure_time_us:.2f}us.png", shot.pixels)
    solution = solve_response(read_images(tmp_path))
    assert solution.model == "gamma"
    assert solution.parameters["gamma"] == pytest.approx(1 / 2.2, rel=0.01)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "list.txt: is empty"),
        ("# only this", "list.txt: is empty"),
        ("a.png 0.1\nb.png fast", "list.txt: line 2: 'fast' is not an exposure time"),
        ("a.png 0.1\n\nb.png 0", "list.txt: line 3: '0' is not an exposure time"),
        ("a.png 1/0", "list.txt: line 1: '1/0' is not an exposure time"),
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
