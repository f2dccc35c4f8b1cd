"""The report of a lens's vignetting: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from calibration.response.facts import Fact
from calibration.vignetting.result import VignettingResult


def write_vignetting_report(path: Path, result: VignettingResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.pictures_page import write_page  # noqa: PLC0415  needs an extra
    from calibration.report.vignetting_plots import vignetting_pictures  # noqa: PLC0415

    return write_page(
        path, "vignetting.html", vignetting_pictures(result), result=result, facts=list(vignetting_facts(result))
    )


def vignetting_facts(result: VignettingResult) -> Iterator[Fact]:
    """What was measured, in words."""
    yield "looks", f"{len(result.looks)}, of {result.size[0]}x{result.size[1]} pixels"
    if result.slope is not None:
        yield "response", f"half the exposure time gives {2.0**-result.slope:.3f} of the light"
    elif result.looks:
        yield "response", "not checked, as it takes two exposure times"
    solution = result.solution
    if solution is None or result.error is None:
        return
    vignetting = solution.vignetting
    column, row = vignetting.centre_px
    yield "model", solution.kind if vignetting.grid else f"{solution.kind}, ({column:.1f}, {row:.1f})"
    light = vignetting.relative_light(result.size[1], result.size[0])
    corners = ", ".join(f"{light[y, x]:.3f}" for y in (0, -1) for x in (0, -1))
    yield "light in the corners", f"{corners} of the brightest place (upper left, upper right, lower left, lower right)"
    yield "error", f"{result.error:.1%} of the light at most, if the surface is evenly lit"
    held_out = ", ".join(f"{kind} {error:.2%}" for kind, error in solution.held_out.items())
    yield "looks held out", f"off by (rms): {held_out}"
