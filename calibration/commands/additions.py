"""Response files that further measurements of the same camera are added to."""

from __future__ import annotations

from pathlib import Path

from calibration.response.file import ResponseFile
from drivers.errors import ConfigurationError


def response_file_of(path: Path, serial: str) -> ResponseFile:
    """The response file of a camera, looked at before the camera is measured for it.

    Raises
    ------
    ConfigurationError
        When there is none, or it is of another camera.
    """
    if not path.exists():
        raise ConfigurationError(
            f"{path}: no response file is there to add to: make it first with autoexpose calibrate response "
            f"--camera {serial} -o {path}"
        )
    file = ResponseFile.load(path)
    file.check_belongs(serial)
    return file
