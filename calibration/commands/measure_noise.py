"""The commands `autoexpose calibrate noise` and `latency`, which add to the camera's response file."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from calibration.commands.rig import AddTo, check_gain, print_keys, print_written, progress_of, take
from calibration.document import Finding
from calibration.latency import TRIALS, WriteEffect, capture_latency
from calibration.noise.light_lines import Estimate, NoiseModel
from calibration.noise.photon_transfer import PhotonTransfer, default_gains_db, photon_transfer, plan_noise
from calibration.response.file import ResponseFile
from calibration.session import Session, session_setup
from calibration.sweep import Sweep
from documents.command_line import AsJson, CommandOutput
from drivers.aravis import AravisCamera, open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.pixels import SAMPLES, PixelFormat, green_samples

log = logging.getLogger(__name__)


def response_file_of(path: Path, serial: str) -> ResponseFile:
    """The response file of a camera, checked before the measurement.

    Raises ConfigurationError when it does not exist, or is of another camera.
    """
    if not path.exists():
        raise ConfigurationError(
            f"{path}: there is no response file to add to: make it first with autoexpose calibrate response "
            f"--camera {serial} -o {path}"
        )
    file = ResponseFile.load(path)
    file.check_belongs(serial)
    return file


COLUMNS = (
    ("gain", "dB"),
    ("system gain", "DN/e"),
    ("read noise", "e"),
    ("black", "DN"),
    ("full well", "e"),
)
DEEPEST_FIRST = (PixelFormat.MONO12, PixelFormat.MONO16, PixelFormat.MONO8)


def noise(
    context: typer.Context,
    *,
    camera: Annotated[str, typer.Option(help="Serial number.")],
    gain_db: Annotated[list[float] | None, typer.Option(help="Gain to measure at (dB); may be repeated.")] = None,
    pixel_format: Annotated[PixelFormat | None, typer.Option(help="The deepest the camera has, if not given.")] = None,
    output: AddTo = None,
    as_json: AsJson = False,
) -> None:
    """Measure system gain, read noise, black level and full well at each gain, by photon transfer (EMVA 1288)."""
    console = CommandOutput(context, as_json)
    file = None if output is None else response_file_of(output, camera)
    _check_raw(camera, pixel_format)
    with _session(camera, pixel_format) as session:
        used_format = str(session.description.pixel_format)
        results = _measure(session, gain_db, console)
    models = [result.model for result in results.values() if result.model is not None]
    console.document["noise"] = noise_document(used_format, list(results.values()))
    if models and not as_json:
        console.print(noise_table(f"camera {camera}, {used_format}", models))
    for gain, result in results.items():
        for finding in result.findings:
            console.say(f"{finding.severity} at {gain:g} dB: {finding.text}")
    if file is not None and output is not None and models:
        replace(file, noise=noise_document(used_format, list(results.values()), file.noise)).save(output)
        print_written(console, output)
    print_keys(console, noise_keys(models))
    if len(models) < len(results):
        raise typer.Exit(1)


def noise_table(title: str, models: Sequence[NoiseModel]) -> Table:
    """One row for each gain."""
    table = Table(title=title, title_justify="left")
    for name, unit in COLUMNS:
        table.add_column(f"{name}\n({unit})", justify="right", no_wrap=True)
    for model in models:
        full_well = "not seen" if model.full_well_e is None else str(model.full_well_e)
        table.add_row(
            f"{model.gain_db:.1f}",
            str(model.system_gain),
            str(model.read_noise_e),
            str(model.black_level_dn),
            full_well,
        )
    return table


def noise_keys(models: Sequence[NoiseModel]) -> dict[str, float]:
    """What the configuration is to say of the sensors: as measured at the lowest gain, where pixels are full first."""
    if not models:
        return {}
    lowest = min(models, key=lambda model: model.gain_db)
    well, noise_e = lowest.full_well_e, lowest.read_noise_e
    full = {} if well is None else {"control.full_well_e": float(f"{well.value:.3g}")}
    return {**full, "control.read_noise_e": float(f"{noise_e.value:.2g}")}


def noise_document(
    pixel_format: str, results: Sequence[PhotonTransfer], former: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The content of `noise` in a response file: pairs are a value and its standard error.

    Gains that only `former` has, the previous content, are kept; of another pixel format they are not, because its
    grey levels are others.
    """
    entries: dict[float, Any] = {}
    match former:
        case {"pixel_format": known, "gains": [*gains]} if known == pixel_format:
            entries = {gain["gain_db"]: gain for gain in gains if _is_entry(gain)}
    for result in results:
        if result.model is not None:
            entry = _entry(result.model, result.findings)
            entries[entry["gain_db"]] = entry
    return {"pixel_format": pixel_format, "gains": [entries[gain_db] for gain_db in sorted(entries)]}


def _is_entry(gain: Any) -> bool:
    """Whether it can be kept: files are also edited by hand."""
    return isinstance(gain, Mapping) and isinstance(gain.get("gain_db"), float | int)


def _entry(model: NoiseModel, findings: Sequence[Finding]) -> dict[str, Any]:
    saturation = model.saturation_dn
    entry: dict[str, Any] = {
        "gain_db": round(model.gain_db, 3),
        "system_gain": _rounded(model.system_gain),
        "read_noise_e": _rounded(model.read_noise_e),
        "black_level_dn": _rounded(model.black_level_dn),
        "saturation_dn": None if saturation is None else round(saturation, 1),
        "full_well_e": None if model.full_well_e is None else _rounded(model.full_well_e),
    }
    if findings:
        entry["findings"] = [asdict(finding) for finding in findings]
    return entry


