"""A self-contained page of facts and pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import jinja2

from calibration.report.plots import Picture, one_png
from imaging.errors import ConfigurationError


def write_page(path: Path, template: str, pictures: Sequence[Picture], **content: object) -> Path:
    """Write the page that a template of this folder makes from its content, and return its path.

    Raises
    ------
    ConfigurationError
        When it cannot be written.
    """
    environment = jinja2.Environment(loader=jinja2.PackageLoader("calibration.report", ""), autoescape=True)
    shown = [(picture, base64.b64encode(one_png(picture)).decode()) for picture in pictures]
    page = environment.get_template(template).render(pictures=shown, **content)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be written ({error.strerror}): choose another place") from error
    return path
