"""The commands `autoexpose calibrate geometry` and `board`."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from numpy.typing import NDArray
from rich.live import Live
from rich.progress import track

from calibration.commands.rig import (
    CameraMode,
    Cameras,
    check_place,
    check_rig,
    chosen_rig,
    keys_of,
    make_folder,
    print_judged,
    print_written,
)
from calibration.document import written
from calibration.geometry.board import (
    DEFAULT_DICTIONARY,
    ENOUGH_VIEWS,
    MARKER_SHARE,
    Board,
    BoardFinder,
    BoardView,
    Capture,
)
from calibration.geometry.file import load_geometry
from calibration.geometry.fit import GeometryResult, calibrate_geometry
from calibration.geometry.opencv import ros_yaml
from calibration.geometry.slam import camchain_yaml
from calibration.images import image_paths, read_grey8
from calibration.report import check_extra, geometry_facts, write_geometry_report
from calibration.session import RATE_HZ, SLOWEST_HZ, PairOfCameras, Session, whole_grey8
from documents.command_line import AsJson, CommandOutput, ConfigFile, ConfigOption
from documents.files import replace_file
from drivers.aravis import open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.geometry import SIDES, Side

CAMCHAIN, REPORT = "camchain.yaml", "geometry.html"
_SOURCES = "--config, --camera (twice), and --left with --right"
_SIDES = [CameraMode("", side) for side in SIDES]  # of folders of pictures
FILES: Mapping[Side, str] = {"left": "left.yaml", "right": "right.yaml"}

Squares = Annotated[str, typer.Option(help="Columns x rows of the board's squares.")]
SquareMm = Annotated[float, typer.Option(help="Side of a square, measured on the paper (mm).")]
MarkerMm = Annotated[float | None, typer.Option(help="Side of a marker (mm); 0.7 of a square unless given.")]
Dictionary = Annotated[str, typer.Option(help="Dictionary of the markers, by OpenCV's name.")]


def geometry(
    context: typer.Context,
    config_file: ConfigFile = None,
    *,
    output: Annotated[Path, typer.Option("-o", "--output", help="A folder for the calibration files and the report.")],
    camera: Cameras = None,
    config: ConfigOption = None,
    left: Annotated[Path | None, typer.Option(help="Without cameras: a folder of the left one's pictures.")] = None,
    right: Annotated[Path | None, typer.Option(help="And the right camera's, with the same names.")] = None,
    squares: Squares = "9x6",
    square_mm: SquareMm = 30.0,
    marker_mm: MarkerMm = None,
    dictionary: Dictionary = DEFAULT_DICTIONARY,
    as_json: AsJson = False,
) -> None:
    """Measure the lenses and the baseline of a stereo pair with a ChArUco board, for ROS and Kalibr."""
    check_extra()
    console = CommandOutput(context, as_json)
    board = board_of(squares, square_mm, marker_mm, dictionary)
    rig = chosen_rig(camera, config_file, config, left or right, options=_SOURCES)
    _check_output(output)
    if rig:
        result = from_cameras(board, rig, console)
    elif left is None or right is None:
        raise ConfigurationError("--left and --right belong together: give a folder of pictures for each camera")
    else:
        result = from_folders(board, left, right, console)
    _keep(result, output, rig, console)
    if result.verdict == "refused":
        raise typer.Exit(1)


def board_of(squares: str, square_mm: float, marker_mm: float | None, dictionary: str) -> Board:
    """The board that the options describe; raises ConfigurationError."""
    if (parts := re.fullmatch(r"(\d{1,3})x(\d{1,3})", squares)) is None:
        raise ConfigurationError(f"--squares {squares!r}: give columns x rows, such as 9x6")
    marker_mm = MARKER_SHARE * square_mm if marker_mm is None else marker_mm
    return Board(int(parts[1]), int(parts[2]), square_mm * 1e-3, marker_mm * 1e-3, dictionary)


def from_folders(board: Board, left: Path, right: Path, console: CommandOutput) -> GeometryResult:
    """Calibrate from pictures in two folders, paired by name."""
    folders: dict[Side, Path] = {"left": left, "right": right}
    paths: dict[Side, list[Path]] = {}
    for side, folder in folders.items():
        if not folder.is_dir():
            raise ConfigurationError(f"--{side} {folder}: is not a folder: give one of pictures")
        paths[side] = image_paths(folder)
    names = {side: [path.stem for path in found] for side, found in paths.items()}
    if names["left"] != names["right"] or not names["left"]:
        only = sorted(set(names["left"]) ^ set(names["right"]))
        odd = f"only one has {only[0]}" if only else "there are none, or some names appear twice"
        raise ConfigurationError(
            f"{left} and {right}: hold {len(names['left'])} and {len(names['right'])} pictures, and {odd}: give the "
            "two pictures of each moment the same name"
        )
    finders: dict[Side, BoardFinder] = {side: BoardFinder(board) for side in SIDES}
    views, size, first = [], (0, 0), paths["left"][0]
    pairs = list(zip(paths["left"], paths["right"], strict=True))
    for pair in track(pairs, "looking for the board", console=console, disable=not console.is_terminal):
        corners = {}
        for side, path in zip(SIDES, pair, strict=True):
            grey = read_grey8(path)
            here = (grey.shape[1], grey.shape[0])
            size = size if any(size) else here
            if here != size:
                raise ConfigurationError(
                    f"{path}: is {here[0]}x{here[1]} pixels, {first} is {size[0]}x{size[1]}: take all with one size"
                )
            if (found := finders[side].find(grey)) is not None:
                corners[side] = found
        if corners:
            views.append(BoardView(pair[0].stem, corners))
    return calibrate_geometry(board, views, size, instead=_instead(finders))


def from_cameras(board: Board, rig: Sequence[CameraMode], console: CommandOutput) -> GeometryResult:
    """Calibrate two cameras live, showing what is covered."""
    if len(rig) != len(SIDES):
        raise ConfigurationError(f"a pair has two cameras, left and right: {len(rig)} given")
    check_rig(rig)
    with ExitStack() as opened:
        sessions: dict[Side, Session] = {}
        for side, mode in zip(SIDES, rig, strict=True):
            sessions[side] = opened.enter_context(Session(open_camera(mode.serial, mode.setup(_rate_hz(mode)))))
        pair = PairOfCameras(sessions)
        first = pair.next_pair()
        shapes = {side: frame.pixels.shape[:2] for side, frame in first.items()}
        if shapes["left"] != shapes["right"]:
            (h, w), (height, width) = shapes["left"], shapes["right"]
            raise ConfigurationError(f"left sends {w}x{h} pixels, right {width}x{height}: set both to one size")
        size = (shapes["left"][1], shapes["left"][0])
        capture = Capture(board, size)
        serials = {side: session.description.serial for side, session in sessions.items()}
        try:
            with Live(console=console, auto_refresh=False, transient=True) as live:
                while not capture.complete:
                    capture.look({side: whole_grey8(frame) for side, frame in pair.next_pair().items()})
                    live.update(progress_text(capture), refresh=True)
        except KeyboardInterrupt:
            raise AutoexposeError(f"stopped after {len(capture.views)} views: nothing was written") from None
    console.print(progress_text(capture))
    return calibrate_geometry(board, capture.views, size, serials, _instead(capture.finders))


def progress_text(capture: Capture) -> str:
    """What is covered: a mark for each part of each picture, the views by tilt, and what to do next."""
    grids = [capture.covered(side) for side in SIDES]
    rows = [
        "   ".join(" ".join("#" if seen else "." for seen in row) for row in both) for both in zip(*grids, strict=True)
    ]
    width = len(rows[0]) // 2 + 2
    tilted = (", ".join(f"{name} {count}" for name, count in capture.tilted(side).items()) for side in SIDES)
    return "\n".join(
        (
            f"{'left':{width}}right",
            *rows,
            *(f"{side} saw the board turned to the {text}" for side, text in zip(SIDES, tilted, strict=True)),
            f"{capture.by_both} views by both cameras, of about {ENOUGH_VIEWS}",
            capture.advice,
        )
    )


def _instead(finders: Mapping[Side, BoardFinder]) -> dict[Side, str]:
    return {side: finder.what_else() for side, finder in finders.items()}


def _check_output(folder: Path) -> None:
    """Make the folder, and refuse to replace anything but a calibration file, before anything is measured."""
    make_folder(folder)
    if not os.access(folder, os.W_OK):
        raise ConfigurationError(f"{folder}: cannot be written: name a folder that you may write to")
    for side, name in (*FILES.items(), ("left", CAMCHAIN)):
        check_place(folder / name, partial(load_geometry, side=side), "calibration file")


def _keep(result: GeometryResult, folder: Path, rig: Sequence[CameraMode], console: CommandOutput) -> None:
    """Write files and report, and print the result."""
    texts: dict[str, str] = {}
    if result.fit is not None and result.geometries is not None and result.verdict != "refused":
        texts = {name: ros_yaml(result.geometries[side], side) for side, name in FILES.items()}
        left, right = (result.geometries[side] for side in SIDES)
        texts[CAMCHAIN] = camchain_yaml(left, right, result.fit.rotation, result.fit.translation_m)
    for name, text in texts.items():
        with written(folder / name):
            replace_file(folder / name, text.encode())
    report = write_geometry_report(folder / REPORT, result)
    print_judged(geometry_facts(result), result.findings, console)
    places = {folder / FILES[side]: mode for side, mode in zip(SIDES, rig or _SIDES, strict=True)}
    keys = dict(key for each in keys_of(places, "calibration").values() for key in each.items())
    print_written(console, *(folder / name for name in texts), report, keys=keys if texts else None)


def _rate_hz(mode: CameraMode) -> float:
    """The frame rate: no more than the rig's, which its link was planned for."""
    return max(min(RATE_HZ, mode.rate_hz or RATE_HZ), SLOWEST_HZ)


