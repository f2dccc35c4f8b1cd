"""Which cameras to calibrate, how to set them up and sweep them, and where results may be written."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import partial
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.document import CameraIdentity, Finding, Verdict, located, verdict, written
from calibration.gain import GainFile
from calibration.images import read_images
from calibration.response.file import Origin, ResponseFile
from calibration.response.result import Result, calibrate
from calibration.session import Session, session_setup
from calibration.sweep import Shot, Sweep, SweepPlan, plan_sweep
from documents import bounds
from documents.bounds import CAMERA_NAME
from documents.command_line import CommandOutput, given_config, yaml_text
from documents.strict_yaml import load_mapping
from documents.text import quoted
from drivers.aravis import open_camera
from drivers.genicam.dialect import GAINS
from drivers.genicam.trigger import RATE_NODES
from drivers.setup import CameraSetup, FeatureSetting, LinkShare, parse_features
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.frames import CameraName
from imaging.gain_scale import GainScale
from imaging.geometry import SIDES
from imaging.pixels import PIXEL_FORMATS, PixelFormat
from imaging.python310 import UTC
from imaging.response import ResponseFunction

Cameras = Annotated[list[str] | None, typer.Option("--camera", help="Serial number; twice for left and right.")]
AddTo = Annotated[Path | None, typer.Option("-o", "--output", help="Response file to add the result to.")]


@dataclass(frozen=True, slots=True)
class CameraMode:
    """A camera by its serial, the image format to run it with (None keeps what it has), and features to set first.

    `name` is what its files and sections are called after: what a configuration calls it, or left and right in turn.
    `gain_scale` drives a gain that is not in dB, `exposure_count_us` a time in counts; `response` is its response file,
    which need not exist yet; `rate_hz` is that of the rig's trigger; `config` is the file that names the camera, None:
    no file does.
    """

    serial: str
    name: CameraName = SIDES[0]
    pixel_format: PixelFormat | None = None
    binning: int | None = None
    features: tuple[FeatureSetting, ...] = ()
    gain_scale: GainScale | None = None
    exposure_count_us: float | None = None
    response: Path | None = None
    rate_hz: float | None = None
    packet_size_bytes: int | None = None
    link_share: LinkShare | None = None
    config: Path | None = None

    def setup(self, rate_hz: float | None = None, *, own_gain: bool = False) -> CameraSetup:
        """How to open it for a `calibration.session.Session`.

        A rate leaves out features that set another one, and `own_gain` (its gain in the numbers of its node) leaves
        out those that set a gain; in the rig they apply.
        """
        otherwise = {*(RATE_NODES if rate_hz is not None else ()), *(GAINS if own_gain else ())}
        return replace(
            session_setup(self.pixel_format, rate_hz),
            binning=self.binning,
            features=tuple(feature for feature in self.features if feature.name not in otherwise),
            gain_scale="own numbers" if own_gain else self.gain_scale,
            exposure_count_us=self.exposure_count_us,
            packet_size_bytes=self.packet_size_bytes,
            link_share=self.link_share,
        )


def chosen_rig(
    camera: Sequence[str] | None,
    file: Path | None,
    option: Path | None,
    *others: object,
    options: str = "--camera and --config",
) -> list[CameraMode]:
    """The cameras that a command is given: serials, a configuration as argument or option; none if `others` are given.

    Raises ConfigurationError unless it is one of them all, and as `rig_of_config` does.
    """
    config = given_config(file, option)
    if [bool(camera), config is not None, *(other is not None for other in others)].count(True) != 1:
        raise ConfigurationError(f"say what to calibrate: one of {options}")
    if config is not None:
        return rig_of_config(config)
    serials = camera or []
    if len(serials) > len(SIDES):
        raise ConfigurationError(
            f"--camera is given {len(serials)} times: it is for one camera or a left and a right one; of more, "
            "give the names with --config"
        )
    return [CameraMode(serial, name) for serial, name in zip(serials, SIDES, strict=False)]


def rig_of_config(path: Path) -> list[CameraMode]:
    """The cameras of the daemon's configuration file; its other keys are left to `autoexpose config check`.

    Raises ConfigurationError naming the file, the key and what to do.
    """
    document = _Section(path, "", load_mapping(path, "begin with `cameras:`; see docs/look-up/configuration.md"))
    cameras, image, transport = (document.section(key) for key in ("cameras", "image", "transport"))
    pixel_format, binning = image.keys.get("pixel_format"), image.keys.get("binning")
    if pixel_format is not None and pixel_format not in list(PIXEL_FORMATS):
        raise image.wrong("pixel_format", "see autoexpose config check")
    if binning is not None and type(binning) is not int:
        raise image.wrong("binning", "give a whole number of pixels")
    packet_bytes = transport.number("packet_size_bytes", bounds.PACKET_BYTES)
    mbps = transport.number("link_mbps", bounds.LINK_MBPS)
    if not cameras.keys:
        raise ConfigurationError(f"{path}: cameras is missing: name each, with its serial")
    alike = CameraMode(
        "",
        "",
        pixel_format and PIXEL_FORMATS[pixel_format],
        binning,
        rate_hz=document.section("trigger").number("rate_hz", bounds.RATE_HZ),
        packet_size_bytes=None if packet_bytes is None else int(packet_bytes),
        config=path,
    )
    rig = {name: cameras.section(name) for name in cameras.keys}
    for name in rig:
        if not CAMERA_NAME.fullmatch(str(name)):
            raise ConfigurationError(f"{path}: cameras.{name} is no name for a camera: see autoexpose config check")
    links = Counter(str(section.keys.get("link")) for section in rig.values())
    planned = transport.keys.get("plan") is True
    return [
        replace(
            _camera(section, alike),
            name=name,
            link_share=LinkShare(links[str(section.keys.get("link"))], mbps) if planned else None,
        )
        for name, section in rig.items()
    ]


@dataclass(frozen=True, slots=True)
class _Section:
    """A part of a configuration file: its keys, and where they stand, as in `cameras.left.`."""

    path: Path
    place: str
    keys: Mapping[Any, Any]

    def section(self, key: str) -> _Section:
        section = self.keys.get(key) or {}
        if not isinstance(section, dict):
            raise self.wrong(key, "give keys and values")
        return _Section(self.path, f"{self.place}{key}.", section)

    def number(self, key: str, within: bounds.Range) -> float | None:
        value = self.keys.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or value not in within:
            raise self.wrong(key, f"give {within}")
        return value

    def file(self, key: str) -> Path | None:
        file = self.keys.get(key)
        if file is not None and not isinstance(file, str):
            raise self.wrong(key, "name a file")
        return None if file is None else self.path.parent / file

    def wrong(self, key: str, advice: str) -> ConfigurationError:
        return ConfigurationError(f"{self.path}: {self.place}{key} is {quoted(self.keys.get(key))}: {advice}")


def _camera(section: _Section, alike: CameraMode) -> CameraMode:
    serial, scale = section.keys.get("serial"), None
    if not isinstance(serial, str) or not serial:
        raise section.wrong("serial", "give it in quotes")
    try:
        features = parse_features(section.keys.get("features", []))
    except ValueError as error:
        raise ConfigurationError(f"{section.path}: {section.place}features: {error}") from error
    gain_file = section.file("gain_calibration")
    if gain_file is not None:
        with located(f"{section.path}: {section.place}gain_calibration"):
            gain = GainFile.load(gain_file)
            gain.check_belongs(serial)
            scale = gain.scale
    return replace(
        alike,
        serial=serial,
        features=features,
        gain_scale=scale,
        exposure_count_us=section.number("exposure_count_us", bounds.EXPOSURE_COUNT_US),
        response=section.file("response"),
    )


def check_rig(rig: Sequence[CameraMode]) -> None:
    """Refuse a camera that is given twice. Raises ConfigurationError."""
    for one, other in combinations(rig, 2):
        if one.serial == other.serial:
            raise ConfigurationError(f"{one.name} and {other.name} are the same camera, {one.serial}")


def places_of(rig: Sequence[CameraMode], output: Path, kind: str) -> dict[Path, CameraMode]:
    """The file of each camera: `output`, or `name`.`kind`.yaml of each in that folder, which is made.

    Raises ConfigurationError when they are no rig, or the folder cannot be made.
    """
    check_rig(rig)
    if len(rig) == 1:
        return {output: rig[0]}
    make_folder(output)
    return {output / f"{mode.name}.{kind}.yaml": mode for mode in rig}


def keys_of(places: Mapping[Path, CameraMode], key: str) -> dict[Path, dict[str, Path]]:
    """By file: the key of the configuration that is to name it, and its path as seen from there.

    Of a single camera that no configuration has named, the user knows the NAME.
    """
    keys = {}
    for path, mode in places.items():
        name = "NAME" if mode.config is None and len(places) == 1 else mode.name
        seen = path if mode.config is None or path.is_absolute() else Path(os.path.relpath(path, mode.config.parent))
        keys[path] = {f"cameras.{name}.{key}": seen}
    return keys


def make_folder(path: Path) -> None:
    """Make a folder, unless it is there. Raises ConfigurationError."""
    try:
        path.mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be made ({error.strerror}): choose another folder") from error


def measure_camera(mode: CameraMode, gain_db: float, console: Console) -> Result:
    """Sweep the exposure time of a camera that looks at a static scene, and solve the sweep.

    Raises CameraError and ConfigurationError when the camera cannot be opened, or fails.
    """
    with Session(open_camera(mode.serial, mode.setup())) as session:
        check_gain(session, gain_db)
        plan, camera = plan_sweep(session, gain_db), session.description
        sweep = Sweep(take(session, plan, mode.serial, console))
        origin = Origin(
            CameraIdentity(camera.vendor, camera.model, camera.serial),
            camera.pixel_format,
            mode.binning,
            sweep.shots[0].setting.gain_db,
            **stamp(),
        )
        brighter = partial(_brighter, session, plan, mode.serial, console)
        return calibrate(f"camera {camera.serial}", origin, sweep, camera.limitations, brighter)


def _brighter(session: Session, plan: SweepPlan, name: str, console: Console) -> tuple[Shot, ...]:
    """The sweep at a higher gain, if the camera has one."""
    brighter = plan.brighter(session.limits)
    if brighter is None:
        return ()
    gain_db = brighter.settings[0].gain_db
    console.print(
        f"camera {name}: the scene has one brightness only: again at {gain_db:.1f} dB, to check the exposure times",
        soft_wrap=True,
    )
    return take(session, brighter, name, console)


def measure_images(source: Path) -> Result:
    """Solve the sweep that a folder or a list of images holds; the camera is unknown."""
    return calibrate(f"the images of {source}", Origin(**stamp()), read_images(source))


def take(session: Session, plan: SweepPlan, name: str, console: Console) -> tuple[Shot, ...]:
    """Take the shots of a plan. Raises CameraError when the camera fails, and AutoexposeError when interrupted."""
    shots: list[Shot] = []
    with progress_of(f"camera {name}", console, sum(map(plan.seconds, plan.settings))) as update:
        for setting, taken in plan.run(session):
            shots += taken
            update(advance=plan.seconds(setting), description=f"camera {name}: {setting.exposure_time_us:.0f} us")
    return tuple(shots)


@contextmanager
def progress_of(
    name: str, console: Console, total: float | None = None, todo: str = ""
) -> Iterator[Callable[..., None]]:
    """A progress bar with the time left, and `rich.progress.Progress.update` for it.

    Raises AutoexposeError when the user interrupts the measurement.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn(), TextColumn("remaining"))
    try:
        with Progress(*columns, console=console, speed_estimate_period=60.0) as progress:
            yield partial(progress.update, progress.add_task(name + todo, total=total))
    except KeyboardInterrupt:
        raise AutoexposeError(f"{name}: stopped before the measurement was complete: nothing was written") from None


