"""What the drives over a map show, as a page: what was seen again, what stayed, and whether it could be foretold."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from navigation.maps.path import TaughtPath
from navigation.maps.temporal import MODELS, FeatureHistory
from navigation.store import MapDrive, MapFile, Place, write

LEAST_PASSINGS = 4
"""Passings of a local map that a model needs, to learn from all but the last."""

BINS = 10
"""Bins of the foretold probability."""

_STEP_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Foretold:
    """What one of `MODELS` foretold about the last passing of each local map, from the passings before.

    `brier` is the mean squared difference from what was seen (0 or 1), NaN for a model whose scores are not
    probabilities; `foretold` and `seen` are means by bin of the foretold probability, float64, (bins,).
    """

    model: str
    brier: float
    foretold: NDArray[np.float64]
    seen: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything that the page shows."""

    # the path from above as it was taught, and its local maps, float64, (n, 2); the start is at 0, ahead is up
    plan_m: NDArray[np.float64]
    marks_m: NDArray[np.float64]
    runs: list[MapDrive]
    # share of the features of each local map seen in each repetition, float64, (runs, places); NaN: not registered
    seen_share: NDArray[np.float64]
    # features that were taught, those of them still there after each run, and all after each run, (runs,)
    taught: int
    kept: NDArray[np.int64]
    total: NDArray[np.int64]
    foretold: list[Foretold]  # by model; empty with too few drives


def findings(file: MapFile) -> Findings:
    """Read and sum up a map; raises MapError if it is damaged."""
    places, runs, lives = file.places(), file.runs(), file.lives()
    repeats = [run for run in runs if run.kind == "repeat"]
    plan_m, marks_m = _plan(file.taught_path(), places)
    first = runs[0].number if runs else 0
    numbers = np.array([run.number for run in repeats], np.int64)
    kept, total = (_alive(lives[chosen], numbers) for chosen in (lives[:, 0] == first, np.ones(len(lives), bool)))
    taught = int(lives[lives[:, 0] == first, 2].sum())
    shares, foretold = _seen_share(file, places, repeats), _foretold([file.history(place) for place in places])
    return Findings(plan_m, marks_m, repeats, shares, taught, kept, total, foretold)


