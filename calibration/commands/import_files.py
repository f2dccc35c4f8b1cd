"""The command `autoexpose calibrate import`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from calibration.commands.rig import check_place, make_folder, print_written
from calibration.document import located, written
from calibration.geometry.file import check_pair, load_geometry, read_rigs
from calibration.geometry.numbers import baseline_note
from calibration.geometry.opencv import ros_yaml
from calibration.geometry.rig import RigGeometry, joined
from calibration.geometry.slam import is_times_txt
from calibration.images import read_tum_times
from calibration.response.file import ResponseFile, is_tum_table, read_tum_table
from calibration.vignetting.file import VignettingFile, read_vignette_picture
from documents.command_line import AsJson, CommandOutput
from documents.files import SIGNATURE, open_regular, read_text, replace_file
from imaging.errors import ConfigurationError
from imaging.geometry import SIDES, CameraGeometry, Side

TIMES = "images.txt"
_MOST_TIMES_BYTES = 1 << 24


@dataclass(slots=True)
class Imported:
    """What the files give: our own files by name, what each is said to be, and keys of the configuration."""

    texts: dict[str, str] = field(default_factory=dict)
    files: dict[str, ResponseFile | VignettingFile] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)
    keys: dict[str, str] = field(default_factory=dict)


def take_photometric(path: Path, side: Side, found: Imported) -> bool:
    """Take a file of the TUM mono data set that is not about geometry; False if it is none.

    Raises ConfigurationError naming the file and the line.
    """
    if _begins_as_png(path):
        vignetting = read_vignette_picture(path)
        lens = vignetting.vignetting
        _take(found, f"{side}.vignetting.yaml", f"cameras.{side}.vignetting", vignetting)
        corner = lens.relative_light(len(lens.grid), len(lens.grid[0]))[[0, 0, -1, -1], [0, -1, 0, -1]].min()
        found.said.append(
            f"{path}: light of each pixel, {lens.width}x{lens.height}: {corner:.2f} in the darkest corner, its grid "
            f"off by at most {vignetting.error:.1%}"
        )
        return True
    text = read_text(path, _MOST_TIMES_BYTES)
    if is_tum_table(text):
        with located(path):
            response = read_tum_table(text)
        _take(found, f"{side}.response.yaml", f"cameras.{side}.response", ResponseFile(response))
        black, full = response.black_level, response.saturation
        found.said.append(f"{path}: response, 256 grey levels, black level {black}, saturation {full}")
        return True
    if is_times_txt(text):
        images = read_tum_times(path)
        found.texts[TIMES] = "".join(f"{image.resolve()} {seconds:.9g}\n" for image, seconds in images)
        found.said.append(f"{path}: exposure times of {len(images)} images")
        return True
    return False


def _take(found: Imported, name: str, key: str, file: ResponseFile | VignettingFile) -> None:
    if name in found.files:
        raise ConfigurationError(f"two of the files are {key}: import them one by one, with --side")
    found.files[name], found.keys[key] = file, name


def _begins_as_png(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(len(SIGNATURE)) == SIGNATURE
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error


UNITS_M: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def import_files(
    context: typer.Context,
    files: Annotated[list[Path], typer.Argument(help="Calibrations of other programs, for one camera or a pair.")],
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="A folder for our files.")],
    side: Annotated[Literal["left", "right"], typer.Option(help="Whose a file of one camera is.")] = "left",
    cameras: Annotated[str | None, typer.Option(help="Which of a file's cameras: LEFT,RIGHT, as cam1,cam0.")] = None,
    size: Annotated[str | None, typer.Option(help="Size of the pictures, if no file says it, as 720x540.")] = None,
    unit: Annotated[Literal["m", "cm", "mm"], typer.Option(help="Unit of lengths in the files.")] = "m",
    as_json: AsJson = False,
) -> None:
    """Turn calibrations of Kalibr, OpenCV, ROS, VINS-Fusion, ORB-SLAM, EuRoC and TUM into files for the daemon."""
    console = CommandOutput(context, as_json)
    found = Imported()
    geometries: list[Path] = []
    for path in dict.fromkeys(files):
        if not take_photometric(path, side, found):
            geometries.append(path)
    if geometries:
        rigs = {name: rig.scaled(UNITS_M[unit]) for name, rig in read_rigs(geometries, _size(size)).items()}
        _add_geometry(rigs, side, cameras, found)
    make_folder(output)
    _check_places(output, found, files)
    for name, file in found.files.items():
        file.save(output / name)
    for name, text in found.texts.items():
        with written(output / name):
            replace_file(output / name, text.encode())
    console.document["said"] = found.said
    for line in found.said:
        console.say(line)
    keys = {key: output / name for key, name in found.keys.items()}
    print_written(console, *(output / name for name in (*found.texts, *found.files)), keys=keys)
    if TIMES in found.texts:
        command = f"autoexpose calibrate response --images {output / TIMES} -o {output}/{side}.response.yaml"
        console.say(f"to measure the response: {command}")


def _add_geometry(rigs: Mapping[str, RigGeometry], side: Side, cameras: str | None, found: Imported) -> None:
    rig = joined(rigs)
    for path, one in rigs.items():
        sizes = {f"{lens.width}x{lens.height} pixels" for lens in one.lenses.values()}
        found.said.append(f"{path}: {one.kind}{': ' if one.lenses else ''}{', '.join((*one.lenses, *sizes))}")
        found.said += [f"{path}: {note}" for note in one.notes]
    names = list(rig.lenses)
    if cameras is not None:
        names = cameras.split(",")
        if len(names) != len(SIDES):
            raise ConfigurationError(f"--cameras {cameras}: give two of {', '.join(rig.lenses)}, as LEFT,RIGHT")
    if not names:
        raise ConfigurationError(f"{', '.join(rigs)}: no file has a lens: give the one that has, too")
    with located(", ".join(rigs)):
        if len(names) == 1:
            geometries: dict[Side, CameraGeometry] = {side: rig.lenses[names[0]]}
        else:
            geometries = dict(zip(SIDES, rig.pair(*names[:2]), strict=True))
            check_pair(geometries["left"], geometries["right"])
    for of, geometry in geometries.items():
        found.texts[f"{of}.yaml"] = ros_yaml(geometry, of)
        found.keys[f"cameras.{of}.calibration"] = f"{of}.yaml"
    if len(names) > 1:
        _describe_pair(geometries, names, found)


def _describe_pair(geometries: Mapping[Side, CameraGeometry], names: Sequence[str], found: Imported) -> None:
    left, right = geometries["left"], geometries["right"]
    found.said.append(f"{names[0]} is the left camera, {names[1]} the right one")
    found.said.append(
        f"baseline: {1e3 * right.baseline_m:.6g} mm; focal length {left.camera_matrix[0]:.6g} pixels, "
        f"{left.projection[0]:.6g} once rectified"
    )
    if (note := baseline_note(right)) is not None:
        found.said.append(f"note: {note}")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    if (parts := re.fullmatch(r"([1-9]\d{0,4})x([1-9]\d{0,4})", text)) is None:
        raise ConfigurationError(f"--size {text}: give width x height in pixels, as 720x540")
    return int(parts[1]), int(parts[2])


def _check_places(output: Path, found: Imported, sources: Sequence[Path]) -> None:
    """Refuse to replace anything but former files of the same kind."""
    for path in (output / name for name in (*found.texts, *found.files)):
        if path.resolve() in [source.resolve() for source in sources]:
            raise ConfigurationError(f"{path}: is read, and would be replaced: choose another folder")
    for side in SIDES:
        if f"{side}.yaml" in found.texts:
            check_place(output / f"{side}.yaml", partial(load_geometry, side=side), "calibration file")
    for name, file in found.files.items():
        kind = "response file" if isinstance(file, ResponseFile) else "vignetting file"
        check_place(output / name, type(file).load, kind)
