"""The pictures of a calibration's report. Curves differ in dash or marker, not in colour alone."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.response.file import ResponseSolution
from calibration.result import Result
from imaging.response import GREY_LEVELS, ResponseFunction, prediction_table

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
LEAST_DRAWN_STOPS = 1e-5
MOST_POINTS = 4000
MOST_RINGS = 250
GREYS = np.arange(GREY_LEVELS)


@dataclass(frozen=True, slots=True)
class Picture:
    """One plot: what it is called, what it shows in a sentence or two, and what draws it."""

    title: str
    caption: str
    draw: Callable[[Axes], None]


def pictures(result: Result) -> list[Picture]:
    """The plots that a result has the data for."""
    sweep = [
        Picture(
            "The sweep",
            "Mean grey level of the parts of the scene over exposure time, the first time and when it was repeated.",
            lambda axes: _draw_sweep(axes, result),
        ),
        Picture(
            "Repeats",
            "By how much shots of one exposure differ from their mean: a drift or a step of the light shows here, "
            "flicker as scatter, a moved scene as outliers.",
            lambda axes: _draw_repeats(axes, result),
        ),
    ]
    solution = result.solution
    if solution is None:
        return sweep
    return [
        Picture(
            "Response",
            "Rings: parts of the scene, each placed by its own radiance. Line: the response, with twice its standard "
            "error. Hatched: grey levels beyond the covered range, where the curve is extended or little known.",
            lambda axes: _draw_response(axes, result, solution),
        ),
        Picture(
            "Predictions",
            "Grey level of a pixel after a change of exposure level (stops), which is what the daemon decides with.",
            lambda axes: _draw_predictions(axes, solution.response),
        ),
        Picture(
            "Residual",
            "Grey levels seen minus those predicted from other exposures. The black line is the mean; dashed: one grey "
            "level.",
            lambda axes: _draw_residual(axes, result),
        ),
        Picture(
            "Uncertainty",
            "Standard error of the response; a tenth of a stop is 7 % of the light. It counts from the middle between "
            "the dashed lines, as only differences have a meaning. The error stated is twice the largest value "
            "between them; grey levels that the sweep did not see are hatched.",
            lambda axes: _draw_uncertainty(axes, solution),
        ),
        *sweep,
    ]


def comparison_picture(left: ResponseFunction, right: ResponseFunction) -> Picture:
    """Both responses of a rig in one plot."""

    def draw(axes: Axes) -> None:
        for response, name, dash, colour in ((left, "left", "-", "#0072b2"), (right, "right", "--", "#d55e00")):
            open_part = slice(response.black_level, response.saturation + 1)
            axes.plot(response.log2_exposure[open_part], GREYS[open_part], dash, color=colour, lw=1.8, label=name)
        _finish(axes, "log2 exposure (stops from saturation)", "grey level")
        axes.set_ylim(0, 256)
        axes.legend(loc="upper left", frameon=False)

    return Picture("Left and right", "Both cameras' responses, each at 0 stops where it saturates.", draw)


def one_png(picture: Picture) -> bytes:
    """A picture by itself, as PNG."""
    figure = Figure(figsize=(6.4, 4.2), layout="constrained", dpi=110)
    picture.draw(figure.subplots())
    return _png(figure)


def overview_png(title: str, shown: Sequence[Picture]) -> bytes:
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
    response, (low, high) = solution.response, solution.covered
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
    for bottom, top in ((0, low), (high, GREY_LEVELS - 1)):
        axes.axhspan(bottom, top, **UNSEEN)
    axes.set_ylim(0, GREY_LEVELS)
    axes.set_xlim(curve[1] - 0.5, 0.5)
    axes.legend(loc="upper left", frameon=False)
    _finish(axes, "log2 exposure (stops from saturation)", "grey level")


def _draw_uncertainty(axes: Axes, solution: ResponseSolution) -> None:
    low, high = solution.covered
    axes.semilogy(GREYS, np.maximum(solution.uncertainty_stops, LEAST_DRAWN_STOPS), "-", color="#0072b2", lw=1.8)
    for bottom, top in ((0, low), (high, GREY_LEVELS - 1)):
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
