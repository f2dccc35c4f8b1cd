"""A response file: the curve, its camera, how it was made, and how well it is known; ours, and that of TUM's tools."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict, field_validator

from calibration.document import (
    CalibrationDocument,
    CameraIdentity,
    Finding,
    Number,
    Text,
    located,
    optional,
    read_document,
    to_calibrate,
    within,
    write_document,
)
from documents.bounds import BINNING, GAIN_DB, Range
from documents.text import quoted
from imaging.errors import ConfigurationError
from imaging.pixels import PixelFormat
from imaging.response import GREY_LEVELS, ResponseFunction

ResponseModel = Literal["linear", "gamma", "emor", "free"]


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSolution:
    """A response function recovered from a sweep."""

    # the response function; its log2 exposures are 0 at `response.saturation`, since a sweep fixes no scale
    response: ResponseFunction
    # the simplest kind of curve that explains the sweep as well as a free one: "linear" with clip, "gamma" (a power
    # law), "emor" (a few basis curves), or "free" (each grey level separately, monotone)
    model: ResponseModel
    parameters: dict[str, float]  # those of the model by name, such as {"gamma": 0.45}; empty for a free curve
    # standard error of the log2 exposure of each grey level (stops), float64, shape (256,)
    uncertainty_stops: NDArray[np.float64]
    # the first and last grey level that the sweep itself has seen; beyond them the curve is extended. Where noise does
    # not vouch for the images, those next to black and saturation do not count.
    covered: tuple[int, int]
    residual_grey: float  # root mean square of grey levels observed minus those predicted from the other exposures
    # the first and last of those that are known well, for which the error is stated; None: not judged yet
    accurate: tuple[int, int] | None = None
    # whether the scene had one brightness only, so that grey levels cannot tell a curve from wrong exposure times
    uniform: bool = False
    # the most light (saturation is 1) that black may contain, if exposures are all longer than stated
    hidden_light: float = 1.0


FORMAT = "autoexpose-response/1"
_DECIMALS = 6
"""A millionth of a stop is far below what any sweep resolves, and keeps the file readable."""


_LOG2_EXPOSURE = Range(-1000.0, 1000.0, "stops")
_UNCERTAINTY = Range(0.0, 1000.0, "stops")
_RESIDUAL = Range(0, 255, "grey levels")
_Stops = Annotated[Number, within(_LOG2_EXPOSURE)]
_Uncertainty = Annotated[Number, within(_UNCERTAINTY)]
_Uncertainties = Annotated[tuple[_Uncertainty, ...], Field(min_length=GREY_LEVELS, max_length=GREY_LEVELS)]
_Grey = Annotated[int, Strict(), Field(ge=0, lt=GREY_LEVELS)]


@dataclass(frozen=True, slots=True)
class Origin:
    """The camera and the mode in which it was measured (gain in dB), when, and by which version of this program."""

    camera: CameraIdentity | None = None
    pixel_format: PixelFormat | None = None
    binning: int | None = None
    gain_db: float | None = None
    date: datetime | None = None
    tool: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ResponseFile:
    """A response function and what is known of it; everything but the curve may be unknown (None, empty)."""

    response: ResponseFunction  # the curve itself
    origin: Origin = Origin()  # where it comes from
    # model, parameters, covered, residual_grey, uncertainty_stops, accurate: see
    # `calibration.response.file.ResponseSolution`
    model: ResponseModel | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    covered: tuple[int, int] | None = None
    residual_grey: float | None = None
    findings: tuple[Finding, ...] = ()  # what was found wrong with the sweep and its solution
    # noise, latency: what else was measured of this camera, as in the file
    noise: Mapping[str, Any] = field(default_factory=dict)
    latency: Mapping[str, Any] = field(default_factory=dict)
    uncertainty_stops: tuple[float, ...] = ()
    accurate: tuple[int, int] | None = None
    # whether the noise of the images could tell that exposure times are in proportion to light
    times_checked: bool | None = None
    path: Path | None = None  # where it was read from; None: nowhere

    @classmethod
    def of_solution(
        cls, solution: ResponseSolution, origin: Origin, findings: tuple[Finding, ...] = ()
    ) -> ResponseFile:
        """The file of a solved sweep."""
        return cls(
            solution.response,
            origin,
            solution.model,
            solution.parameters,
            solution.covered,
            solution.residual_grey,
            findings,
            uncertainty_stops=tuple(solution.uncertainty_stops.tolist()),
            accurate=solution.accurate,
        )

    @classmethod
    def load(cls, path: Path) -> ResponseFile:
        """Read a response file; a file with the curve alone, made by hand, is valid too.

        Raises ConfigurationError naming the file, the key and what to do.
        """
        document = read_document(_Document, path, FORMAT)
        with located(path):
            response = document.response()
        known = {key: value for key, value in document if value is not None}
        origin = Origin(**{part.name: known[part.name] for part in fields(Origin) if part.name in known})
        rest = {part.name: known[part.name] for part in fields(cls) if part.name in known}
        return cls(response, origin, path=path, **rest)

    def save(self, path: Path) -> None:
        """Write the file, the curve last; log2 exposures are rounded to a millionth of a stop.

        Raises ConfigurationError when the file cannot be written.
        """
        origin, curve = self.origin, self.response
        document = {
            "format": FORMAT,
            "camera": origin.camera and asdict(origin.camera),
            "pixel_format": origin.pixel_format and str(origin.pixel_format),
            "binning": origin.binning,
            "gain_db": origin.gain_db,
            "date": origin.date,
            "tool": origin.tool,
            "model": self.model,
            "parameters": {name: _rounded(value) for name, value in self.parameters.items()},
            "covered": self.covered and list(self.covered),
            "accurate": self.accurate and list(self.accurate),
            "residual_grey": None if self.residual_grey is None else round(float(self.residual_grey), 3),
            "times_checked": self.times_checked,
            "findings": [asdict(finding) for finding in self.findings],
            "noise": dict(self.noise),
            "latency": dict(self.latency),
            "black_level": curve.black_level,
            "saturation": curve.saturation,
            "log2_exposure": [_rounded(stops) for stops in curve.log2_exposure],
            "uncertainty_stops": [round(float(stops), 4) for stops in self.uncertainty_stops],
        }
        write_document(path, document)

    def check_belongs(self, serial: str, pixel_format: str | None = None, binning: int | None = None) -> None:
        """Refuse a file of another camera or mode; what the file or the caller does not know is not compared.

        Raises ConfigurationError naming file, key, camera and what to do.
        """
        if self.origin.camera is not None:
            self.origin.camera.check_is(serial, self.path, "response")
        for key, measured, present in (
            ("pixel_format", self.origin.pixel_format, pixel_format),
            ("binning", self.origin.binning, binning),
        ):
            if measured is not None and present is not None and measured != present:
                raise ConfigurationError(
                    f"{self.path}: {key} is {measured}, but camera {serial} runs with {present}: "
                    f"set image.{key} to {measured}, or {to_calibrate('response', serial)}"
                )


class _Document(CalibrationDocument):
    """All keys of a response file."""

    format: Literal["autoexpose-response/1"] = Field(description=f"only {FORMAT!r} can be read")
    log2_exposure: list[_Stops] = Field(
        description=f"give 256 numbers of stops, for grey 0 to 255, within {_LOG2_EXPOSURE}"
    )
    black_level: Annotated[int, Strict()] = Field(description="give a grey level, 0 to 255")
    saturation: Annotated[int, Strict()] = Field(description="give a grey level, 0 to 255")
    pixel_format: PixelFormat | None = optional("give a format of docs/look-up/configuration.md, such as Mono8")
    binning: Annotated[int, Strict(), within(BINNING)] | None = optional(f"give a whole number, {BINNING}")
    gain_db: Annotated[Number, within(GAIN_DB)] | None = optional(f"give a number of dB, {GAIN_DB}")
    model: ResponseModel | None = optional(f"give one of {', '.join(get_args(ResponseModel))}")
    parameters: dict[Text, Number] | None = optional("give numbers by name")
    covered: tuple[_Grey, _Grey] | None = optional("give the first and the last grey level, such as [4, 250]")
    accurate: tuple[_Grey, _Grey] | None = optional("give the first and the last grey level, such as [20, 250]")
    residual_grey: Annotated[Number, within(_RESIDUAL)] | None = optional(f"give {_RESIDUAL}")
    times_checked: bool | None = optional("give true or false")
    noise: dict[Any, Any] | None = optional("keep it as it was written")
    latency: dict[Any, Any] | None = optional("keep it as it was written")
    uncertainty_stops: _Uncertainties | None = optional("give 256 numbers of stops that are not negative")

    @field_validator("covered", "accurate")
    @classmethod
    def _rises(cls, greys: tuple[int, int] | None) -> tuple[int, int] | None:
        if greys is not None and greys[0] > greys[1]:
            raise ValueError("the first grey level is above the last")
        return greys

    def response(self) -> ResponseFunction:
        """The response function; raises ConfigurationError, as that does."""
        return ResponseFunction(np.array(self.log2_exposure), self.black_level, self.saturation)


def _rounded(value: float) -> float:
    return round(float(value), _DECIMALS)


Fact = tuple[str, str]

SIGMAS = 2.0
"""Standard errors that are stated as the error; docs/understand/calibration-method.md says how often it holds."""


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
    return (
        f"at most {well:.2g} stops from grey {low} to {high}{rest}, relative to the light at grey {(low + high) // 2}"
    )


TOP = 255.0
LEAST_STEP = 3e-5
"""Just above what single precision, which those tools use, can distinguish below 255."""
_SAME_STEP = 1.5 * LEAST_STEP


def tum_table(response: ResponseFunction) -> str:
    """One line of 256 numbers: the light of each grey level, strictly increasing from 0 to 255.

    Grey levels that the response does not distinguish, up to the black level and from saturation on, get the least
    step that keeps them apart.
    """
    greys = np.arange(GREY_LEVELS, dtype=np.float64)
    light = TOP * response.light(greys) + LEAST_STEP * greys
    return " ".join(f"{value:.7f}" for value in light * (TOP / light[-1])) + "\n"


def is_tum_table(text: str) -> bool:
    """Whether a text may be such a table: numbers, about as many as there are grey levels."""
    words = text[: 40 * GREY_LEVELS].replace(",", " ").split()
    return len(words) > GREY_LEVELS // 2 and all(word[0] in "+-.0123456789" for word in words)


def read_tum_table(text: str) -> ResponseFunction:
    """The response of such a table, in whatever unit its light is.

    Raises ConfigurationError when it has other than 256 numbers, or they do not rise.
    """
    words = text.replace(",", " ").split()
    if len(words) != GREY_LEVELS:
        raise ConfigurationError(f"has {len(words)} numbers: give 256, the light of each grey level")
    try:
        light = np.array([float(word) for word in words])
    except ValueError as error:
        raise ConfigurationError(f"holds what is no number ({quoted(str(error))}): give 256 numbers") from error
    steps = np.diff(light)
    if not np.isfinite(light).all() or not (steps >= 0).all():
        grey = int(np.flatnonzero(~(steps >= 0))[0]) + 1 if np.isfinite(light).all() else 0
        raise ConfigurationError(f"its numbers must rise from one grey level to the next, but do not at {grey}")
    rising = np.flatnonzero(steps > _SAME_STEP * light[-1] / TOP)
    if len(rising) == 0:
        raise ConfigurationError("its numbers do not rise: calibrate again")
    black, saturation = int(rising[0]), int(rising[-1]) + 1
    light = light[: saturation + 1] - light[black]
    light[: black + 1] = light[black + 1] / 2.0  # as `ResponseFunction.linear` has it
    stops = np.log2(light / light[-1])
    return ResponseFunction(np.append(stops, np.zeros(GREY_LEVELS - len(stops))), black, saturation)