def _plan(path: TaughtPath, places: Sequence[Place]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The path from above, computed from the speeds it was taught with."""
    if path.length_m == 0.0:
        return np.zeros((1, 2)), np.zeros((len(places), 2))
    distances_m = np.arange(0.0, path.length_m + _STEP_M, _STEP_M)
    speeds = np.array([path.at(distance_m) for distance_m in distances_m])
    fast = np.where(np.abs(speeds[:, 0]) > 1e-3, np.abs(speeds[:, 0]), np.inf)
    heading = np.pi / 2 + np.concatenate([[0.0], np.cumsum(speeds[:, 1] / fast * _STEP_M)[:-1]])
    ahead_m = np.copysign(_STEP_M, speeds[:, :1])
    steps = ahead_m * np.column_stack([np.cos(heading), np.sin(heading)])
    plan_m = np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)[:-1]])
    marks = [place.distance_m for place in places]
    return plan_m, np.column_stack([np.interp(marks, distances_m, axis) for axis in plan_m.T])


def _alive(lives: NDArray[np.int64], runs: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many features there are after each run."""
    added, removed, counts = lives.T
    there = (added <= runs[:, None]) & ((removed == 0) | (removed > runs[:, None]))
    return np.asarray(there @ counts, np.int64)


def _seen_share(file: MapFile, places: Sequence[Place], runs: Sequence[MapDrive]) -> NDArray[np.float64]:
    rows = {run.number: row for row, run in enumerate(runs)}
    columns = {place.number: column for column, place in enumerate(places)}
    shares = np.full((len(runs), len(places)), np.nan)
    for place, run, share in file.seen_shares():
        if run in rows and place in columns:
            shares[rows[run], columns[place]] = share
    return shares


def _foretold(histories: Sequence[FeatureHistory]) -> list[Foretold]:
    """What was foretold about the last passing of each local map that was passed often enough."""
    enough = [history for history in histories if len(history.times_s) >= LEAST_PASSINGS]
    if not enough:
        return []
    found = []
    for name, learn in MODELS.items():
        scores, seen = [], []
        for history in enough:
            last = history.passed[-1]
            scores.append(learn(history.until(len(history.times_s) - 1))(float(history.times_s[-1]))[last])
            seen.append(history.seen[-1][last])
        found.append(_judged(name, np.concatenate(scores), np.concatenate(seen)))
    return found


def _judged(model: str, scores: NDArray[np.float64], seen: NDArray[np.float64]) -> Foretold:
    probable = bool(len(scores)) and scores.min() >= 0.0 and scores.max() <= 1.0
    bins = np.minimum((scores.clip(0.0, 1.0) * BINS).astype(int), BINS - 1)
    used = np.unique(bins) if probable else np.empty(0, int)
    means = [np.array([values[bins == one].mean() for one in used]) for values in (scores, seen)]
    return Foretold(model, float(((scores - seen) ** 2).mean()) if probable else float("nan"), *means)


Picture = tuple[str, str, str]
"""Title, caption, and a PNG in base 64."""


def _picture(title: str, caption: str, found: Findings, draw: Callable[[Axes, Findings], None]) -> Picture:
    figure = Figure(figsize=(6.4, 4.4), layout="constrained")
    draw(figure.subplots(), found)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return title, caption, base64.b64encode(stream.getvalue()).decode()


def _draw_path(axes: Axes, found: Findings) -> None:
    axes.plot(*found.plan_m.T, color="#999999", lw=2.0)
    axes.plot(0.0, 0.0, marker="^", color="black", ms=13)
    axes.plot(*found.marks_m.T, color="#999999", marker="o", ms=5, lw=0)
    known = ~np.isnan(found.seen_share).all(axis=0) if found.runs else np.zeros(len(found.marks_m), bool)
    if known.any():
        x_m, y_m = found.marks_m[known].T
        dots = axes.scatter(x_m, y_m, c=np.nanmean(found.seen_share[:, known], axis=0), s=26, zorder=3, vmin=0, vmax=1)
        axes.figure.colorbar(dots, label="mean share of features seen again")
    axes.set(aspect="equal", xlabel="m", ylabel="m")
    _widen(axes)
    axes.grid(alpha=0.3)


def _widen(axes: Axes) -> None:
    """As wide as high: a straight path has no width of its own."""
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    half_m = max(right - left, high - low) / 2
    axes.set_xlim((left + right) / 2 - half_m, (left + right) / 2 + half_m)
    axes.set_ylim((low + high) / 2 - half_m, (low + high) / 2 + half_m)


def _count(axis: Axis) -> None:
    """Whole numbers only, also where few of them fit."""
    axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def _draw_seen(axes: Axes, found: Findings) -> None:
    extent = (-0.5, len(found.marks_m) - 0.5, len(found.runs) + 0.5, 0.5)
    image = axes.imshow(found.seen_share, aspect="auto", vmin=0, vmax=1, extent=extent, interpolation="nearest")
    axes.figure.colorbar(image, label="share seen again")
    axes.set(xlabel="local map, as `autoexpose map list` numbers them", ylabel="drive")
    _count(axes.xaxis)
    _count(axes.yaxis)


def _draw_stays(axes: Axes, found: Findings) -> None:
    drives = np.arange(len(found.runs) + 1)
    axes.plot(drives, [found.taught, *found.total], color="#56B4E9", marker="o", ms=9, lw=5, label="all")
    axes.plot(drives, [found.taught, *found.kept], color="#D55E00", marker="s", ms=4, lw=1.5, label="taught")
    axes.set(xlabel="drives", ylabel="features", ylim=(0, 1.08 * max([found.taught, *found.total, 1])))
    _count(axes.xaxis)
    axes.legend()
    axes.grid(alpha=0.3)


def _draw_foretold(axes: Axes, found: Findings) -> None:
    axes.plot([0, 1], [0, 1], color="black", lw=0.8, ls=":")
    drawn = [one for one in found.foretold if len(one.foretold)]
    for thinner, one in enumerate(drawn):  # models that agree remain visible below each other
        width = 2.0 * (len(drawn) - thinner) - 1.0
        label = f"{one.model} ({one.brier:.3f})"
        axes.plot(one.foretold, one.seen, marker="o", ms=width + 3, lw=width, label=label, clip_on=False)
    axes.set(xlabel="foretold probability", ylabel="share seen", xlim=(0, 1), ylim=(0, 1))
    axes.legend(title="mean squared error", fontsize=8)
    axes.grid(alpha=0.3)


_PICTURES: tuple[tuple[str, str, Callable[[Axes, Findings], None], Callable[[Findings], object]], ...] = (
    ("Path", "From above, by the speeds it was taught with, ahead is up; a dot for each local map, a triangle at "
     "the start.", _draw_path, lambda _: True),
    ("Seen again", "Share of the features of each local map that were matched correctly, by drive. White: not "
     "registered, or pruned.", _draw_seen, lambda found: found.runs),
    ("What stays", "Features after each drive: all of them, and those that were taught and are still there. Those "
     "that were pruned are missing.", _draw_stays, lambda found: found.runs),
    ("Foretold and seen", "For the last passing of each local map, by models that know the ones before: how often "
     "features of a foretold probability were seen. A model on the diagonal is right; the smaller its error, the more "
     "it foretells.", _draw_foretold, lambda found: found.foretold),
)  # fmt: skip
"""Title, caption, what draws it, and whether there is data for it."""


def pictures(found: Findings) -> list[Picture]:
    """The pictures for which there is data."""
    return [_picture(title, caption, found, draw) for title, caption, draw, has in _PICTURES if has(found)]


def write_report(file: MapFile, facts: Mapping[str, str], page: Path) -> None:
    """Write the HTML page of a map, with `facts` above its pictures; an existing page is replaced.

    Raises MapError when the map is damaged, or the page cannot be written.
    """
    loaders = (jinja2.FileSystemLoader(Path(__file__).parent), jinja2.PackageLoader("calibration.report", ""))  # style
    environment = jinja2.Environment(loader=jinja2.ChoiceLoader(loaders), autoescape=True)
    text = environment.get_template("report.html").render(
        title=f"Map {file.path.name}", facts=list(facts.items()), pictures=pictures(findings(file))
    )
    write(page, text.encode())
