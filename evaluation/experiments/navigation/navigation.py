"""The experiment: maps over hours and months, laps in every light, and their section of the report."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Literal

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.experiment import Experiment, Figure, Job, Plain, Results, Section, Table
from evaluation.experiments.navigation.claims import claims
from evaluation.experiments.navigation.lap import LIGHTS
from evaluation.experiments.navigation.laps import LOST_M, POLICIES, measure_laps
from evaluation.experiments.navigation.looks import EXPOSURE
from evaluation.experiments.navigation.months import measure_hours, measure_months
from evaluation.experiments.navigation.seasons import HOURS
from evaluation.experiments.navigation.tables import (
    first_laps_table,
    laps_of,
    many_laps_table,
    plot_upkeep,
    upkeep_tables,
)

PARKS, LAP_PARKS = (41, 42, 43), (46, 47)
"""Seeds of parks in which nothing was tried before."""


MANY_LAPS, MANY_LAPS_IN = 10, ("low sun", "overcast")

BETTER: dict[str, Literal["higher", "lower"]] = {
    "lap-aside-m": "lower",
    "lap-completed": "higher",
    "lap-registered": "higher",
}


def jobs(quick: bool) -> list[Job]:
    """All drives and lights; a quick run has a few drives, and one lap each of two policies in one light."""
    if quick:
        arguments: dict[str, Plain] = {"seed": 0, "programme": "nightfall", "drives": 2}
        return [
            Job(measure_hours, arguments, 20.0, (EXPOSURE,)),
            *(_laps(1, one, "low sun", 1) for one in POLICIES[:2]),
        ]
    hours: list[dict[str, Plain]] = [
        {"seed": seed, "programme": programme, "drives": 12} for seed, programme in product(PARKS, HOURS)
    ]
    return [
        *(Job(measure_months, {"seed": seed}, 600.0, (EXPOSURE,)) for seed in PARKS),
        *(Job(measure_hours, arguments, 80.0, (EXPOSURE,)) for arguments in hours),
        *(_laps(seed, policy, light, MANY_LAPS if policy == DEFAULT_POLICY and light in MANY_LAPS_IN else 1)
          for seed, policy, light in product(LAP_PARKS, POLICIES, LIGHTS)),
    ]  # fmt: skip


def _laps(seed: int, policy: str, light: str, laps: int) -> Job:
    arguments: dict[str, Plain] = {"seed": seed, "policy": policy, "light": light, "laps": laps}
    return Job(measure_laps, arguments, 15.0 + 15.0 * laps, (policy,))


def section(results: Results, folder: Path) -> Section:
    """Verdicts on sections 4.3 to 4.5, curves, and how the laps ended."""
    laps = laps_of(results)
    plot_upkeep(results, folder / "navigation.png")
    parts: list[Table | Figure] = [
        Figure("navigation.png", "Share of registrations with an error of at most x, with 95 % bands over maps."),
        *upkeep_tables(results),
    ]
    if laps:
        parts.append(first_laps_table(laps))
    if any(len(park) > 1 for parks in laps.values() for park in parks):
        parts.append(many_laps_table(laps))
    return Section(_SETTING, claims(results), parts)


def data(results: Results) -> Plain:
    """For `--json`: the first lap of each policy in each light and park, and the verdicts."""
    rows: list[Plain] = []
    for arguments, laps in results:
        if "light" in arguments:
            base = {"course": f"park {arguments['seed']}, {arguments['light']}", "policy": arguments["policy"]}
            first = laps[0]
            values = first["end_m"], float(first["completed"]), first["registered"]
            rows += [{"judge": judge, **base, "value": value} for judge, value in zip(BETTER, values, strict=True)]
    verdicts: list[Plain] = [
        {"source": one.source, "claim": one.claim, "ours": one.ours, "verdict": str(one.verdict)}
        for one in claims(results)
    ]
    return {"default_policy": DEFAULT_POLICY, "better": dict(BETTER), "results": rows, "verdicts": verdicts}


_SETTING = f"""\
Maps: the park of `teach` at 50 degrees north, taught at noon on the first of March by `{EXPOSURE}`, 20 of its 80 local
maps, and driven again beside the path. Sun, shadows and light follow date and hour; an overcast sky comes and goes by
chance; the wind moves half of the leaves from drive to drive, and after two months half of them are others for good;
below an elevation of -6 degrees the robot drives by its lamp. Only the sun is periodic. `steady`: 12 drives at noon
under clouds. `nightfall`: 12 drives, the last six in the dark. `months`: 87 drives on random days and hours of two
months, a third of them in the dark; models learn from the first 57 and foretell which features will be seen in the
other 30, while `plastic`, `adaptive` and `summary` maps go on learning. Features are FAST corners with ORB descriptors
under the paper's threshold law, in place of its SURF. Truth comes from the geometry of the park. A claim is reproduced
where a paired two-sided t-test (p < 0.05) and the 95 % interval of the difference, which draws local maps, say so. The
authors' scripts test one side at 0.2, and one of them draws the curve of the static map 0.01 too low, so that it can be
told from the other.

Laps: a robot with 2 % error of distance and a drift of a degree a metre starts 0.3 m aside and turned by 5 degrees, and
repeats a lap of about 32 m, which it was taught with the same policy in the early afternoon. It steers by registrations
with static maps, ten times a second. A lap that is not completed counts as {LOST_M:g} m in the JSON. `switched`: the
light of the middle third is a hundredth. `lamp at night`: no light but the robot's lamp."""


EXPERIMENT = Experiment(
    "navigation", "Teach and repeat over hours and months (Majer et al. 2018, 4.3 to 4.5)", jobs, section, data
)
