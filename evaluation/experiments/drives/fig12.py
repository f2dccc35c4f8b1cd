"""B&H Fig. 12 to 14: how well odometry does with each policy's exposures, in uneven light and in low light."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, LEARNED, POLICY_IDS
from evaluation.drawing import COLOURS, boxes, panels, save
from evaluation.experiments.drives.drives import (
    ALIKE_MM,
    FIXED,
    ROOMS,
    measure_orb_slam3,
    measure_policies,
    over_rooms,
    unless_few,
)
from evaluation.experiments.experiment import (
    Claim,
    Experiment,
    Figure,
    ReportSection,
    Results,
    Table,
    Verdict,
    jobs_and_results,
)
from evaluation.experiments.verdicts import above, alike, below, not_above, together
from evaluation.experiments.worth.tables import Verdicts, claims_tables
from evaluation.intervals import Interval
from evaluation.jobs.job import Job, Plain
from evaluation.odometry.orb_slam3 import PACKAGE, installed
from evaluation.odometry.tracking import EVERY, Light
from evaluation.prose import text_beside
from evaluation.scenes.scenarios import RATE_HZ
from fake_camera.world.sensor import DEFAULT_F_NUMBER

Run = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class LitScene:
    """A light, and the cameras' lenses."""

    title: str
    light: Light
    lens_f_number: float = DEFAULT_F_NUMBER


UNEVEN = LitScene("(a) 1 to 217 lux", "uneven")
LOW = LitScene("(b) 2 to 4 lux", "low")
LOW_SCENES = (LOW, LitScene("(b) half a lux", "faint"), LitScene("(b) 2 to 4 lux, f/2.8", "low", 2.8))
SCENES = (UNEVEN, *LOW_SCENES)


class PolicyRuns:
    """Results of jobs: each policy of a scene has driven through the same rooms."""

    def __init__(self, results: Results) -> None:
        self._runs: dict[tuple[Any, Any], dict[str, list[Run]]] = {}
        for case, runs in results:
            of_scene = self._runs.setdefault((case["light"], case["lens_f_number"]), {})
            policies: Any = case["policies"]
            for policy, run in zip(policies, runs, strict=True):
                of_scene.setdefault(policy, []).append(run)
        self.policies = list(dict.fromkeys(policy for of_scene in self._runs.values() for policy in of_scene))
        self.room: Any = results[0][0]["room"]

    def of(self, scene: LitScene, policy: str) -> list[Run]:
        """All runs of a policy, in the order of their jobs: one for each room."""
        return self._runs.get((scene.light, scene.lens_f_number), {}).get(policy, [])

    def rooms(self, scene: LitScene) -> int:
        """How many rooms were driven through."""
        return len(self.of(scene, self.policies[0]))

    def difference(self, scene: LitScene, first: str, second: str, figure: Callable[[Run], float]) -> Interval:
        """First minus second, paired by room."""
        pairs = zip(self.of(scene, first), self.of(scene, second), strict=True)
        return over_rooms(np.array([figure(a) - figure(b) for a, b in pairs]))

    def failed(self, scene: LitScene, policy: str) -> int:
        """How many runs failed."""
        return sum(run["failed"] for run in self.of(scene, policy))


def error(run: Run) -> float:
    """Of odometry, mm."""
    return float(run["rpe_mm"])


def metric_of(run: Run) -> float:
    """Median gradient information of the frames that odometry gets."""
    return float(run["metric_after_gamma"])


def level(run: Run) -> float:
    """Mean exposure level, stops."""
    return float(np.mean(np.log2(run["times_us"]) + np.array(run["gains_db"]) / (20 * np.log10(2))))


# The paper's law as its authors' code runs it, which counts as their claim, and as the paper prints it.
LAWS = {"begin2022-code": "as coded", "begin2022": "as printed"}
# Those of the paper: "Mehta's open-source implementation of Shim's algorithm" as the authors' code runs it, and the
# built-in control.
RIVALS = ("mehta2020-code", "neves2009")
ALIKE_METRIC = 0.005  # Values of M_g that differ by less are alike: 2 % of what good frames have
ALIKE_STOPS = 0.1  # Mean levels that differ by less are alike: so much an exposure at rest may waver in the arena


def claims(runs: PolicyRuns) -> list[Claim]:
    """Ours, then the paper's, each first for the law as coded."""
    laws = [law for law in LAWS if law in runs.policies]
    found = [_ours(runs, scene, law) for scene in (UNEVEN, LOW) for law in laws]
    rules: list[Callable[[PolicyRuns, str], Claim]] = [
        _metric_is_higher,
        partial(_error_is_lower, UNEVEN),
        partial(_error_is_lower, LOW),
    ]
    if "fixed" in runs.policies:
        rules += [_fixed_like, _fixed_worse]
    if RIVALS[0] in runs.policies:
        rules.append(_rival_is_darker)
    return found + [rule(runs, law) for rule in rules for law in laws]


