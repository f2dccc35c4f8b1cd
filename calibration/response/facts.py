"""What a response file says, as names and values for people."""

from __future__ import annotations

from collections.abc import Iterator

from calibration.response.file import Origin, ResponseFile

Fact = tuple[str, str]

SIGMAS = 2.0
"""Standard errors that are stated as the error; docs/calibration-method.md says how often it holds."""


def origin_facts(origin: Origin) -> Iterator[Fact]:
    """Which camera it belongs to, and in which mode it was measured."""
    if origin.camera is not None:
        camera = origin.camera
        yield "camera", f"{camera.vendor} {camera.model}, serial {camera.serial}"
    mode = [
        origin.pixel_format,
        None if origin.binning is None else f"binning {origin.binning}",
        None if origin.gain_db is None else f"gain {origin.gain_db:g} dB",
    ]
    if any(mode):
        yield "mode", ", ".join(part for part in mode if part)
    if origin.date is not None:
        yield "measured", f"{origin.date:%Y-%m-%d %H:%M} UTC" + (f" by {origin.tool}" if origin.tool else "")


def curve_facts(file: ResponseFile) -> Iterator[Fact]:
    """What the curve is, and how well it is known."""
    if file.model is not None:
        parameters = ", ".join(f"{name} {value:.4g}" for name, value in file.parameters.items())
        yield "model", f"{file.model} ({parameters})" if parameters else file.model
    yield "black level, saturation", f"grey {file.response.black_level}, {file.response.saturation}"
    if file.covered is not None:
        low, high = file.covered
        yield "covered range", f"grey {low} to {high}"
        if file.uncertainty_stops:
            yield "error", _error(file.uncertainty_stops, file.covered, file.accurate or file.covered)
    if file.residual_grey is not None:
        yield "residual", f"{file.residual_grey:.2f} grey levels rms"
    if file.times_checked is False:
        yield "exposure times", "taken on trust: the noise of the images could not check them"


def _error(uncertainty_stops: tuple[float, ...], covered: tuple[int, int], accurate: tuple[int, int]) -> str:
    """What is stated: how well most grey levels are known, and all that were seen."""
    well, all_seen = (SIGMAS * max(uncertainty_stops[low : high + 1]) for low, high in (accurate, covered))
    low, high = accurate
    rest = "" if accurate == covered else f", {all_seen:.2g} in the covered range"
    return f"at most {well:.2g} stops from grey {low} to {high}{rest}, counted from grey {(low + high) // 2}"
