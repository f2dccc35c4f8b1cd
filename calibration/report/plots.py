"""The pictures of calibration reports. Curves differ in dash or marker, not in colour alone."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.geometry.board import CELLS
from calibration.geometry.fit import GOOD_ERROR_PX, GeometryResult
from calibration.response.file import ResponseSolution
from calibration.response.result import Result
from calibration.vignetting.field import Array
from calibration.vignetting.result import VignettingResult, residuals
from imaging.geometry import SIDES, Side
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_table
from imaging.vignetting import middles, radius_squared

DASHES: Sequence[tuple[float, str, str, str]] = (
    (-2.0, "#0072b2", ":", "v"),
    (-1.0, "#56b4e9", "--", "s"),
    (-0.5, "#009e73", "-.", "D"),
    (0.5, "#e69f00", "-.", "P"),
    (1.0, "#d55e00", "--", "o"),
    (2.0, "#7d3c6b", ":", "^"),
)
"""Changes of exposure level (stops), each with its colour (after Okabe and Ito), dash and marker."""
INK = "#1b1b1b"
UNSEEN: dict[str, Any] = {"facecolor": "none", "edgecolor": "#999999", "hatch": "///", "lw": 0, "alpha": 0.5}
"""How grey levels that the sweep did not see are drawn."""
_HATCHED = " Hatched: grey levels beyond the covered range, where the curve is extended or little known."
LEAST_HATCHED = 4
"""Fewer grey levels are too narrow to show hatching."""
LEAST_DRAWN_STOPS = 1e-5
MOST_POINTS = 4000
MOST_RINGS = 250
GREYS = np.arange(GREY_LEVELS)


@dataclass(frozen=True, slots=True)
class ReportPicture:
    """One plot: what it is called, what it shows in a sentence or two, and what draws it."""

    title: str
    caption: str
    draw: Callable[[Axes], None]


def pictures(result: Result) -> list[ReportPicture]:
    """The plots that a result has the data for."""
    sweep = [
        ReportPicture(
            "The sweep",
            "Mean grey level of the parts of the scene over exposure time, the first time and when it was repeated.",
            lambda axes: _draw_sweep(axes, result),
        ),
        ReportPicture(
            "Repeats",
            "By how much shots of one exposure differ from their mean: a drift or a step of the light shows here, "
            "flicker as scatter, a moved scene as outliers.",
            lambda axes: _draw_repeats(axes, result),
        ),
    ]
    solution = result.solution
    if solution is None:
        return sweep
    hatched = _HATCHED if any(top - bottom >= LEAST_HATCHED for bottom, top in _unseen(solution)) else ""
    return [
        ReportPicture(
            "Response",
            "Rings: parts of the scene, each placed by its own radiance. Line: the response, with twice its standard "
            f"error.{hatched}",
            lambda axes: _draw_response(axes, result, solution),
        ),
        ReportPicture(
            "Predictions",
            "Grey level of a pixel after a change of exposure level (stops), which is what the daemon decides with.",
            lambda axes: _draw_predictions(axes, solution.response),
        ),
        ReportPicture(
            "Residual",
            "Grey levels seen minus those predicted from other exposures. The black line is the mean; dashed: one grey "
            "level.",
            lambda axes: _draw_residual(axes, result),
        ),
        ReportPicture(
            "Uncertainty",
            "Standard error of the response, relative to the light in the middle between the dashed lines, since only "
            "ratios of light are known; a tenth of a stop is 7 % of the light. The error stated is twice the largest "
            f"value between the dashed lines.{hatched}",
            lambda axes: _draw_uncertainty(axes, solution),
        ),
        *sweep,
    ]


def comparison_picture(left: ResponseFunction, right: ResponseFunction) -> ReportPicture:
    """Both responses of a rig in one plot."""

    def draw(axes: Axes) -> None:
        for response, name, dash, colour in ((left, "left", "-", "#0072b2"), (right, "right", "--", "#d55e00")):
            open_part = slice(response.black_level, response.saturation + 1)
            axes.plot(response.log2_exposure[open_part], GREYS[open_part], dash, color=colour, lw=1.8, label=name)
        _finish(axes, "log2 exposure (stops from saturation)", "grey level")
        axes.set_ylim(0, 256)
        axes.legend(loc="upper left", frameon=False)

    return ReportPicture("Left and right", "Both cameras' responses, each at 0 stops where it saturates.", draw)


def one_png(picture: ReportPicture) -> bytes:
    """A picture by itself, as PNG."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained", dpi=110)
    picture.draw(figure.subplots())
    return _png(figure)


