"""Where bracketed drives come from: folders of images, and recordings by `autoexpose record --bracket`."""

from __future__ import annotations

import csv
import io
import itertools
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.recording.file import LoopState, RecordingError, Setup, Step
from autoexpose_daemon.recording.read import Mark, Recording
from calibration.geometry.file import check_pair, load_geometry
from calibration.response.file import ResponseFile
from documents.files import read_text
from evaluation.rejudge.drive import FEWEST_CYCLES, Drive, check_long_enough, watched
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES, CameraGeometry
from imaging.pixels import Pixels
from imaging.python310 import Self
from imaging.response import ResponseFunction

LIST = "frames.csv"
COLUMNS = ("file", "side", "time_s", "exposure_time_us", "gain_db")
SAME_STOPS = 0.05
MOST_SHOTS = 12
_LONGEST_BYTES = 1 << 27
_DARKEST_US, _HIGHEST_GAIN_DB = 20.0, 30.0


@dataclass(frozen=True, slots=True)
class ListedImage:
    """One line of the list."""

    file: Path
    camera: CameraName
    time_s: float
    setting: ExposureSetting


Part = tuple[int, int]  # Of the complete pairs of a drive: the first, and the one after the last
_ALL: Part = (0, sys.maxsize)
# A pair of a recording, the byte of a mark before it, and what that needs (`Mark`): plain, for jobs.
MarkedPair = tuple[int, int, Sequence[int]]
MARKS_S = 1.0  # How far marks are apart in a drive


def read_drive(path: Path, part: Part = _ALL, near: MarkedPair | None = None) -> Drive:
    """A recording or a folder, or a part of it, for the first time. Raises as `read_folder` and `read_recording` do.

    `near`: a mark of a recording from which to look for the part.
    """
    return read_folder(path, part) if path.is_dir() else read_recording(path, part, near)


def read_folder(folder: Path, part: Part = _ALL) -> Drive:
    """Read a folder for the first time. Raises AutoexposeError: naming the file and the line at fault."""
    instants = _instants(folder)
    cameras = tuple(instants[0])
    responses: dict[CameraName, ResponseFunction] = {camera: _response(folder, camera) for camera in cameras}
    geometries = _geometries(folder, instants[0])
    settings = [next(iter(entries.values())).setting for entries in instants]
    levels = [setting.level for setting in settings]
    bracket = Bracketing(_cycle(folder, levels), max(max(levels) - min(levels), 1.0))
    setup = ControlSetup("fixed", responses, _limits(settings), settings[0], ControlParameters(bracket=bracket))
    source = partial(_pairs, instants[slice(*part)])
    return watched(str(folder), setup, _decided(setup, source()), source, geometries)


def _limits(settings: Sequence[ExposureSetting]) -> ExposureLimits:
    """Those that a camera must at least have had."""
    times_us, gains_db = ([getattr(one, name) for one in settings] for name in ("exposure_time_us", "gain_db"))
    return ExposureLimits(
        min(_DARKEST_US, *times_us), max(times_us), min(0.0, *gains_db), max(_HIGHEST_GAIN_DB, *gains_db)
    )


def _decided(setup: ControlSetup, pairs: Iterator[FrameSet]) -> Iterator[tuple[FrameSet, Decision, float]]:
    """Pairs with what control sees of them; the decision itself is the setting that the next one has."""
    loop = ControlLoop(setup.of_policy("fixed"))
    former: tuple[FrameSet, Decision, float] | None = None
    for pair in pairs:
        if former is not None:
            yield former[0], replace(former[1], setting=pair.reference.setting), former[2]
        former = pair, loop.step(pair), pair.reference.host_time_ns * 1e-9
    if former is not None:
        yield former


def _pairs(instants: list[dict[CameraName, ListedImage]]) -> Iterator[FrameSet]:
    kinds: dict[CameraName, str] = {}
    for number, entries in enumerate(instants):
        frames = {camera: _frame(entry, number) for camera, entry in entries.items()}
        for camera, frame in frames.items():
            height, width = frame.pixels.shape
            kind = f"{width}x{height} with {frame.bit_depth} bits"
            if kinds.setdefault(camera, kind) != kind:
                raise AutoexposeError(
                    f"{entries[camera].file}: is {kind}, {instants[0][camera].file.name} is {kinds[camera]}: give all "
                    "images of a camera one size and depth"
                )
        yield FrameSet(number, frames)