def print_judged(facts: Iterable[tuple[str, str]], findings: Sequence[Finding], output: CommandOutput) -> Verdict:
    """Print what was measured, what is wrong with it, and the verdict, which is returned."""
    judged, known = verdict(findings), dict(facts)
    entry = {"facts": known, "findings": [asdict(finding) for finding in findings], "verdict": judged}
    output.document.setdefault("results", []).append(entry)
    said = ((finding.severity, finding.text) for finding in findings)
    for name, text in (*known.items(), *said, ("verdict", judged)):
        output.say(f"{name}: {text}")
    return judged


def print_written(output: CommandOutput, *files: Path, keys: Mapping[str, Path] | None = None) -> None:
    """Print which files were written, and which of them the `keys` of the configuration are to name."""
    output.document.setdefault("written", []).extend(map(str, files))
    output.say(f"written: {', '.join(map(str, files))}")
    print_keys(output, {key: str(file) for key, file in (keys or {}).items()})


def print_keys(output: CommandOutput, keys: Mapping[str, str | float]) -> None:
    """Print what the configuration is to say."""
    for key, value in keys.items():
        output.document.setdefault("configuration", {})[key] = value
        output.say(f"for the configuration: {key}: {value if isinstance(value, str) else f'{value:g}'}")


def check_new(output: Path | None) -> None:
    """Refuse to write sections over an existing file. Raises ConfigurationError."""
    if output is not None and (output.exists() or not output.parent.is_dir()):
        raise ConfigurationError(f"{output}: cannot be written: name a new file in an existing folder")