PIXELS_PER_MM = 10
MARGIN_MM = 10


def board(
    output: Path,
    *,
    squares: Squares = "9x6",
    square_mm: SquareMm = 30.0,
    marker_mm: MarkerMm = None,
    dictionary: Dictionary = DEFAULT_DICTIONARY,
) -> None:
    """Draw a ChArUco board to print at 100 %, as a .pdf or .png file; the default fits A4."""
    check_extra()
    from PIL import Image  # noqa: PLC0415  an extra

    if output.suffix.lower() not in (".pdf", ".png"):
        raise ConfigurationError(f"{output}: name a .pdf or .png file")
    drawn = board_picture(board_of(squares, square_mm, marker_mm, dictionary))
    dots_per_inch = 25.4 * PIXELS_PER_MM
    with written(output):
        Image.fromarray(drawn).save(output, resolution=dots_per_inch, dpi=(dots_per_inch, dots_per_inch))
    height_mm, width_mm = (side / PIXELS_PER_MM for side in drawn.shape)
    typer.echo(f"written: {output}, {width_mm:g} x {height_mm:g} mm: print it at 100 %, and measure a square")


def board_picture(board: Board) -> NDArray[np.uint8]:
    """The board in `PIXELS_PER_MM`, with a white margin that says what it is; shape (height, width)."""
    size = [round(1e3 * board.square_m * count * PIXELS_PER_MM) for count in (board.columns, board.rows)]
    margin = MARGIN_MM * PIXELS_PER_MM
    drawn = np.pad(np.asarray(board.charuco.generateImage(size), np.uint8), margin, constant_values=255)
    at = (margin, drawn.shape[0] - margin // 3)
    return np.asarray(cv2.putText(drawn, str(board), at, cv2.FONT_HERSHEY_SIMPLEX, 1.2, 0, 2, cv2.LINE_AA), np.uint8)
