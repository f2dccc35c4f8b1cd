"""The claims of B&H's Fig. 12 to 14 and ours, judged on the runs of fig12 by scene and policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.experiments.drives.drives import ALIKE_MM, over_rooms
from evaluation.experiments.experiment import Claim, Results, Verdict
from evaluation.experiments.statistics import Interval, above, alike, below, not_above, together
from evaluation.odometry.lap import Light
from fake_camera.world.sensor import DEFAULT_F_NUMBER

Run = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Scene:
    """A light, and the cameras' lenses."""

    title: str
    light: Light
    lens_f_number: float = DEFAULT_F_NUMBER


UNEVEN = Scene("(a) 1 to 217 lux", "uneven")
LOW = Scene("(b) 2 to 4 lux", "low")
LOW_SCENES = (LOW, Scene("(b) half a lux", "faint"), Scene("(b) 2 to 4 lux, f/2.8", "low", 2.8))
SCENES = (UNEVEN, *LOW_SCENES)


class PolicyRuns:
    """Results of jobs: each policy of a scene has driven through the same rooms.

    `policies`: in the order of their first runs. `room`: the first one.
    """

    def __init__(self, results: Results) -> None:
        self._runs: dict[tuple[Any, Any], dict[str, list[Run]]] = {}
        for case, runs in results:
            of_scene = self._runs.setdefault((case["light"], case["lens_f_number"]), {})
            policies: Any = case["policies"]
            for policy, run in zip(policies, runs, strict=True):
                of_scene.setdefault(policy, []).append(run)
        self.policies = list(dict.fromkeys(policy for of_scene in self._runs.values() for policy in of_scene))
        self.room: Any = results[0][0]["room"]

    def of(self, scene: Scene, policy: str) -> list[Run]:
        """All runs of a policy, in the order of their jobs: one for each room."""
        return self._runs.get((scene.light, scene.lens_f_number), {}).get(policy, [])

    def rooms(self, scene: Scene) -> int:
        """How many rooms were driven through."""
        return len(self.of(scene, self.policies[0]))

    def difference(self, scene: Scene, first: str, second: str, figure: Callable[[Run], float]) -> Interval:
        """First minus second, paired by room."""
        pairs = zip(self.of(scene, first), self.of(scene, second), strict=True)
        return over_rooms(np.array([figure(a) - figure(b) for a, b in pairs]))

    def failed(self, scene: Scene, policy: str) -> int:
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
    rules: list[Callable[[PolicyRuns, str], Claim]] = [_metric_is_higher, _error_is_lower_uneven, _error_is_lower_low]
    if "fixed" in runs.policies:
        rules += [_fixed_like, _fixed_worse]
    if RIVALS[0] in runs.policies:
        rules.append(_rival_is_darker)
    return found + [rule(runs, law) for rule in rules for law in laws]


def _paper(law: str, figure: str, claim: str, ours: str, judged: tuple[Verdict, str]) -> Claim:
    """A claim of the paper, which counts for the law as coded only."""
    counted = law == next(iter(LAWS))
    return Claim(f"B&H {figure}, law {LAWS[law]}", claim, f"`{law}`: {ours}", *judged, counted=counted)


def _ours(runs: PolicyRuns, scene: Scene, law: str) -> Claim:
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


def _error_is_lower_uneven(runs: PolicyRuns, law: str) -> Claim:
    return _error_is_lower(runs, law, UNEVEN)


def _error_is_lower_low(runs: PolicyRuns, law: str) -> Claim:
    return _error_is_lower(runs, law, LOW)


def _error_is_lower(runs: PolicyRuns, law: str, scene: Scene) -> Claim:
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
