"""A response file with all that it says besides the curve: whose it is, how it was made, how well it is known."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from pathlib import Path
from typing import Any, get_args

import numpy as np
import yaml

from calibration.findings import Finding
from calibration.response import FORMAT, GREY_LEVELS, ResponseFunction, is_number, load_response_document
from calibration.solution import ResponseModel, ResponseSolution
from drivers.errors import ConfigurationError
from drivers.pixel_format import PIXEL_FORMATS, PixelFormat

_DECIMALS = 6
"""A millionth of a stop is far below what any sweep resolves, and keeps the file readable."""


@dataclass(frozen=True, slots=True)
class CameraIdentity:
    """Which camera a file is of."""

    vendor: str
    model: str
    serial: str


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
    """A response function and what is known of it; everything but the curve may be unknown (None, empty).

    Attributes
    ----------
    response
        The curve itself.
    origin
        Where it comes from.
    model, parameters, covered, residual_grey, uncertainty_stops
        See `calibration.solution.ResponseSolution`.
    findings
        What was found wrong with the sweep and its solution.
    noise, latency
        What else was measured of this camera, as it stands in the file.
    path
        Where it was read from; None: nowhere.
    """

    response: ResponseFunction
    origin: Origin = Origin()
    model: ResponseModel | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    covered: tuple[int, int] | None = None
    residual_grey: float | None = None
    findings: tuple[Finding, ...] = ()
    noise: Mapping[str, Any] = field(default_factory=dict)
    latency: Mapping[str, Any] = field(default_factory=dict)
    uncertainty_stops: tuple[float, ...] = ()
    path: Path | None = None

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
        )

    @classmethod
    def load(cls, path: Path) -> ResponseFile:
        """Read a response file; a file with the curve alone, made by hand, is as good.

        Raises
        ------
        ConfigurationError
            Naming the file, the key and what to do.
        """
        document = load_response_document(path)
        response = ResponseFunction.from_document(document, path)
        known = {key: document[key] for key in _CHECKS if document.get(key) is not None}
        for key, value in known.items():
            valid, advice = _CHECKS[key]
            if not valid(value):
                raise ConfigurationError(f"{path}: {key} is {reprlib.repr(value)}: {advice}, or remove it")
        if "camera" in known:
            known["camera"] = CameraIdentity(**known["camera"])
        if "pixel_format" in known:
            known["pixel_format"] = PIXEL_FORMATS[known["pixel_format"]]
        for key in ("covered", "uncertainty_stops"):
            if key in known:
                known[key] = tuple(known[key])
        known["findings"] = tuple(Finding(**finding) for finding in known.get("findings", ()))
        origin = Origin(**{part.name: known.pop(part.name, None) for part in fields(Origin)})
        return cls(response, origin, path=path, **known)

    def save(self, path: Path) -> None:
        """Write the file, the curve last; log2 exposures are rounded to a millionth of a stop.

        Raises
        ------
        ConfigurationError
            When the file cannot be written.
        """
        origin, camera, curve = self.origin, self.origin.camera, self.response
        document = {
            "format": FORMAT,
            "camera": camera and {"vendor": camera.vendor, "model": camera.model, "serial": camera.serial},
            "pixel_format": origin.pixel_format and str(origin.pixel_format),
            "binning": origin.binning,
            "gain_db": origin.gain_db,
            "date": origin.date,
            "tool": origin.tool,
            "model": self.model,
            "parameters": {name: _rounded(value) for name, value in self.parameters.items()},
            "covered": self.covered and list(self.covered),
            "residual_grey": None if self.residual_grey is None else round(float(self.residual_grey), 3),
            "findings": [{"severity": f.severity, "reason": f.reason, "text": f.text} for f in self.findings],
            "noise": dict(self.noise),
            "latency": dict(self.latency),
            "black_level": curve.black_level,
            "saturation": curve.saturation,
            "log2_exposure": [_rounded(stops) for stops in curve.log2_exposure],
            "uncertainty_stops": [round(float(stops), 4) for stops in self.uncertainty_stops],
        }
        said = {key: value for key, value in document.items() if value not in (None, {}, [])}
        text = yaml.safe_dump(said, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error

    def check_belongs(self, serial: str, pixel_format: str | None = None, binning: int | None = None) -> None:
        """Refuse a file of another camera or mode; what the file or the caller does not know is not compared.

        Raises
        ------
        ConfigurationError
            Naming file, key, camera and what to do.
        """
        remedy = f"calibrate this one: autoexpose calibrate response --camera {serial}"
        camera = self.origin.camera
        if camera is not None and camera.serial != serial:
            raise ConfigurationError(
                f"{self.path}: camera.serial is {camera.serial}, but this is camera {serial}: name its own file, "
                f"or {remedy}"
            )
        for key, measured, present in (
            ("pixel_format", self.origin.pixel_format, pixel_format),
            ("binning", self.origin.binning, binning),
        ):
            if measured is not None and present is not None and measured != present:
                raise ConfigurationError(
                    f"{self.path}: {key} is {measured}, but camera {serial} runs with {present}: "
                    f"set image.{key} to {measured}, or {remedy}"
                )


def _rounded(value: float) -> float:
    return round(float(value), _DECIMALS)


def _is_camera(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"vendor", "model", "serial"}
        and all(isinstance(part, str) and part for part in value.values())
    )


def _is_finding(value: Any) -> bool:
    return (
        isinstance(value, dict)
        and value.keys() == {"severity", "reason", "text"}
        and value["severity"] in ("refused", "warned")
        and all(isinstance(part, str) for part in value.values())
    )


def _is_finite(value: Any) -> bool:
    return is_number(value) and math.isfinite(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_range(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == 2
        and all(type(grey) is int for grey in value)
        and 0 <= value[0] <= value[1] < GREY_LEVELS
    )


def _are_uncertainties(value: Any) -> bool:
    return (
        isinstance(value, list)
        and len(value) == GREY_LEVELS
        and all(_is_finite(stops) for stops in value)
        and bool((np.array(value) >= 0).all())
    )


_CHECKS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "camera": (_is_camera, 'give {vendor: ..., model: ..., serial: "..."}, each in quotes'),
    "pixel_format": (lambda value: value in list(PIXEL_FORMATS), f"give one of {', '.join(PIXEL_FORMATS)}"),
    "binning": (lambda value: type(value) is int and value > 0, "give a whole number of pixels"),
    "gain_db": (_is_finite, "give a number of dB"),
    "date": (lambda value: isinstance(value, datetime), "give date and time, such as 2026-11-21 12:00:00"),
    "tool": (_is_text, "give name and version in quotes"),
    "model": (lambda value: value in get_args(ResponseModel), f"give one of {', '.join(get_args(ResponseModel))}"),
    "parameters": (
        lambda value: isinstance(value, dict) and all(map(_is_text, value)) and all(map(_is_finite, value.values())),
        "give numbers by name",
    ),
    "covered": (_is_range, "give the first and the last grey level, such as [4, 250]"),
    "residual_grey": (_is_finite, "give a number of grey levels"),
    "findings": (lambda value: isinstance(value, list) and all(map(_is_finding, value)), "keep it as it was written"),
    "noise": (lambda value: isinstance(value, dict), "keep it as it was written"),
    "latency": (lambda value: isinstance(value, dict), "keep it as it was written"),
    "uncertainty_stops": (_are_uncertainties, "give 256 numbers that are not negative"),
}