def _paper(law: str, figure: str, claim: str, ours: str, judged: tuple[Verdict, str]) -> Claim:
    """A claim of the paper, which counts for the law as coded only."""
    counted = law == next(iter(LAWS))
    return Claim(f"B&H {figure}, law {LAWS[law]}", claim, f"`{law}`: {ours}", *judged, counted=counted)


def _ours(runs: PolicyRuns, scene: LitScene, law: str) -> Claim:
    """Reproduced when the interval ends at or below the margin and no more runs fail; more failures refute it."""
    apart = runs.difference(scene, DEFAULT_POLICY, law, error)
    failed = runs.failed(scene, DEFAULT_POLICY), runs.failed(scene, law)
    return Claim(
        "this project",
        f"{scene.title}: the error of our default `{DEFAULT_POLICY}` is at most {ALIKE_MM} mm above that of `{law}`",
        f"{apart.text('+.3f', 'mm')}; failed {failed[0]} and {failed[1]} of {runs.rooms(scene)} runs",
        Verdict.NOT_REPRODUCED if failed[0] > failed[1] else not_above(apart, ALIKE_MM),
        "more runs fail" if failed[0] > failed[1] else "",
        counted=False,
    )


def _rivals(runs: PolicyRuns) -> list[str]:
    return [policy for policy in RIVALS if policy in runs.policies]


def _metric_is_higher(runs: PolicyRuns, law: str) -> Claim:
    """In both lights, than each rival's."""
    apart = {
        (scene.title[:3], rival): runs.difference(scene, law, rival, metric_of)
        for scene in (UNEVEN, LOW)
        for rival in _rivals(runs)
    }
    judged = together({
        f"{light} to `{rival}`": above(one, ALIKE_METRIC) for (light, rival), one in apart.items()
    })  # fmt: skip
    return _paper(
        law,
        "Fig. 12",
        "Its images have more gradient information than those of the other active methods, in both lights",
        ", ".join(f"{light} {one.text('+.3f')} to `{rival}`" for (light, rival), one in apart.items()),
        judged,
    )


def _error_is_lower(scene: LitScene, runs: PolicyRuns, law: str) -> Claim:
    """Than each rival's."""
    apart = {rival: runs.difference(scene, law, rival, error) for rival in _rivals(runs)}
    judged = together({f"to `{rival}`": below(one, ALIKE_MM) for rival, one in apart.items()})
    return _paper(
        law,
        "Fig. 13",
        f"{scene.title}: its error is lower than that of Mehta's code and of the built-in control",
        ", ".join(f"{one.text('+.2f', 'mm')} to `{rival}`" for rival, one in apart.items())
        + f"; failed {runs.failed(scene, law)} of {runs.rooms(scene)} runs",
        judged,
    )


def _fixed_like(runs: PolicyRuns, law: str) -> Claim:
    """When the errors are alike within the margin."""
    apart = runs.difference(UNEVEN, law, "fixed", error)
    verdict = alike(apart, ALIKE_MM)
    condition = f"`fixed` is {'better' if apart.low > 0 else 'worse'}" if verdict is Verdict.NOT_REPRODUCED else ""
    return _paper(
        law,
        "Fig. 13",
        "(a): hand-tuned fixed parameters do about as well",
        f"{apart.text('+.2f', 'mm')}; `fixed` failed {runs.failed(UNEVEN, 'fixed')} runs, the law "
        f"{runs.failed(UNEVEN, law)}",
        (verdict, condition),
    )


def _fixed_worse(runs: PolicyRuns, law: str) -> Claim:
    """In each low light, with each lens."""
    apart = {scene: runs.difference(scene, law, "fixed", error) for scene in LOW_SCENES}
    judged = together({scene.title: below(one, ALIKE_MM) for scene, one in apart.items()})
    return _paper(
        law,
        "Fig. 13",
        "(b): the same fixed parameters do worse",
        "; ".join(
            f"{scene.title}: {one.text('+.2f', 'mm')}, `fixed` failed {runs.failed(scene, 'fixed')} runs, the law "
            f"{runs.failed(scene, law)}"
            for scene, one in apart.items()
        ),
        judged,
    )


def _rival_is_darker(runs: PolicyRuns, law: str) -> Claim:
    apart = runs.difference(UNEVEN, RIVALS[0], law, level)
    return _paper(
        law,
        "Fig. 14",
        "(a): Shim's law (Mehta's code) exposes less than the algorithm of the paper",
        f"mean level of `{RIVALS[0]}` {apart.text('+.2f', 'stops')}; the law failed {runs.failed(UNEVEN, law)} of "
        f"{runs.rooms(UNEVEN)} runs",
        (below(apart, ALIKE_STOPS), ""),
    )


