"""The report of a lens's vignetting: one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from calibration.report.plots import INK, Picture
from calibration.response.file import Fact
from calibration.vignetting.field import Array
from calibration.vignetting.result import VignettingResult, residuals
from imaging.vignetting import middles, radius_squared

_LEVELS = np.arange(0.05, 1.0, 0.05)
_LEAST_REACH = 0.005


def vignetting_pictures(result: VignettingResult) -> list[Picture]:
    """The plots that a result has the data for."""
    if not result.looks:
        return []
    if result.mean is None or result.solution is None:
        draw = partial(_draw_map, values=_relative(result.looks[0].light), size=result.size)
        return [Picture("The first look", "Its light, relative to its brightest part.", draw)]
    return [
        Picture(
            "Light in the picture",
            "Mean of all looks, relative to its brightest part. Lines: one for each twentieth of the light.",
            partial(_draw_light, light=result.mean, size=result.size),
        ),
        Picture(
            "Light over radius",
            "Dots: parts of the picture, by their distance from the centre of the model. Line: the model along the "
            "half diagonals.",
            partial(_draw_radius, result=result),
        ),
        Picture(
            "Residual",
            "How much brighter each part of the picture is than the model says (%). It should be noise: a slope from "
            "side to side is uneven light, rings are a lens that the model does not follow.",
            partial(_draw_residual, result=result),
        ),
        Picture(
            "Looks",
            "By how much each look differs from the mean of all, root mean square over the picture: what uneven light "
            "changes when the camera is turned.",
            partial(_draw_looks, result=result),
        ),
    ]


def _draw_light(axes: Axes, light: Array, size: tuple[int, int]) -> None:
    relative = _relative(light)
    _draw_map(axes, relative, size)
    x, y = middles(light.shape[1], size[0]), middles(light.shape[0], size[1])
    levels = _LEVELS[(relative.min() < _LEVELS) & (relative.max() > _LEVELS)]
    if len(levels):
        lines = axes.contour(x, y, relative, levels=levels, colors="#d55e00", linewidths=1.0)
        axes.clabel(lines, fontsize=8, fmt="%.2f")


def _draw_radius(axes: Axes, result: VignettingResult) -> None:
    assert result.solution is not None and result.mean is not None
    vignetting, light, size = result.solution.vignetting, result.mean, result.size
    x, y = middles(light.shape[1], size[0]), middles(light.shape[0], size[1])
    radius = np.sqrt(radius_squared(x, y, vignetting.centre_px, size))
    relative = light / light.mean()
    model = vignetting.relative_light(*light.shape)
    axes.plot(radius.ravel(), (relative * model.mean()).ravel(), ".", ms=2, color="#0072b2", rasterized=True)
    rows = np.arange(light.shape[0])
    for columns in (rows, rows[::-1]):
        along = np.round(columns * (light.shape[1] - 1) / max(light.shape[0] - 1, 1)).astype(int)
        order = np.argsort(radius[rows, along])
        axes.plot(radius[rows, along][order], model[rows, along][order], color=INK, lw=1.0)
    axes.set_ylim(0, 1.05)
    axes.set_xlabel("distance from the centre (half diagonals)")
    axes.set_ylabel("relative light")


def _draw_residual(axes: Axes, result: VignettingResult) -> None:
    assert result.solution is not None and result.mean is not None
    percent = 100.0 * residuals(result.solution.vignetting, result.mean)
    reach = max(float(np.abs(percent).max()), 100.0 * _LEAST_REACH)
    _draw_map(axes, percent, result.size, "coolwarm", (-reach, reach))


def _draw_looks(axes: Axes, result: VignettingResult) -> None:
    seen = np.array([look.light for look in result.looks])
    percent = 100.0 * np.sqrt(np.mean((seen / seen.mean(axis=0) - 1.0) ** 2, axis=(1, 2)))
    axes.bar(np.arange(1, len(percent) + 1), percent, color="#0072b2")
    axes.set_ylim(0, max(100.0 * _LEAST_REACH, 1.1 * float(percent.max())))
    axes.set_xlabel("look")
    axes.set_ylabel("difference from the mean (% rms)")


def _relative(light: Array) -> Array:
    return np.asarray(light / max(float(light.max()), 1e-9))


def _draw_map(
    axes: Axes,
    values: Array,
    size: tuple[int, int],
    colours: str = "grey",
    span: tuple[float, float] = (0.0, 1.0),
) -> None:
    width, height = size
    extent = (-0.5, width - 0.5, height - 0.5, -0.5)
    shown = axes.imshow(values, cmap=colours, vmin=span[0], vmax=span[1], extent=extent, interpolation="nearest")
    axes.figure.colorbar(shown, ax=axes, fraction=0.04, pad=0.02)
    axes.set_xlabel("column (pixels)")
    axes.set_ylabel("row (pixels)")


def write_vignetting_report(path: Path, result: VignettingResult) -> Path:
    """Write the page, and return its path; raises ConfigurationError when it cannot be written."""
    from calibration.report.page import write_page  # noqa: PLC0415  needs an extra
    from calibration.report.vignetting import vignetting_pictures  # noqa: PLC0415

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
