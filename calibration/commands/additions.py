"""Adding further measurements of the same camera to its response file."""

from __future__ import annotations

from pathlib import Path

from calibration.response.file import ResponseFile
from imaging.errors import ConfigurationError


def response_file_of(path: Path, serial: str) -> ResponseFile:
    """The response file of a camera, checked before the measurement.

    Raises
    ------
    ConfigurationError
        When it does not exist, or is of another camera.
    """
    if not path.exists():
        raise ConfigurationError(
            f"{path}: there is no response file to add to: make it first with autoexpose calibrate response "
            f"--camera {serial} -o {path}"
        )
    file = ResponseFile.load(path)
    file.check_belongs(serial)
    return file
