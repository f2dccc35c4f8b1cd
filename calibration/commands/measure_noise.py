"""The command `autoexpose calibrate noise`."""

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

from calibration.commands.additions import response_file_of
from calibration.commands.measure import check_gain, take
from calibration.findings import Finding
from calibration.noise.model import Estimate, NoiseModel
from calibration.noise.photon_transfer import PhotonTransfer, photon_transfer
from calibration.noise.plan import default_gains_db, plan_noise
from calibration.sources.session import Session, session_setup
from calibration.sources.sweep import Sweep
from drivers.aravis import AravisCamera, open_camera
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.pixels import SAMPLES, PixelFormat, green_samples

log = logging.getLogger(__name__)

COLUMNS = (
    ("gain", "dB"),
    ("system gain", "DN/e"),
    ("read noise", "e"),
    ("black", "DN"),
    ("full well", "e"),
)
DEEPEST_FIRST = (PixelFormat.MONO12, PixelFormat.MONO16, PixelFormat.MONO8)


def noise(
    *,
    camera: Annotated[str, typer.Option(help="Serial number.")],
    gain_db: Annotated[list[float] | None, typer.Option(help="Gain to measure at (dB); may be repeated.")] = None,
    pixel_format: Annotated[PixelFormat | None, typer.Option(help="The deepest the camera has, if not given.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Response file to add the result to.")] = None,
) -> None:
    """Measure system gain, read noise, black level and full well at each gain, by photon transfer (EMVA 1288)."""
    console = Console(highlight=False)
    file = None if output is None else response_file_of(output, camera)
    _check_raw(camera, pixel_format)
    with _session(camera, pixel_format) as session:
        used_format = str(session.description.pixel_format)
        results = _measure(session, gain_db, console)
    models = [result.model for result in results.values() if result.model is not None]
    if models:
        console.print(noise_table(f"camera {camera}, {used_format}", models))
    for gain, result in results.items():
        for finding in result.findings:
            console.print(f"{finding.severity} at {gain:g} dB: {finding.text}", soft_wrap=True)
    if file is not None and output is not None and models:
        replace(file, noise=noise_document(used_format, list(results.values()), file.noise)).save(output)
        console.print(f"written: {output}", soft_wrap=True)
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