def _rounded(estimate: Estimate) -> list[float]:
    return [float(f"{part:.5g}") for part in estimate]


@contextmanager
def _session(serial: str, pixel_format: PixelFormat | None) -> Iterator[Session]:
    """A session in the format asked for, or the deepest; at its end the camera gets its previous format back."""
    with closing(open_camera(serial, session_setup())) as camera:
        former = camera.description.pixel_format
    try:
        with Session(_open(serial, pixel_format), green_samples) as session:
            _check_raw(serial, session.description.pixel_format)
            yield session
    finally:
        try:
            open_camera(serial, session_setup(former)).close()
        except AutoexposeError as error:  # it must not hide why the measurement ended
            log.warning("camera %s: its pixel format could not be set back to %s: %s", serial, former, error)


def _check_raw(serial: str, pixel_format: PixelFormat | None) -> None:
    """Refuse formats that the camera computes from its pixels: mixing loses the noise of a single one."""
    if pixel_format is not None and pixel_format.layout in SAMPLES:
        raise ConfigurationError(
            f"camera {serial}: {pixel_format} is computed from several pixels, so its noise is not theirs: give "
            "--pixel-format one of its Mono formats, or of its Bayer formats, whose green is measured"
        )


def _open(serial: str, pixel_format: PixelFormat | None) -> AravisCamera:
    """In the deepest grey format that the camera has: 8 bits hide the read noise of most sensors at low gain."""
    if pixel_format is not None:
        return open_camera(serial, session_setup(pixel_format))
    for grey in DEEPEST_FIRST:
        try:
            return open_camera(serial, session_setup(grey))
        except ConfigurationError:
            continue
    return open_camera(serial, session_setup())


def _measure(session: Session, gains_db: Sequence[float] | None, console: Console) -> dict[float, PhotonTransfer]:
    results = {}
    for gain_db in gains_db or default_gains_db(session.limits):
        check_gain(session, gain_db)
        shots = take(session, plan_noise(session, gain_db), f"{session.description.serial} at {gain_db:g} dB", console)
        results[gain_db] = photon_transfer(Sweep(shots))
    return results


def latency(
    context: typer.Context,
    *,
    camera: Annotated[str, typer.Option(help="Serial number.")],
    rate_hz: Annotated[float, typer.Option(min=0.1, help="Frame rate to measure at, ideally the rig's.")] = 60.0,
    writes: Annotated[int, typer.Option(min=5, help="Writes of exposure time, and as many of gain.")] = TRIALS,
    output: AddTo = None,
    as_json: AsJson = False,
) -> None:
    """Measure how many frames it takes for a write of exposure time or of gain to show, and how regular that is."""
    console = CommandOutput(context, as_json)
    file = None if output is None else response_file_of(output, camera)
    setup = session_setup(rate_hz=rate_hz)
    with Session(open_camera(camera, setup)) as session, progress_of(f"camera {camera}", console) as update:
        effects = capture_latency(session, rate_hz, writes, lambda done, total: update(completed=done, total=total))
    console.document["latency"] = latency_document(rate_hz, effects)
    if any(effect.frames or effect.unclear for effect in effects) and not as_json:
        console.print(latency_table(f"camera {camera} at {rate_hz:g} Hz", effects))
    for effect in effects:
        if effect.frames:
            console.say(when_it_shows(effect))
    if len(effects) == 1:
        console.say("gain is left out: this camera has no adjustable gain in dB")
    for finding in dict.fromkeys(finding for effect in effects for finding in effect.findings):
        console.say(f"{finding.severity}: {finding.text}")
    refused = [effect for effect in effects if any(finding.severity == "refused" for finding in effect.findings)]
    if file is not None and output is not None and not refused:
        replace(file, latency=latency_document(rate_hz, effects)).save(output)
        print_written(console, output)
    if refused:
        raise typer.Exit(1)


def latency_table(title: str, effects: Sequence[WriteEffect]) -> Table:
    """One row for each number of frames that was seen."""
    table = Table("write of", "frames until it shows", "writes", "share", "", title=title, title_justify="left")
    for effect in effects:
        clear = sum(effect.frames.values())
        for frames, count in effect.frames.items():
            share = count / clear
            table.add_row(effect.quantity, str(frames), str(count), f"{share:.0%}", "#" * round(20 * share))
        if effect.unclear:
            table.add_row(effect.quantity, "unclear", str(effect.unclear), "", "")
        table.add_section()
    return table


def when_it_shows(effect: WriteEffect) -> str:
    """The same as times: when writes were made, and how much later the exposures that show them start."""
    assert effect.lead_us is not None
    assert effect.delay_us is not None
    early_ms, late_ms = (delay_us * 1e-3 for delay_us in effect.delay_us)
    written = f"{effect.quantity}: written {effect.lead_us * 1e-3:.1f} ms after the start of an exposure"
    if early_ms < 0:
        return f"{written}; exposures that start {late_ms:.1f} ms after the write, and earlier ones perhaps, show it"
    if early_ms < late_ms:
        return f"{written}; exposures that start {early_ms:.1f} ms after the write do not show it, {late_ms:.1f} ms do"
    return f"{written}; how long after the write an exposure starts does not decide whether it shows it"


def latency_document(rate_hz: float, effects: Sequence[WriteEffect]) -> dict[str, Any]:
    """The content of `latency` in a response file."""
    document: dict[str, Any] = {"rate_hz": rate_hz}
    for effect in effects:
        entry: dict[str, Any] = {"mode_frames": effect.mode, "frames": effect.frames, "untold": effect.unclear}
        if effect.findings:
            entry["findings"] = [asdict(finding) for finding in effect.findings]
        document[effect.quantity] = entry
    return document
