"""One course: run through by a policy, or judged for many that ran through it with a constant altered.

What is altered must not judge itself. So only decisions leave the altered process; an unaltered one takes the same
frames again and judges all by one yardstick: the best exposure of each frame by the unaltered objective, split as the
unaltered policy splits it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import cv2

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from evaluation.arena.race import course_of, run_course
from evaluation.arena.runs import MAIN_DELAY
from evaluation.arena.scores import Score
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.delayed_loop import Entrant, MakeLoop
from evaluation.stage.oracle import Oracle, best_start
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

Course = tuple[str, str, int]  # Scenario, scene and seed
Decisions = list[dict[str, Any]]  # One for each frame, as plain data


def start_of(course: Course) -> tuple[float, float]:
    """Exposure time (us) and gain (dB) that all start a course with."""
    stage, _ = course_of(*course)
    start = best_start(Oracle(stage, ("left", "right") if stage.has_lamp else ("left",)))
    return start.exposure_time_us, start.gain_db


def roll_out(policy: str, course: Course, start: tuple[float, float], frames: int | None = None) -> Decisions:
    """The decisions of a policy in closed loop."""
    cv2.setNumThreads(1)
    stage, _ = course_of(*course)
    delayed = Entrant.of(policy, MAIN_DELAY).enter(ExposureSetting(*start))
    for frame in range(frames or SCENARIOS[course[0]].frames):
        stage.go_to(frame)
        delayed.step(stage.take)
    return [asdict(decision) for decision in delayed.decisions]


def judge(
    policy: str, course: Course, rolled_out: Mapping[str, Decisions], frames: int | None = None
) -> dict[str, Score]:
    """The scores of all that took a course, by name; those of the unaltered policy by the policy's."""
    leaders: list[_Leader] = []

    def lead(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        leaders.append(_Leader(policy, response, limits, start))
        return leaders[0]

    def follow(taken: Decisions) -> MakeLoop:
        return lambda *_: _Follower(leaders[0], taken)

    entrants = [Entrant(policy, MAIN_DELAY, lead)]  # enters and steps before all others
    entrants += [Entrant(name, MAIN_DELAY, follow(taken)) for name, taken in rolled_out.items()]
    return {series.entrant.name: series.score() for series in run_course(*course, entrants, frames=frames)}


class _Leader(ControlLoop):
    """The unaltered policy: its split and its motion are the yardstick's."""

    motion_px = 0.0

    def step(self, pair: StereoPair, *given: Any, **named: Any) -> Decision:
        decision = super().step(pair, *given, **named)
        self.motion_px = decision.motion_px
        return decision


class _Follower(ControlLoop):
    """Decides as was decided elsewhere."""

    def __init__(self, leader: _Leader, taken: Decisions) -> None:
        setup = leader.setup
        super().__init__(setup.policy_id, setup.responses, setup.limits, setup.start)
        self._leader, self._ahead = leader, iter(taken)

    @property
    def balance(self) -> Balance:
        return self._leader.balance

    def step(self, pair: StereoPair, *given: Any, **named: Any) -> Decision:
        taken = next(self._ahead)
        setting = ExposureSetting(**taken["setting"])
        return Decision(**{**taken, "setting": setting, "motion_px": self._leader.motion_px})