def overview_png(title: str, shown: Sequence[ReportPicture]) -> bytes:
    """All pictures on one sheet, as PNG."""
    rows = (len(shown) + 1) // 2
    figure = Figure(figsize=(12, 4 * rows), layout="constrained", dpi=110)
    figure.suptitle(title, color=INK)
    grid = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes, picture in zip(grid, shown, strict=False):
        picture.draw(axes)
        axes.set_title(picture.title, loc="left", color=INK)
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    return _png(figure)


def _png(figure: Figure) -> bytes:
    mpl.use("Agg")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _finish(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_response(axes: Axes, result: Result, solution: ResponseSolution) -> None:
    response = solution.response
    tones = result.by_exposure
    greys = tones.greys - tones.middle
    stops = response.inverse_between(greys)
    open_ends = (greys > response.black_level + 1) & (greys < response.saturation - 1)
    radiances = stops - tones.levels[:, None]
    own = [np.median(part[seen]) if seen.any() else np.nan for part, seen in zip(radiances.T, open_ends.T, strict=True)]
    placed = tones.levels[:, None] + np.array(own)
    x, y = placed[open_ends], greys[open_ends]
    every = max(len(x) // MOST_RINGS, 1)
    inside = slice(response.black_level, response.saturation + 1)
    curve, error = response.log2_exposure[inside], 2.0 * solution.uncertainty_stops[inside]
    axes.fill_betweenx(GREYS[inside], curve - error, curve + error, color="#56b4e9", alpha=0.45, lw=0, label="2 sigma")
    axes.plot(curve, GREYS[inside], color="#0072b2", lw=2.5, label=f"response ({solution.model})")
    axes.plot(x[::every], y[::every], "o", mfc="none", color=INK, ms=4, mew=0.7, alpha=0.6, label="sweep")
    for bottom, top in _unseen(solution):
        axes.axhspan(bottom, top, **UNSEEN)
    axes.set_ylim(0, GREY_LEVELS)
    axes.set_xlim(curve[1] - 0.5, 0.5)
    axes.legend(loc="upper left", frameon=False)
    _finish(axes, "log2 exposure (stops from saturation)", "grey level")


def _unseen(solution: ResponseSolution) -> tuple[tuple[int, int], tuple[int, int]]:
    """The grey levels below and above those that the sweep covers."""
    low, high = solution.covered
    return (0, low), (high, GREY_LEVELS - 1)


def _draw_uncertainty(axes: Axes, solution: ResponseSolution) -> None:
    axes.semilogy(GREYS, np.maximum(solution.uncertainty_stops, LEAST_DRAWN_STOPS), "-", color="#0072b2", lw=1.8)
    for bottom, top in _unseen(solution):
        axes.axvspan(bottom, top, **UNSEEN)
    for end in solution.accurate or ():
        axes.axvline(end, color=INK, lw=0.9, ls="--")
    axes.set_xlim(0, GREY_LEVELS)
    _finish(axes, "grey level", "standard error (stops)")


def _draw_predictions(axes: Axes, response: ResponseFunction) -> None:
    axes.plot([0, 255], [0, 255], "-", color="#999999", lw=1)
    for place, (delta, colour, dash, marker) in enumerate(DASHES):
        table = prediction_table(response, delta)
        marks = (10 + 6 * place, 40)
        axes.plot(
            GREYS, table, dash, color=colour, lw=1.5, marker=marker, ms=5, markevery=marks, label=f"{delta:+g} stops"
        )
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], labels[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes.set_xlim(0, 256)
    axes.set_ylim(0, 258)
    _finish(axes, "grey level now", "grey level predicted")


def _draw_residual(axes: Axes, result: Result) -> None:
    match = result.agreement
    if match is None or not match.enough:
        axes.text(0.5, 0.5, "no two exposures share grey levels", transform=axes.transAxes, ha="center")
        return
    deviation = match.seen - match.predicted
    for delta, colour, _, marker in DASHES:
        part = match.near(delta)
        every = max(len(part.seen) // (MOST_POINTS // len(DASHES)), 1)
        x, y = part.seen[::every], (part.seen - part.predicted)[::every]
        axes.plot(x, y, marker, color=colour, ms=2.5, alpha=0.35, lw=0, label=f"{delta:+g} stops", rasterized=True)
    bins = np.arange(0, GREY_LEVELS + 8, 8)
    place = np.digitize(match.seen, bins) - 1
    filled = [b for b in range(len(bins) - 1) if (place == b).sum() > 3]
    axes.plot(bins[filled] + 4, [deviation[place == b].mean() for b in filled], "-", color=INK, lw=1.5, label="mean")
    for grey in (-1.0, 1.0):
        axes.axhline(grey, color=INK, lw=0.8, ls="--")
    reach = max(2.0, 1.5 * match.worst_grey)
    axes.set_ylim(-reach, reach)
    axes.set_xlim(0, GREY_LEVELS)
    axes.legend(loc="upper left", ncols=4, frameon=False, fontsize="small", markerscale=2)
    _finish(axes, "grey level seen", "seen minus predicted (grey levels)")


def _draw_sweep(axes: Axes, result: Result) -> None:
    times_ms = np.array([shot.setting.exposure_time_us for shot in result.sweep.shots]) * 1e-3
    tones = result.by_shot
    first, again = _first_pass(times_ms)
    brightness = tones.greys.mean(axis=1)
    axes.set_xscale("log")
    axes.set_xlim(times_ms.min() / 1.5, times_ms.max() * 1.5)  # there may be one exposure only
    axes.fill_between(
        times_ms[first],
        tones.greys[first].min(axis=1),
        tones.greys[first].max(axis=1),
        color="#56b4e9",
        alpha=0.2,
        lw=0,
    )
    axes.plot(times_ms[first], brightness[first], "-o", color="#0072b2", ms=5, lw=1.2, label="first pass")
    if len(again):
        axes.plot(times_ms[again], brightness[again], "--x", color="#d55e00", ms=6, lw=1.2, label="repeated")
    axes.set_ylim(0, 258)
    axes.legend(loc="upper left", frameon=False)
    _finish(axes, "exposure time (ms)", "grey level: mean, darkest to brightest part")


def _first_pass(times_ms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shots until the exposure time first stops rising, and those after it."""
    falls = np.flatnonzero(np.diff(times_ms) < -0.01 * times_ms[:-1])
    turn = int(falls[0]) + 1 if len(falls) else len(times_ms)
    return np.arange(turn), np.arange(turn, len(times_ms))


def _draw_repeats(axes: Axes, result: Result) -> None:
    shots, tones = result.sweep.shots, result.by_shot
    brightness = tones.greys.mean(axis=1)
    levels = np.round([shot.setting.level for shot in shots], 2)
    means = {level: brightness[levels == level].mean() for level in np.unique(levels)}
    deviation = brightness - np.array([means[level] for level in levels])
    times = [shot.time_s for shot in shots if shot.time_s is not None]
    timed = len(times) == len(shots)
    x = np.array(times) - times[0] if timed else np.arange(len(shots))
    axes.plot(x, deviation, ".-", color="#0072b2", ms=5, lw=0.6)
    for grey in (-1.0, 1.0):
        axes.axhline(grey, color=INK, lw=0.8, ls="--")
    reach = max(2.0, 1.2 * float(np.abs(deviation).max()))
    axes.set_ylim(-reach, reach)
    _finish(axes, "time (s)" if timed else "number of the image", "difference to repeats (grey levels)")


COLOURS: dict[Side, str] = {"left": "#0072b2", "right": "#d55e00"}
MARKERS: dict[Side, str] = {"left": "o", "right": "x"}


def geometry_pictures(result: GeometryResult) -> list[ReportPicture]:
    """The plots that a result has the data for."""
    coverage = [
        ReportPicture(
            f"Corners in the {side} picture",
            "All corners seen. Parts without any, between the dashed lines, are known by extrapolation only.",
            partial(_draw_corners, result=result, side=side),
        )
        for side in SIDES
    ]
    if not result.used:
        return coverage
    errors = ReportPicture(
        "Reprojection error of each picture",
        "Root mean square over its corners, in the order in which views were taken. Grey bands: views held out of the "
        "fit.",
        partial(_draw_errors, result=result),
    )
    return [*coverage, errors]


def _draw_corners(axes: Axes, result: GeometryResult, side: Side) -> None:
    width, height = result.size
    for view in result.views:
        if side in view.corners:
            x, y = view.corners[side].pixels.T
            axes.plot(x, y, ".", ms=3, color=COLOURS[side], alpha=0.6, rasterized=True)
    for x in np.linspace(0, width, CELLS[1] + 1):
        axes.axvline(float(x), color=INK, lw=0.4, ls="--")
    for y in np.linspace(0, height, CELLS[0] + 1):
        axes.axhline(float(y), color=INK, lw=0.4, ls="--")
    axes.set_xlim(0, max(width, 1))
    axes.set_ylim(max(height, 1), 0)
    axes.set_aspect("equal")
    axes.set_xlabel("column (pixels)")
    axes.set_ylabel("row (pixels)")


def _draw_errors(axes: Axes, result: GeometryResult) -> None:
    scores = sorted((*result.used, *result.held_out), key=lambda score: score.name)
    held_out = {score.name for score in result.held_out}
    for place, score in enumerate(scores):
        if score.name in held_out:
            axes.axvspan(place - 0.5, place + 0.5, color="#dddddd", lw=0)
    for side in SIDES:
        points = [(place, score.error_px[side]) for place, score in enumerate(scores) if side in score.error_px]
        axes.plot(*zip(*points, strict=True), MARKERS[side], color=COLOURS[side], ms=5, label=side)
    axes.axhline(GOOD_ERROR_PX, color=INK, lw=0.8, ls="--")
    axes.set_ylim(0, None)
    axes.legend(loc="center right", frameon=False)
    axes.set_xlabel("view")
    axes.set_ylabel("error (pixels rms)")


_LEVELS = np.arange(0.05, 1.0, 0.05)
_LEAST_REACH = 0.005


def vignetting_pictures(result: VignettingResult) -> list[ReportPicture]:
    """The plots that a result has the data for."""
    if not result.looks:
        return []
    if result.mean is None or result.solution is None:
        draw = partial(_draw_map, values=_relative(result.looks[0].light), size=result.size)
        return [ReportPicture("The first look", "Its light, relative to its brightest part.", draw)]
    return [
        ReportPicture(
            "Light in the picture",
            "Mean of all looks, relative to its brightest part. Lines: one for each twentieth of the light.",
            partial(_draw_light, light=result.mean, size=result.size),
        ),
        ReportPicture(
            "Light over radius",
            "Dots: parts of the picture, by their distance from the centre of the model. Line: the model along the "
            "half diagonals.",
            partial(_draw_radius, result=result),
        ),
        ReportPicture(
            "Residual",
            "How much brighter each part of the picture is than the model says (%). It should be noise: a slope from "
            "side to side is uneven light, rings are a lens that the model does not follow.",
            partial(_draw_lens_residual, result=result),
        ),
        ReportPicture(
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


def _draw_lens_residual(axes: Axes, result: VignettingResult) -> None:
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
