"""The page itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from calibration.report import EXTRA
from documents.text import readable
from navigation.store import MapError, MapFile


def write_report(file: MapFile, facts: Mapping[str, str], page: Path) -> None:
    """Write the page of a map.

    Parameters
    ----------
    file
        The map.
    facts
        What to show above the pictures.
    page
        The HTML file; an existing one is replaced.

    Raises
    ------
    MapError
        When it cannot be written, or packages are missing.
    """
    try:
        import jinja2  # noqa: PLC0415  extras, which only reports need

        from navigation.report.findings import findings  # noqa: PLC0415
        from navigation.report.plots import pictures  # noqa: PLC0415
    except ImportError as error:
        package = EXTRA.get(str(error.name), error.name)
        raise MapError(f"{package} is missing: pip install 'autoexpose-daemon[calibration]'") from error
    packages = ("navigation.report", "calibration.report")  # the second has the style
    loaders = [jinja2.PackageLoader(package, "") for package in packages]
    environment = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), autoescape=True)
    shown = pictures(findings(file))
    text = environment.get_template("page.html").render(
        title=f"Map {file.path.name}", facts=list(facts.items()), pictures=shown
    )
    try:
        page.write_text(text, encoding="utf-8")
    except OSError as error:
        raise MapError(f"{page} cannot be written: {readable(str(error.strerror))}") from error