def give_sections(sections: Mapping[CameraName, Any], file: Path | None, output: CommandOutput) -> None:
    """Print what to add to the sections of cameras in a configuration, or write it to a new file; if there is any."""
    if not sections:
        return
    document = {"cameras": dict(sections)}
    if file is None:
        output.show_yaml(document)
        return
    with written(file):
        file.write_text(yaml_text(document), encoding="utf-8")
    print_written(output, file)


def check_gain(session: Session, gain_db: float) -> None:
    """Refuse a gain that the camera does not have."""
    limits, serial = session.limits, session.description.serial
    if not limits.min_gain_db <= gain_db <= limits.max_gain_db:
        raise ConfigurationError(
            f"camera {serial}: its gain is {limits.min_gain_db:g} to {limits.max_gain_db:g} dB, not {gain_db:g} dB: "
            "give another with --gain-db"
        )


def response_of(path: Path | None, serial: str | None) -> ResponseFunction:
    """The response of a camera, from its file; linear without one.

    Raises ConfigurationError when the file cannot be read, or is of another camera.
    """
    if path is None:
        return ResponseFunction.linear()
    file = ResponseFile.load(path)
    if serial is not None:
        file.check_belongs(serial)
    return file.response


def stamp() -> dict[str, Any]:
    """When something was measured: `date` now, and `tool`, name and version of this program."""
    return {
        "date": datetime.now(UTC).replace(microsecond=0),
        "tool": f"autoexpose-daemon {version('autoexpose-daemon')}",
    }


File = TypeVar("File")


def check_place(path: Path, load: Callable[[Path], File], kind: str) -> File | None:
    """The file that is to be replaced; refuses impossible names and files of another kind before anything is measured.

    Raises ConfigurationError naming the file and what to do.
    """
    if path.is_dir() or not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise ConfigurationError(f"{path}: cannot be written: name a file in an existing folder that you may write to")
    if not path.exists():
        return None
    try:
        return load(path)
    except ConfigurationError as error:
        raise ConfigurationError(f"{error}; it is not a {kind} to replace: choose another place") from None


def check_report(path: Path, title: str, *suffixes: str) -> None:
    """Refuse to replace what is not a former report, whose title begins so, by the report of `path`."""
    page = path.with_suffix(".html")
    try:
        former = f"<title>{title}" in page.read_text(encoding="utf-8", errors="replace")[:1000]
    except OSError:
        former = False
    for report in (page, *(path.with_suffix(suffix) for suffix in suffixes)):
        if report.exists() and not former:
            raise ConfigurationError(
                f"{report}: is not a former report, and the report of {path} would replace it: choose another name"
            )