# In every scene. The paper's two lights have the learned policies, too.
POLICIES = (DEFAULT_POLICY, *LAWS, *RIVALS, "fixed")
# In the first eight rooms of these lights all others drive: enough to tell a policy that is worse by a third.
_OTHERS = tuple(policy for policy in POLICY_IDS if policy not in {*POLICIES, *LEARNED, "majer2018-fixed"})


def jobs(quick: bool) -> list[Job]:
    """One for each scene, room and policy: when one changes, the results of the others are still kept."""
    if quick:
        few = (DEFAULT_POLICY, *LAWS, "neves2009")
        return [_job(scene, 1, policy, 1.7) for scene in (UNEVEN, LOW) for policy in few]
    return [
        _job(scene, room, policy, 8.0)
        for scene in SCENES
        for room in ROOMS
        for policy in (*POLICIES, *_more(scene, room))
    ]


def _more(scene: LitScene, room: int) -> Sequence[str]:
    if scene not in {UNEVEN, LOW}:
        return ()
    return (*LEARNED, *_OTHERS) if room in ROOMS[:8] else LEARNED


def data(results: Results) -> Plain:
    """For `--json`: what policies did in one room stands together."""
    rooms: dict[str, tuple[dict[str, Any], list[Any]]] = {}
    for case, runs in results:
        key = {name: value for name, value in case.items() if name != "policies"}
        together, found = rooms.setdefault(repr(sorted(key.items())), ({**key, "policies": []}, []))
        together["policies"] += case["policies"]
        found += runs
    return jobs_and_results(list(rooms.values()))


def _job(scene: LitScene, room: int, policy: str, seconds: float) -> Job:
    return Job(
        measure_policies,
        {
            "light": scene.light, "lens_f_number": scene.lens_f_number, "room": room, "seed": room, "repeat": 0,
            "policies": [policy], "frames": round(seconds * RATE_HZ),
        },
        cost_s=2.6 * seconds,
        policies=(policy,),
    )  # fmt: skip


def section(results: Results, folder: Path) -> ReportSection:
    """Judge Fig. 12 to 14, and our default against the paper's law."""
    runs = PolicyRuns(results)
    _draw_boxes(runs, "metric_after_gamma", "median M_g", folder / "fig12.png")
    _draw_boxes(runs, "rpe_mm", "RPE over 20 mm (mm)", folder / "fig13.png")
    _draw_exposures(runs, folder / "fig14.png")
    return ReportSection(
        text_beside(
            __file__, default_f_number=DEFAULT_F_NUMBER, default_policy=DEFAULT_POLICY, fixed=FIXED, rooms=len(ROOMS)
        ),
        unless_few(claims(runs), runs.rooms(UNEVEN)),
        [
            *claims_tables(_verdicts(runs), [policy for policy in runs.policies if policy != DEFAULT_POLICY]),
            *(_table(runs, scene) for scene in SCENES if runs.rooms(scene)),
            Figure("fig12.png", "Median gradient information along the path, on frames as odometry gets them."),
            Figure("fig13.png", "Error of odometry, failed runs included; the scale is logarithmic."),
            Figure("fig14.png", f"Exposure time and gain in uneven light, room {runs.room}."),
        ],
    )


def _verdicts(runs: PolicyRuns) -> Verdicts:
    """The errors in the paper's two lights, for the rules by which `worth` judges."""
    rows = [
        {
            "judge": judge, "course": str(room), "policy": policy, "value": run["rpe_mm"], "failed": run["failed"],
        }
        for judge, scene in (("fig12 (a)", UNEVEN), ("fig12 (b)", LOW))
        for policy in runs.policies
        for room, run in enumerate(runs.of(scene, policy))
    ]  # fmt: skip
    return Verdicts(rows, {"fig12 (a)": "lower", "fig12 (b)": "lower"})


def _table(runs: PolicyRuns, scene: LitScene) -> Table:
    rows = []
    for policy in (one for one in runs.policies if runs.of(scene, one)):
        all_runs = runs.of(scene, policy)
        errors = np.array([run["rpe_mm"] for run in all_runs])
        tracked = errors[[not run["failed"] for run in all_runs]]
        rows.append(
            [
                f"`{policy}`" + (f" (law {LAWS[policy]})" if policy in LAWS else ""),
                f"{np.mean([run['metric_after_gamma'] for run in all_runs]):.3f}",
                f"{np.mean([run['metric'] for run in all_runs]):.3f}",
                f"{errors.mean():.2f}",
                f"{np.median(errors):.2f}",
                f"{tracked.mean():.2f}" if tracked.size else "-",
                f"{100 * np.mean([run['lost_share'] for run in all_runs]):.1f} %",
                f"{runs.failed(scene, policy)}/{len(all_runs)}",
            ]
        )
    heads = [
        "policy", "median M_g", "without gamma", "RPE mean", "RPE median", "RPE of runs not failed", "pairs lost",
        "runs failed",
    ]  # fmt: skip
    return Table(f"{scene.title}; RPE in mm.", heads, rows)


