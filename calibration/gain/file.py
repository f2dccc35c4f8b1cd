"""A gain file: what the numbers of one camera's gain are in dB."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from calibration.document import (
    CalibrationDocument,
    CameraIdentity,
    Finding,
    Name,
    Number,
    optional,
    read_document,
    within,
    write_document,
)
from documents.bounds import GAIN_DB, Range
from imaging.gain_scale import GainScale
from imaging.python310 import Self

FORMAT = "autoexpose-gain/1"
_ERROR_DB = Range(0.0, 100.0, "dB")
_SETTING = Range(-1e9, 1e9)
_Gain = Annotated[Number, within(GAIN_DB)]
_Setting = Annotated[Number, within(_SETTING)]


@dataclass(frozen=True, slots=True)
class GainFile:
    """The scale of a gain, the camera it belongs to, and how well it is known.

    Attributes
    ----------
    scale
        The scale itself.
    camera
        Which camera it was measured with; None: the file does not say.
    error_db
        How far any gain may be from the truth; None: the file does not say.
    date, tool
        When, and by which version.
    findings
        What made the verdict `with care`.
    path
        Where it was read from; None: nowhere.
    """

    scale: GainScale
    camera: CameraIdentity | None = None
    error_db: float | None = None
    date: datetime | None = None
    tool: str | None = None
    findings: tuple[Finding, ...] = ()
    path: Path | None = None

    @classmethod
    def load(cls, path: Path) -> GainFile:
        """Read a gain file.

        Raises
        ------
        ConfigurationError
            Naming the file, the key and what to do.
        """
        document = read_document(_Document, path, FORMAT)
        scale = GainScale(document.node, document.settings, document.gains_db)
        return cls(
            scale, document.camera, document.error_db, document.date, document.tool, document.findings or (), path
        )

    def save(self, path: Path) -> None:
        """Write the file; ConfigurationError when it cannot be written."""
        document: dict[str, Any] = {
            "format": FORMAT,
            "camera": self.camera and asdict(self.camera),
            "node": self.scale.node,
            "date": self.date,
            "tool": self.tool,
            "error_db": self.error_db,
            "findings": [asdict(finding) for finding in self.findings],
            "settings": list(self.scale.settings),
            "gains_db": [round(gain_db, 4) for gain_db in self.scale.gains_db],
        }
        write_document(path, document)

    def check_belongs(self, serial: str) -> None:
        """Refuse a file of another camera; ConfigurationError names file, camera and what to do."""
        if self.camera is not None:
            self.camera.check_is(serial, self.path, "gain")


class _Document(CalibrationDocument):
    """All keys of a gain file."""

    format: Literal["autoexpose-gain/1"] = Field(description=f"only {FORMAT!r} can be read")
    node: Name = Field(description="give the name of the gain's node")
    error_db: Annotated[Number, within(_ERROR_DB)] | None = optional(f"give {_ERROR_DB}")
    settings: Annotated[tuple[_Setting, ...], Field(min_length=2)] = Field(
        description=f"give two or more numbers that rise, of {_SETTING}"
    )
    gains_db: Annotated[tuple[_Gain, ...], Field(min_length=2)] = Field(
        description=f"give two or more numbers that rise, of {GAIN_DB}"
    )

    @model_validator(mode="after")
    def _is_a_scale(self) -> Self:
        if len(self.settings) != len(self.gains_db):
            raise ValueError(f"{len(self.settings)} settings for {len(self.gains_db)} gains_db: give as many")
        if any(after <= before for before, after in zip(self.settings, self.settings[1:], strict=False)):
            raise ValueError("settings must rise from one to the next: measure them again")
        falls = any(after < before for before, after in zip(self.gains_db, self.gains_db[1:], strict=False))
        if falls or self.gains_db[0] == self.gains_db[-1]:
            raise ValueError("gains_db must rise with settings, and may not fall: measure them again")
        return self
