"""The experiment: its jobs, and its section of the report."""

from __future__ import annotations

from pathlib import Path

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Experiment, Figure, Job, Results, Section, Table
from evaluation.experiments.teach.cases import STANDARD, TILTS, cases_of, replays_of, sweeps_of
from evaluation.experiments.teach.claims import claims
from evaluation.experiments.teach.daylight import REPLAYS
from evaluation.experiments.teach.figures import plot_curves, plot_sweeps, plot_views
from evaluation.experiments.teach.path import MAPS
from evaluation.experiments.teach.replay import measure
from evaluation.experiments.teach.sweep import sweep
from evaluation.experiments.teach.tables import comparisons_table, looks_table, shares_table, sweeps_table, ways_table

SEEDS = (2, 3)


def jobs(quick: bool) -> list[Job]:
    """Two parks, three placements and three lights; a quick run has a sixteenth of one drive, in another park."""
    if quick:
        return [Job(measure, {"seed": 0, "tilt_deg": 0.0, "light": "sunset", "maps": 5}, cost_s=18.0)]
    cases: list[dict[str, bool | int | float | str | None]] = [
        {"seed": seed, "tilt_deg": tilt, "light": light, "maps": MAPS}
        for seed in SEEDS
        for tilt in TILTS.values()
        for light in REPLAYS
    ]
    return [*(Job(measure, case, cost_s=140.0) for case in cases), *(Job(sweep, case, cost_s=16.0) for case in cases)]


def section(results: Results, folder: Path) -> Section:
    """Curves, tests, and verdicts on section 4.2."""
    cases, sweeps = cases_of(results), sweeps_of(results)
    views = {light: replays[0]["views"] for light in REPLAYS if (replays := replays_of(results, light, 0.0))}
    plot_views(views, folder / "teach_views.png")
    plot_curves(cases, folder / "teach_curves.png")
    parts: list[Table | Figure] = [
        Figure("teach_views.png", "The same view as each policy exposes it in the middle of the drive, camera level."),
        Figure(
            "teach_curves.png",
            "Share of registrations with an error of at most x, with 95 % bands over maps (the paper's figure 7).",
        ),
        shares_table(cases),
        comparisons_table(cases),
        looks_table(results),
        ways_table(results),
    ]
    if sweeps:
        plot_sweeps(sweeps, folder / "teach_sweep.png")
        parts += [
            Figure(
                "teach_sweep.png",
                "One view near each map at nine exposures, without any policy: 0 holds the top half at 0.5, as "
                "`standard` does; dotted, the exposure that holds the whole image there, as `full` does (median). "
                "Above: matches that agree. Below: share of registrations within 5 px, with 95 % intervals.",
            ),
            sweeps_table(sweeps),
        ]
    return Section(_SETTING, claims(cases, sweeps), parts)


_SETTING = f"""\
A robot is taught a closed path of {MAPS} local maps and replays it, with eight images per map, near the path but not on
it. Each image is registered with the nearest map: 500 ORB features of the top half of each image, Lowe's ratio, and a
vote on the horizontal shift by histogram. The paper has SURF with an adaptive threshold, which OpenCV's wheels lack; to
the same end, ORB takes the 500 best of all corners. The truth is not annotated by hand but comes from the renderer: the
shift that would win the vote if everything upright were matched correctly.

The park is rendered in perspective: trunks, shrubs, a small building, a wood with the sky above it, and a meadow with
sun and shadow. The map is taught early in the afternoon by `{STANDARD}`, the paper's default; the paper does not say by
which policy it was. It is replayed on other days, when half of the leaves have moved. Late in the afternoon the light
is steady: under a `clear` sky, where shadows have moved and what faces the sun is almost as bright as the sky, or under
an `overcast` one, 3 to 4 stops brighter than the trees. After `sunset` only the sky gives light, 2 stops less at the
end of the drive than at its beginning. The radiance of sky and surfaces is physical; its parameters were chosen on
other parks. The camera looks level (sky in the upper half of the view), 12 degrees up (sky beyond it, into the lower
half), or 14 degrees down (sky hardly seen).

All policies see the same frames, at 30 a second, each with its own exposure; a decision applies two frames later. They
start from the operator's exposure, a mean of 0.5 in the first view, which `fixed` keeps. `begin2022` and
`{DEFAULT_POLICY}` run too, though the paper makes no claim about them. One policy is better than another where
Student's paired test says so (p < 0.05) and the interval of the difference, which draws maps, excludes 0."""


EXPERIMENT = Experiment("teach", "Teach and repeat under a bright sky (Majer et al. 2018, 4.2)", jobs, section)