def _draw_boxes(runs: PolicyRuns, figure: str, title: str, file: Path) -> None:
    canvas, (left, right) = panels(1, 2, 4.2, sharey=True)
    for axes, scene in ((left, UNEVEN), (right, LOW)):
        values = [[run[figure] for run in runs.of(scene, policy)] for policy in runs.policies]
        boxes(axes, values, runs.policies)
        axes.set_xticks(axes.get_xticks(), runs.policies, rotation=60, rotation_mode="anchor", ha="right", fontsize=9)
        axes.set_title(scene.title, fontsize=10)
    left.set_ylabel(title)
    if figure == "rpe_mm":
        left.set_yscale("log")
    else:
        left.set_ylim(bottom=0)
    save(canvas, file)


def _draw_exposures(runs: PolicyRuns, file: Path) -> None:
    canvas, (upper, lower) = panels(2, 1, 5.0, sharex=True)
    for colour, policy in zip(COLOURS, (policy for policy in POLICIES if policy in runs.policies), strict=False):
        run = runs.of(UNEVEN, policy)[0]
        time_s = np.arange(len(run["times_us"])) * EVERY / RATE_HZ
        for axes, values in ((upper, np.array(run["times_us"]) / 1e3), (lower, run["gains_db"])):
            axes.plot(time_s, values, color=colour, linewidth=1.2, label=policy)
    upper.set(yscale="log", ylabel="exposure time (ms)")
    lower.set(ylabel="gain (dB)", xlabel="time (s)")
    canvas.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=6, fontsize=9)
    save(canvas, file)


EXPERIMENT = Experiment(
    "fig12", "Fig. 12 to 14: odometry with each policy, in uneven and in low light", jobs, section, data
)


SLAM_POLICIES = (DEFAULT_POLICY, *LAWS)
FEW_ROOMS = ROOMS[:3]
_ABSENT = f"`{PACKAGE}` is not installed, so nothing was measured: see docs/do/experiments.md."


def slam_jobs(quick: bool) -> list[Job]:
    """One for each light, room and policy; none if ORB-SLAM3 is not installed."""
    if not installed():
        return []
    rooms, seconds = ((2,), 1.7) if quick else (FEW_ROOMS, 8.0)
    return [
        Job(
            measure_orb_slam3,
            {
                "light": scene.light, "room": room, "seed": room, "policy": policy, "frames": round(seconds * RATE_HZ),
                "version": version(PACKAGE),
            },
            cost_s=10.0 + 5.0 * seconds,
        )
        for scene in (UNEVEN, LOW)
        for room in rooms
        for policy in SLAM_POLICIES
    ]  # fmt: skip


def slam_section(results: Results, _folder: Path) -> ReportSection:
    """A table only: so few courses judge no claim."""
    if not results:
        return ReportSection(_ABSENT, [], [])
    rows = []
    for scene in (UNEVEN, LOW):
        of_light = [(case["policy"], one) for case, one in results if case["light"] == scene.light]
        runs = {policy: [one for name, one in of_light if name == policy] for policy in SLAM_POLICIES}
        errors = {policy: np.array([run["rpe_mm"] for run in of]) for policy, of in runs.items()}
        for policy, of in runs.items():
            lost = f"{100 * np.mean([run['lost_share'] for run in of]):.1f} %"
            failed = f"{sum(run['failed'] for run in of)}/{len(of)}"
            apart = ", ".join(f"{by:+.2f}" for by in errors[DEFAULT_POLICY] - errors[policy])
            difference = "" if policy == DEFAULT_POLICY else apart
            rows.append([f"{scene.title}: `{policy}`", f"{errors[policy].mean():.2f}", lost, failed, difference])
    caption = f"ORB-SLAM3; RPE over 20 mm, and that of `{DEFAULT_POLICY}` minus it in each room, in mm."
    heads = ["", "RPE mean", "pairs lost", "runs failed", f"`{DEFAULT_POLICY}` minus it"]
    return ReportSection(text_beside(__file__, "fig12_slam.txt", package=PACKAGE), [], [Table(caption, heads, rows)])


WITH_ORB_SLAM3 = Experiment(
    "orbslam3", "Fig. 13 with ORB-SLAM3, a few courses, where it is installed", slam_jobs, slam_section
)
