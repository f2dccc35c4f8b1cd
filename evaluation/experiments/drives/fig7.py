"""B&H Fig. 7 to 9: the error of odometry with fixed settings, and which measures of images predict it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.arrays import Floats
from evaluation.drawing import COLOURS, boxes, panels, save
from evaluation.experiments.drives.drives import (
    ALIKE_MM,
    PROXIES,
    ROOMS,
    SETTINGS,
    measure_fixed,
    over_rooms,
    unless_few,
)
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.verdicts import above, alike, below, not_above, together
from evaluation.intervals import Interval, clustered, pearson
from evaluation.jobs.job import Job
from evaluation.prose import text_beside
from evaluation.scenes.scenarios import RATE_HZ

MARKERS = "osv^"
EQUALLY_GOOD = 0.05  # Smaller differences of |r| do not count
NO_CORRELATION = 0.3  # An r whose whole interval is within it predicts nothing: the paper calls its 0.26 no correlation


def jobs(quick: bool) -> list[Job]:
    """One for each room; its four settings run side by side."""
    courses, seconds = ([(1, 0)], 2.0) if quick else ([(room, room) for room in ROOMS], 8.0)
    return [
        Job(
            measure_fixed,
            {"room": room, "seed": heading, "repeat": 0, "frames": round(seconds * RATE_HZ)},
            cost_s=11.0 * seconds,
        )
        for room, heading in courses
    ]


def section(results: Results, folder: Path) -> ReportSection:
    """Judge Fig. 7 and Fig. 9."""
    errors = np.array([[one["rpe_mm"] for one in run] for _, run in results])
    values = np.array([[one["proxies"] for one in run] for _, run in results])
    correlations = correlate(values, errors)
    _draw_errors(errors, folder / "fig7.png")
    _draw_paths(results, folder / "fig8.png")
    _draw_proxies(values, errors, correlations, folder / "fig9.png")
    claims = [
        _time_raises_the_error(errors),
        _time_raises_the_spread(errors),
        _noise_hardly_matters(errors),
        _best_proxy(correlations),
        _poor_proxies(correlations),
    ]
    return ReportSection(
        text_beside(__file__),
        unless_few(claims, len(errors)),
        [
            _table(results, errors),
            Figure("fig7.png", "Error of odometry by setting, over all rooms."),
            Figure("fig8.png", "The path of the left camera in one room from above, and the best and worst estimate."),
            Figure("fig9.png", "Seven measures of images against the error, as deviations from the room's mean."),
            _proxy_table(correlations),
        ],
    )


def correlate(values: Floats, errors: Floats) -> dict[str, Interval]:
    """Correlation of each measure (rooms, settings, measures) with the error (rooms, settings) within rooms."""
    error = errors - errors.mean(axis=1, keepdims=True)
    deviations = values - values.mean(axis=1, keepdims=True)
    return {name: pearson(deviations[..., place], error) for place, name in enumerate(PROXIES)}


def _time_raises_the_error(errors: Floats) -> Claim:
    """From the shortest time to the longest."""
    worse = over_rooms(errors[:, -1] - errors[:, 0])
    return Claim(
        "B&H Fig. 7",
        "Longer exposures raise the error",
        f"7.5 ms against 0.94 ms at equal level: {worse.text('+.2f', 'mm')}",
        above(worse, ALIKE_MM),
    )


def _time_raises_the_spread(errors: Floats) -> Claim:
    """Likewise, by the distance of the quartiles over rooms."""
    spreads = np.subtract(*np.percentile(errors, [75, 25], axis=0))

    def wider(drawn: Floats) -> Floats:
        apart = np.subtract(*np.percentile(drawn, [75, 25], axis=1))
        return np.asarray(apart[:, -1] - apart[:, 0])

    by = clustered(errors, wider)
    return Claim(
        "B&H Fig. 7",
        "Longer exposures raise the spread of the error",
        f"quartiles {spreads[-1]:.2f} against {spreads[0]:.2f} mm apart, wider by {by.text('+.2f', 'mm')}",
        above(by, ALIKE_MM),
    )


def _noise_hardly_matters(errors: Floats) -> Claim:
    """From 18 to 24 dB, between the two shortest times, where blur differs least."""
    worse = over_rooms(errors[:, 0] - errors[:, 1])
    return Claim(
        "B&H Fig. 7",
        "Noise of high gain hardly matters",
        f"0.94 ms, 24 dB against 1.9 ms, 18 dB: {worse.text('+.2f', 'mm')}",
        not_above(worse, ALIKE_MM),
    )


def _of_the_paper(correlations: Mapping[str, Interval]) -> dict[str, Interval]:
    return {name: one for name, one in correlations.items() if PROXIES[name] is not None}


def _best_proxy(correlations: Mapping[str, Interval]) -> Claim:
    """Reproduced when gradient information and Lowe ratio correlate with the error, and nothing correlates more."""
    theirs = _of_the_paper(correlations)
    best = max(abs(one.value) for one in theirs.values())
    gradient, lowe = named = [correlations["gradient information"], correlations["Lowe ratio"]]
    either = above if lowe.value > 0 else below  # ours need not have the sign of theirs
    verdict, condition = together(
        {"gradient information": below(gradient, NO_CORRELATION), "Lowe ratio": either(lowe, NO_CORRELATION)}
    )
    least = min(abs(one.value) for one in named)
    if verdict is Verdict.REPRODUCED and least < best - EQUALLY_GOOD:
        rivals = [name for name, one in theirs.items() if one not in named and abs(one.value) > least]
        verdict, condition = Verdict.CONDITIONALLY, f"both do, but {', '.join(rivals)} as well"
    leaders = sorted(theirs, key=lambda name: -abs(theirs[name].value))[:3]
    return Claim(
        "B&H Fig. 9",
        "Gradient information and Lowe ratio predict the error best, r = -0.73 each",
        f"{gradient.text('+.2f')} and {lowe.text('+.2f')}; strongest: {', '.join(leaders)}",
        verdict,
        condition,
    )


def _poor_proxies(correlations: Mapping[str, Interval]) -> Claim:
    """Reproduced when the intervals of both are near 0."""
    poor = {name: correlations[name] for name in ("entropy", "good stereo matches")}
    verdict, condition = together({name: alike(one, NO_CORRELATION) for name, one in poor.items()})
    return Claim(
        "B&H Fig. 9",
        "Entropy (r = 0.26) and the number of stereo matches (0.02) do not predict it",
        " and ".join(one.text("+.2f") for one in poor.values()),
        verdict,
        condition,
    )


def _table(results: Results, errors: Floats) -> Table:
    rows = []
    for place, (time_us, gain_db) in enumerate(SETTINGS):
        runs = [run[place] for _, run in results]
        quartiles = np.percentile(errors[:, place], [25, 50, 75])
        rows.append(
            [
                f"{time_us / 1e3:.2g} ms, {gain_db:g} dB",
                f"{errors[:, place].mean():.2f}",
                *(f"{value:.2f}" for value in quartiles),
                f"{100 * np.mean([run['lost_share'] for run in runs]):.1f} %",
                f"{sum(run['failed'] for run in runs)}/{len(runs)}",
            ]
        )
    return Table(
        "RPE (mm) by setting; a run has failed when five pairs in a row are lost.",
        ["setting", "mean", "quartile", "median", "quartile", "pairs lost", "runs failed"],
        rows,
    )


def _proxy_table(correlations: Mapping[str, Interval]) -> Table:
    return Table(
        "Correlation with the error. Our Lowe ratio is small when matches are distinct.",
        ["measure", "the paper", "ours"],
        [
            [name, "-" if (paper := PROXIES[name]) is None else f"{paper:+.2f}", one.text("+.2f")]
            for name, one in correlations.items()
        ],
    )


def _draw_errors(errors: Floats, file: Path) -> None:
    figure, axes = panels(1, 1, 3.6)
    boxes(axes, list(errors.T), [f"{time_us / 1e3:.2g} ms\n{gain_db:g} dB" for time_us, gain_db in SETTINGS])
    axes.set(ylabel="RPE over 20 mm (mm)", ylim=(0, None))
    save(figure, file)


def _draw_paths(results: Results, file: Path) -> None:
    runs: Sequence[Any] = results[0][1]
    best, worst = (pick(runs, key=lambda run: run["rpe_mm"]) for pick in (min, max))
    figure, axes = panels(1, 1, 4.4)
    axes.plot(*np.array(best["truth"]).T, color="black", label="truth")
    for one, name, colour in ((best, "best", COLOURS[0]), (worst, "worst", COLOURS[1])):
        axes.plot(*np.array(one["path"]).T, color=colour, label=f"{name}: {one['name']}, RPE {one['rpe_mm']:.2f} mm")
    axes.set_aspect("equal")
    axes.set(xlabel="to the right of the first camera (mm)", ylabel="ahead of it (mm)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)
    save(figure, file)


def _draw_proxies(values: Floats, errors: Floats, correlations: Mapping[str, Interval], file: Path) -> None:
    figure, grid = panels(2, 4, 4.8, sharey=True)
    error = errors - errors.mean(axis=1, keepdims=True)
    for place, (axes, (name, one)) in enumerate(zip(grid.flat, _of_the_paper(correlations).items(), strict=False)):
        deviation = values[:, :, place] - values[:, :, place].mean(axis=1, keepdims=True)
        for setting, (time_us, _) in enumerate(SETTINGS):
            label = f"{time_us / 1e3:.2g} ms"
            axes.plot(
                deviation[:, setting], error[:, setting], MARKERS[setting], color=COLOURS[setting], markersize=5,
                label=label,
            )  # fmt: skip
        axes.set_title(f"{name}\nr = {one.text('+.2f')}", fontsize=9)
    for axes in grid[:, 0]:
        axes.set_ylabel("RPE - mean (mm)")
    grid.flat[-1].set_axis_off()
    grid.flat[-1].legend(*grid.flat[0].get_legend_handles_labels(), loc="center")
    save(figure, file)


EXPERIMENT = Experiment("fig7", "Fig. 7 to 9: odometry with fixed settings, and what predicts its error", jobs, section)
