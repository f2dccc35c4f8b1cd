"""The page of a contest: the figures, and what each policy saw at the same instants."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from documents.text import readable
from evaluation.rejudge.contest import Outcome
from evaluation.rejudge.drive import Drive
from imaging.errors import AutoexposeError

WIDTH = 240
"""Of a picture, pixels."""


def write_report(drive: Drive, outcomes: Sequence[Outcome], result: Mapping[str, Any], page: Path) -> None:
    """Write the page; an existing one is replaced.

    Parameters
    ----------
    drive, outcomes
        What was judged.
    result
        As `contest.document` returns it.
    page
        The HTML file.

    Raises
    ------
    AutoexposeError
        When it cannot be written, or packages are missing.
    """
    try:
        import jinja2  # noqa: PLC0415  an extra, which only reports need
    except ImportError as error:
        raise AutoexposeError("jinja2 is missing: pip install 'autoexpose-daemon[calibration]'") from error
    loaders = [jinja2.PackageLoader(package, "") for package in ("evaluation.rejudge", "calibration.report")]
    environment = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), autoescape=True)
    rows = [
        {
            "figures": outcome.figures,
            "pictures": [
                {"jpeg": _jpeg(picture), "caption": caption}
                for picture, caption in zip(outcome.pictures, outcome.captions, strict=True)
            ],
        }
        for outcome in outcomes
    ]
    text = environment.get_template("report.html").render(
        title=f"Policies on {Path(drive.name).name}", drive=drive, rows=rows, **result
    )
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise AutoexposeError(f"{page} cannot be written: {readable(str(error.strerror))}") from error


def _jpeg(picture: NDArray[np.uint8]) -> str:
    height = round(WIDTH * picture.shape[0] / picture.shape[1])
    small = cv2.resize(picture, (WIDTH, height), interpolation=cv2.INTER_AREA)
    return base64.b64encode(cv2.imencode(".jpg", small)[1].tobytes()).decode()