def _frame(entry: ListedImage, number: int) -> Frame:
    image: Any = cv2.imread(str(entry.file), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise AutoexposeError(f"{entry.file}: is no image that can be read: give PNG or TIFF")
    if image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        raise AutoexposeError(f"{entry.file}: is not grey with 8 or 16 bits: convert it")
    pixels: Pixels = image
    time_ns = round(entry.time_s * 1e9)
    return Frame(pixels, 8 * pixels.itemsize, number, time_ns, time_ns, time_ns, entry.setting)


def _instants(folder: Path) -> list[dict[CameraName, ListedImage]]:
    """The entries of each instant, left first; every instant has the same sides."""
    entries = _entries(folder)
    groups = [list(group) for _, group in itertools.groupby(entries, key=lambda entry: entry.time_s)]
    instants: list[dict[CameraName, ListedImage]] = [
        {camera: entry for camera in SIDES for entry in group if entry.camera == camera} for group in groups
    ]
    for group, instant in zip(groups, instants, strict=True):
        if len(instant) < len(group):
            raise AutoexposeError(
                f"{folder / LIST}: {group[0].file.name} to {group[-1].file.name} have one time_s, but are more than an "
                "image of each camera: give each instant its own"
            )
    for instant in instants:
        if tuple(instant) != tuple(instants[0]):
            first = next(iter(instant.values()))
            raise AutoexposeError(
                f"{folder / LIST}: {first.file.name} has no partner at {first.time_s:g} s: give the images of one "
                "instant the same time_s"
            )
    return instants


def _entries(folder: Path) -> list[ListedImage]:
    file = folder / LIST
    text = read_text(file, _LONGEST_BYTES)
    rows = csv.DictReader(io.StringIO(text))
    try:
        return _read(rows, folder)
    except csv.Error as error:
        raise AutoexposeError(
            f"{file}: line {rows.reader.line_num} is not CSV ({error}): look for a quote that is not closed"
        ) from error


def _read(rows: csv.DictReader[str], folder: Path) -> list[ListedImage]:
    file = folder / LIST
    if rows.fieldnames is None or not set(COLUMNS) <= set(rows.fieldnames):
        raise AutoexposeError(f"{file}: its first line must name the columns {', '.join(COLUMNS)}")
    entries: list[ListedImage] = []
    for row in rows:
        entry = _entry(folder, row)
        if entry is None or (entries and entry.time_s < entries[-1].time_s):
            wrong = "is earlier than the one before" if entry else f"needs {', '.join(COLUMNS)}, side left or right"
            raise AutoexposeError(f"{file}: line {rows.line_num} {wrong}")
        entries.append(entry)
    if not entries:
        raise AutoexposeError(f"{file}: names no image")
    return entries


def _entry(folder: Path, row: dict[str, str | None]) -> ListedImage | None:
    """The entry of a row; None for one that is not an entry."""
    try:
        time_s, exposure_time_us, gain_db = (float(row[name] or "") for name in COLUMNS[2:])
    except ValueError:
        return None
    camera = next((camera for camera in SIDES if camera == row["side"]), None)
    setting = ExposureSetting(exposure_time_us, gain_db)
    if camera is None or not row["file"] or not math.isfinite(time_s) or not setting.is_physical:
        return None
    return ListedImage(folder / row["file"], camera, time_s, setting)


def _cycle(folder: Path, levels: list[float]) -> int:
    """After how many shots the settings repeat."""
    for cycle in range(2, MOST_SHOTS + 1):
        if len(levels) > cycle and all(
            abs(late - early) < SAME_STOPS for early, late in zip(levels, levels[cycle:], strict=False)
        ):
            return cycle
    raise AutoexposeError(f"{folder / LIST}: its exposures do not repeat in cycles of 2 to {MOST_SHOTS} shots")


def _geometries(folder: Path, first: dict[CameraName, ListedImage]) -> dict[CameraName, CameraGeometry]:
    """Those that there are, of the images of the first instant."""
    found: dict[CameraName, CameraGeometry] = {}
    for camera, entry in first.items():
        file = folder / f"{camera}.yaml"
        if file.exists():
            found[camera] = geometry = load_geometry(file, "right" if camera == "right" else "left")
            height, width = _frame(entry, 0).pixels.shape
            if (width, height) != (geometry.width, geometry.height):
                raise AutoexposeError(
                    f"{file}: is for frames of {geometry.width}x{geometry.height} pixels, {entry.file.name} has "
                    f"{width}x{height}: give the calibration of these images"
                )
    try:
        check_pair(found.get("left"), found.get("right"))
    except ConfigurationError as error:
        said = str(error)
        for camera in SIDES:
            said = said.replace(f"cameras.{camera}.calibration", f"{folder / camera}.yaml")
        raise AutoexposeError(said) from error
    return found


def _response(folder: Path, camera: CameraName) -> ResponseFunction:
    file = folder / f"response-{camera}.yaml"
    return ResponseFile.load(file).response if file.exists() else ResponseFunction.linear()


def read_recording(path: Path, part: Part = _ALL, near: MarkedPair | None = None) -> Drive:
    """Read a recording, or a part of it, for the first time. Raises AutoexposeError: in one sentence, when it cannot be
    read, or was not recorded in brackets."""
    setup = _bracketed(path)
    bracket = setup.parameters.bracket
    geometries: dict[CameraName, CameraGeometry] = {}

    def seen() -> Iterator[tuple[FrameSet, Decision, float]]:
        for step in _steps(path, bracket, part, near):
            geometries.update(step.calibrations)
            yield step.pair, step.decision, step.stamp_ns * 1e-9

    return watched(str(path), setup, seen(), partial(_recorded_pairs, path, bracket, part, near), geometries)


@dataclass(frozen=True, slots=True)
class Survey:
    """What is known of a drive without looking at its pictures."""

    policy: str  # that the robot ran, as far as known
    robot: str  # the rig that it was recorded as, or the name of the folder
    times_s: Sequence[float]  # of its complete pairs
    level: float  # median exposure level of the pairs, stops: the higher, the darker it was
    limits: Mapping[str, Any]  # `ExposureLimits` of the recording
    cycle: int  # pairs in a cycle of the bracket
    marks: Sequence[MarkedPair] = ()  # of a recording, in order

    @property
    def fewest_pairs(self) -> int:
        """That a part must have."""
        return FEWEST_CYCLES * self.cycle

    def near(self, number: int) -> MarkedPair | None:
        """The last mark that is not after a pair."""
        return max((mark for mark in self.marks if mark[0] <= number), key=lambda mark: mark[0], default=None)

    @classmethod
    def of(cls, path: Path) -> Self:
        """Read a drive. Raises as `read_drive` does."""
        marks: list[MarkedPair] = []
        if path.is_dir():
            entries = [next(iter(instant.values())) for instant in _instants(path)]
            policy, robot = DEFAULT_POLICY, path.name
            seen = [(entry.time_s, entry.setting.level) for entry in entries]
            limits = _limits([entry.setting for entry in entries])
            cycle = _cycle(path, [entry.setting.level for entry in entries])
        else:
            setup, recording = _bracketed(path), Recording(path)
            bracket = setup.parameters.bracket
            assert bracket is not None
            cycle = bracket.exposures + bracket.keep
            policy, robot = setup.policy_id, path.stem
            seen, before, limits = [], None, setup.limits
            for number, step in enumerate(_complete(recording, path, bracket)):
                time_s, mark = step.stamp_ns * 1e-9, recording.mark
                if mark != before and (not marks or time_s >= seen[marks[-1][0]][0] + MARKS_S):
                    marks.append((number, mark.at_byte, mark.needs))  # the first pair after it
                seen.append((time_s, step.pair.reference.setting.level))
                before = mark
            robot = recording.rig or robot
        times_s = [time_s for time_s, _ in seen]
        level = float(np.median([level for _, level in seen] or [0.0]))
        if times_s:
            check_long_enough(str(path), len(times_s), cycle)
        return cls(policy, robot, times_s, level, asdict(limits), cycle, marks)


def _bracketed(path: Path) -> ControlSetup:
    setup = _setup(path)
    if setup.parameters.bracket is None:
        raise RecordingError(f"{path}: was not recorded in brackets: record the drive with `record --bracket`")
    return setup


def _setup(path: Path) -> ControlSetup:
    """The first setup of a recording."""
    for item in Recording(path):
        if isinstance(item, Setup):
            return item.control
    raise RecordingError(f"{path}: is damaged: it does not say how it was made")


def _recorded_pairs(path: Path, bracket: Bracketing | None, part: Part, near: MarkedPair | None) -> Iterator[FrameSet]:
    return (step.pair for step in _steps(path, bracket, part, near))


def _steps(path: Path, bracket: Bracketing | None, part: Part, near: MarkedPair | None) -> Iterator[Step]:
    """Those of a part with complete pairs."""
    first, end = part
    marked, mark = (0, None) if near is None else (near[0], Mark(near[1], tuple(near[2])))
    return itertools.islice(_complete(Recording(path, mark), path, bracket), first - marked, end - marked)


def _complete(recording: Recording, path: Path, bracket: Bracketing | None) -> Iterator[Step]:
    for item in recording:
        match item:
            case Step() if len(item.pair.frames) == item.cameras:
                yield item
            case Setup() if item.control.parameters.bracket != bracket:
                raise RecordingError(f"{path}: its brackets change on the way: record the drive in one piece")
            case Setup() | LoopState() | Step():
                pass
