"""B&H Fig. 1: the gradient metric against exposure level, for two activation thresholds and many gains."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from evaluation.drawing import panels, save
from evaluation.experiments.experiment import Claim, Experiment, Figure, ReportSection, Results, Table, Verdict
from evaluation.experiments.prediction.still_life import (
    DELTAS,
    GAINS_DB,
    Rows,
    coupling,
    curve_of_least_gain,
    measure_coupling,
    plateau_centre,
)
from evaluation.intervals import Interval, mean_interval
from evaluation.jobs.job import Job
from evaluation.prose import text_beside

LUX = 50.0  # As in the paper
DARK_STOPS = 1.0  # Frames at least this far below the best exposure are dark
# A metric depends on gain if gain alone changes it by more than a tenth of its peak; below a twentieth it does not.
COUPLED, DECOUPLED = 0.10, 0.05
SAME_OPTIMUM_STOPS = 0.5  # Narrower than the plateaus on which the metric is within 1 % of its peak often are
_SHOTS = 4
_VIEW_NAMES = {
    "control": "as control sees it: 360x270, median",
    "lifted": "gamma 0.3 first, then the same",
    "shrunk": "360x270, no median",
    "raw": "720x540, nothing done",
}


def jobs(quick: bool) -> list[Job]:
    """One for each scene."""
    rooms = [("room", seed) for seed in range(2 if quick else 12)]
    stills = [(scene, seed) for scene in ("leaves", "street", "hall") for seed in range(4)]
    levels = np.arange(7.0, 17.1, 1.0) if quick else np.arange(6.0, 19.1, 0.5)
    shots = 1 if quick else _SHOTS
    return [
        Job(
            measure_coupling,
            {"scene": scene, "seed": seed, "lux": LUX, "levels": levels.tolist(), "shots": shots},
            0.4 if quick else 1.6,
        )
        for scene, seed in [*rooms, *stills[: 1 if quick else None]]
    ]


def section(results: Results, folder: Path) -> ReportSection:
    """Judge the three claims of Fig. 1 and section 1.1."""
    measured: list[Rows] = [rows for _, rows in results]
    _draw(measured[0], f"{results[0][0]['scene']}, seed {results[0][0]['seed']}", folder / "fig1.png")
    shifts = [_best(rows, 0.30) - _best(rows, 0.06) for rows in measured]
    return ReportSection(
        text_beside(__file__),
        [_weak_threshold(measured), _strong_threshold(measured), _same_optimum(shifts)],
        [
            Figure("fig1.png", "Each dot is one pair of time and gain; its colour is the gain. Left delta 0.06, right "
                   "0.30; above as control sees frames, below without any preparation."),
            _table(measured),
        ],
    )  # fmt: skip


def _weak_threshold(measured: Sequence[Rows]) -> Claim:
    dark = {view: _dark(measured, view, 0.06) for view in _VIEW_NAMES}
    worst = _worst(measured, "control", 0.06, max(GAINS_DB))
    if dark["control"].low > COUPLED:
        verdict, condition = Verdict.REPRODUCED, ""
    elif holds := [_VIEW_NAMES[view] for view in ("lifted", "shrunk") if dark[view].low > COUPLED]:
        verdict = Verdict.CONDITIONALLY
        condition = f"in dark frames by more than a tenth of the peak only with: {'; '.join(holds)}"
    else:
        verdict, condition = Verdict.NOT_REPRODUCED, ""
    ours = (
        f"up to {_percent(dark['control'])} of the peak in dark frames ({_percent(dark['lifted'])} with gamma 0.3, "
        f"{_percent(dark['shrunk'])} without the median); {_percent(worst)} over all levels"
    )
    return Claim(
        "B&H 1.1, Fig. 1",
        "With delta 0.06 noise in dark frames makes M_g vary greatly with gain at one exposure level",
        ours, verdict, condition,
    )  # fmt: skip


def _strong_threshold(measured: Sequence[Rows]) -> Claim:
    worst = {view: _worst(measured, view, 0.30, max(GAINS_DB)) for view in _VIEW_NAMES}
    bounded = _worst(measured, "raw", 0.30, 24)
    verdict = Verdict.of(worst["control"].high < DECOUPLED)
    return Claim(
        "B&H 1.1, Fig. 1",
        "delta 0.30 decouples M_g from noise: the curve does not depend on gain",
        f"at most {_percent(worst['control'])} of the peak at any level, 0 to {max(GAINS_DB)} dB",
        verdict,
        f"on prepared frames; with gamma 0.3 first {_percent(worst['lifted'])}; on raw ones {_percent(bounded)} up to "
        f"24 dB and {_percent(worst['raw'])} up to {max(GAINS_DB)} dB",
    )


def _same_optimum(shifts: Sequence[float]) -> Claim:
    shift = mean_interval(np.abs(shifts))
    return Claim(
        "B&H 1.1",
        "The best exposure level is the same for delta 0.06 and 0.30",
        f"they differ by {shift.text('.2f', 'stops')}",
        Verdict.of(shift.high < SAME_OPTIMUM_STOPS),
        "at the least gain of each level",
    )


def _best(rows: Rows, delta: float) -> float:
    return plateau_centre(*curve_of_least_gain(rows, "control", delta))


def _worst(measured: Sequence[Rows], view: str, delta: float, max_gain_db: float) -> Interval:
    """Mean over scenes of the largest gain dependence at any level."""
    return mean_interval([max(coupling(rows, view, delta, max_gain_db).values()) for rows in measured])


def _dark(measured: Sequence[Rows], view: str, delta: float) -> Interval:
    """As `_worst` over all gains, for dark frames only."""
    values = []
    for rows in measured:
        best = plateau_centre(*curve_of_least_gain(rows, view, delta))
        coupled = coupling(rows, view, delta, max(GAINS_DB))
        values.append(max((value for level, value in coupled.items() if level <= best - DARK_STOPS), default=0.0))
    return mean_interval(values)


def _where_worst(measured: Sequence[Rows]) -> float:
    """Stops from the best level to the one where delta 0.06 depends most on gain, median over scenes."""
    places = []
    for rows in measured:
        coupled = coupling(rows, "control", 0.06, max(GAINS_DB))
        places.append(max(coupled, key=lambda level: coupled[level]) - _best(rows, 0.06))
    return float(np.median(places))


def _table(measured: Sequence[Rows]) -> Table:
    rows = [
        [
            f"{_VIEW_NAMES[view]}, delta {delta:.2f}",
            _percent(_dark(measured, view, delta)),
            *(_percent(_worst(measured, view, delta, gain_db)) for gain_db in (24, 30, max(GAINS_DB))),
        ]
        for view in _VIEW_NAMES
        for delta in DELTAS
    ]
    heads = ["frames", "dark frames, all gains", *(f"all, to {gain} dB" for gain in (24, 30, max(GAINS_DB)))]
    caption = (
        f"Gain dependence (share of the peak) at the level where it is worst; mean over {len(measured)} scenes. Dark "
        f"frames are at least {DARK_STOPS:g} stop below the best. As control sees frames, delta 0.06 depends most on "
        f"gain {_where_worst(measured):+.1f} stops from the best exposure (median over scenes)."
    )
    return Table(caption, heads, rows)


def _draw(rows: Rows, title: str, file: Path) -> None:
    figure, axes = panels(2, 2, 6.0, sharex=True, sharey="row")
    for line, view in zip(axes, ("control", "raw"), strict=True):
        for axis, delta in zip(line, DELTAS, strict=True):
            levels, curve = curve_of_least_gain(rows, view, delta)
            axis.plot(levels, curve, color="grey", linewidth=0.8)
            axis.scatter(
                [row["level"] for row in rows], [row[view][DELTAS.index(delta)] for row in rows], s=14,
                c=[row["gain_db"] for row in rows], cmap="viridis", vmin=min(GAINS_DB), vmax=max(GAINS_DB),
            )  # fmt: skip
            axis.set_title(f"delta {delta:.2f}, {'as control sees it' if view == 'control' else 'raw'}", fontsize=10)
        line[0].set_ylabel("M_g per pixel")
    for axis in axes[1]:
        axis.set_xlabel("exposure level E (stops)")
    figure.colorbar(axes[0, 0].collections[0], ax=axes, label="gain (dB)", ticks=GAINS_DB, shrink=0.7)
    figure.suptitle(f"{title}, {LUX:g} lux", fontsize=11)
    save(figure, file)


def _percent(interval: Interval) -> str:
    return f"{100 * interval.value:.0f} % [{100 * interval.low:.0f}, {100 * interval.high:.0f}]"


EXPERIMENT = Experiment("fig1", "The gradient metric against exposure level, and what gain does to it", jobs, section)
