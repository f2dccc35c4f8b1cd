"""Section `cameras`: which they are, and the files and features of each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, PlainSerializer, model_validator

from autoexpose_daemon.config.section import ExposureCountUs, FileName, Name, Section
from drivers.setup import FeatureSetting, as_list, parse_features
from imaging.python310 import Self


def _refuse_number(serial: object) -> object:
    if isinstance(serial, int | float):  # as a number it may have lost leading zeros already
        raise ValueError("is a number to YAML: put the serial in quotes, as `autoexpose list` shows it")
    return serial


Features = Annotated[tuple[FeatureSetting, ...], BeforeValidator(parse_features), PlainSerializer(as_list)]


class CameraConfig(Section):
    """One camera: its serial, its calibration files (without a response file it is linear), and features to set.

    `exposure_count_us` are the microseconds in a count of an exposure time whose unit the camera does not give.
    """

    serial: Annotated[Name, BeforeValidator(_refuse_number)]
    response: FileName | None = None
    gain_calibration: FileName | None = None
    calibration: FileName | None = None
    vignetting: FileName | None = None
    exposure_count_us: ExposureCountUs | None = None
    features: Features = ()

    def relative_to(self, folder: Path) -> Self:
        """The same with the paths of its files relative to `folder`."""
        files = {key: getattr(self, key) for key in ("response", "gain_calibration", "calibration", "vignetting")}
        return self.model_copy(update={key: path and folder / path for key, path in files.items()})


class CamerasConfig(Section):
    """The cameras of the rig; a rig with one camera has only `left`."""

    left: CameraConfig
    right: CameraConfig | None = None

    @model_validator(mode="after")
    def _two_cameras_are_two(self) -> Self:
        if self.right is None or self.right.serial.casefold() != self.left.serial.casefold():
            return self
        if self.right.serial == self.left.serial:
            raise ValueError(f"left and right are the same camera, {self.left.serial}")
        raise ValueError(
            f"left and right differ only in case, {self.left.serial} and {self.right.serial}: give each serial "
            "as `autoexpose list` shows it"
        )
