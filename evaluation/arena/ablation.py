"""Every constant of a policy altered, one at a time, and what that does to its courses.

What is altered must not judge itself. So only decisions leave the altered process; an unaltered one takes the same
frames again and judges all by one yardstick: the best exposure of each frame by the unaltered objective, split as the
unaltered policy splits it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import cycle
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.step import StepInputs
from evaluation.arena.altered_policy import (
    AlteredRequest,
    Constant,
    Course,
    Decisions,
    constants_in_c,
    constants_of,
    run_altered,
)
from evaluation.arena.count import count_c, count_python, python_files
from evaluation.arena.race import CourseScore, course_of, run_course
from evaluation.arena.runs import FRAME_S, MAIN_DELAY, TUNE_SCENES, ArenaRun, results
from evaluation.jobs.job import Job
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.native import ROOT, c_files
from evaluation.jobs.run import Workers, run_long
from evaluation.prose import markdown_table, text_beside
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import Entrant, MakeLoop
from evaluation.stage.oracle import Oracle, best_start
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import FrameSet
from imaging.response import ResponseFunction

# Those in which single rules of an earlier default weighed most: jumps out of white, motion, light that beats.
QUICK_SCENARIOS = ("step_up", "pan", "flicker")
ALL = "all"  # In the place of a scenario: all courses together
Figures = dict[str, dict[str, Any]]  # A row of `results` for each scenario, and for `ALL`


@dataclass(frozen=True, slots=True)
class AblationTrial:
    """A constant, what was done to it (a key of `Constant.alterations`), and what came of that."""

    constant: Constant
    what: str
    figures: Figures
    idle: bool = False  # no decision of any course changed
    error: str | None = None  # how the policy failed; it then has no figures


@dataclass(frozen=True, slots=True)
class Ablation:
    """All trials of a policy, and what the unaltered one does."""

    policy: str
    courses: Sequence[Course]
    unaltered: Figures
    trials: Sequence[AblationTrial]


def ablation_courses(scenarios: Sequence[str], quick: bool) -> list[Course]:
    """One tuning course for each scenario, the same whichever are chosen; if quick, only of `QUICK_SCENARIOS`.

    Raises ConfigurationError when none is left.
    """
    scenes = dict(zip(SCENARIOS, cycle(TUNE_SCENES), strict=False))
    chosen = [(each, scenes[each], 0) for each in scenarios if not quick or each in QUICK_SCENARIOS]
    if not chosen:
        raise ConfigurationError(f"--ablate --quick is of {', '.join(QUICK_SCENARIOS)}: choose of these, or no --quick")
    return chosen


def policy_constants(policy: str) -> tuple[list[Constant], list[Constant]]:
    """Those of all files of control that the policy's decision reaches (`count.RULE`), and those with a copy in C. The
    copy has the same name and value. Altering the other would do nothing, or only half of it."""
    files = python_files(policy)
    in_c = {each for path in c_files(list(files.values())) for each in constants_in_c(path.read_text(encoding="utf-8"))}
    ours = {module: path for module, path in files.items() if module.startswith("autoexpose_daemon.")}
    found = [each for module, path in ours.items() for each in constants_of(module, path.read_text(encoding="utf-8"))]
    copied = [constant for constant in found if (constant.name, constant.value) in in_c]
    return [constant for constant in found if constant not in copied], copied


def ablate(
    policy: str,
    constants: Sequence[Constant],
    courses: Sequence[Course],
    *,
    kept: ResultCache,
    workers: Workers,
    console: Console,
) -> Ablation:
    """Take a policy through all courses with each constant altered. Raises AutoexposeError if the unaltered policy
    fails, or does not decide the same twice."""
    trials = [(constant, what) for constant in constants for what in constant.alterations]
    to_start = [Job(start_of, {"course": list(course)}, policies=()) for course in courses]
    starts: list[Any] = run_long(to_start, kept, workers, console, "starts")
    plain = AlteredRequest(None, policy, courses, starts)
    requests = [plain, *(replace(plain, alteration=constant.alterations[what]) for constant, what in trials)]
    cost_s = FRAME_S * sum(SCENARIOS[scenario].frames for scenario, _, _ in courses)
    asked = [Job(decisions_of, asdict(request), cost_s, (policy,)) for request in requests]
    taken: list[Any] = run_long(asked, kept, workers, console, "alterations")
    if isinstance(taken[0], str):
        raise AutoexposeError(f"{policy} fails without any alteration: {taken[0]}")
    ways = [_different([each[place] for each in taken if not isinstance(each, str)]) for place in range(len(courses))]
    to_judge = [
        Job(scores_of, {"policy": policy, "course": list(course), "ways": each}, len(each), (policy,))
        for course, each in zip(courses, ways, strict=True)
    ]
    judged: list[Any] = run_long(to_judge, kept, workers, console, "judged courses")
    for course, (own, again, *_) in zip(courses, judged, strict=True):
        if own != again:
            raise AutoexposeError(f"{policy} decides otherwise when it takes {course} again: it cannot be compared")

    def figures(name: str, decisions: list[Decisions]) -> Figures:
        runs = [
            ArenaRun(name, *course, MAIN_DELAY, "tune", CourseScore(**scores[1 + each.index(way)]))
            for course, each, scores, way in zip(courses, ways, judged, decisions, strict=True)
        ]
        return {row["scenario"]: row for row in results([*runs, *(replace(run, scenario=ALL) for run in runs)])}

    return Ablation(
        policy,
        courses,
        figures(policy, taken[0]),
        [
            AblationTrial(*trial, {}, error=each)
            if isinstance(each, str)
            else AblationTrial(*trial, figures(policy, each), idle=each == taken[0])
            for trial, each in zip(trials, taken[1:], strict=True)
        ],
    )


def decisions_of(**request: Any) -> list[Any] | str:
    """The `Decisions` in each course, or what the alteration breaks. `request`: an `AlteredRequest`."""
    return run_altered(request)


def scores_of(*, policy: str, course: list[Any], ways: list[Decisions]) -> list[dict[str, Any]]:
    """The scores of a course: of the unaltered policy, then of each way to take it."""
    scenario, scene, seed = course
    return [asdict(score) for score in judge(policy, (scenario, scene, seed), ways)]


def _different(taken: Sequence[Decisions]) -> list[Decisions]:
    """Each way once, the first one first."""
    return [each for place, each in enumerate(taken) if each not in taken[:place]]


def start_of(course: Sequence[Any]) -> list[float]:
    """Exposure time (us) and gain (dB) that all start a course with."""
    scenario, scene, seed = course
    stage, _ = course_of(scenario, scene, seed)
    start = best_start(Oracle(stage, ("left", "right") if stage.has_lamp else ("left",)))
    return [start.exposure_time_us, start.gain_db]


def judge(policy: str, course: Course, ways: Sequence[Decisions], frames: int | None = None) -> list[CourseScore]:
    """The scores of the unaltered policy and of all ways to take a course, by the policy's yardstick."""
    leaders: list[_Leader] = []

    def lead(response: ResponseFunction, limits: ExposureLimits, start: ExposureSetting) -> ControlLoop:
        leaders.append(_Leader(policy, response, limits, start))
        return leaders[0]

    def follow(taken: Decisions) -> MakeLoop:
        return lambda *_: _Follower(leaders[0], taken)

    entrants = [Entrant(policy, MAIN_DELAY, lead)]  # enters and steps before all others
    entrants += [Entrant(f"way {number}", MAIN_DELAY, follow(way)) for number, way in enumerate(ways)]
    return [series.score() for series in run_course(*course, entrants, frames=frames)]


class _Leader(ControlLoop):
    """The unaltered policy: its split and its motion are the yardstick's."""

    motion_px = 0.0

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        decision = super().step(inputs)
        self.motion_px = decision.motion_px
        return decision


class _Follower(ControlLoop):
    """Decides as was decided elsewhere."""

    def __init__(self, leader: _Leader, taken: Decisions) -> None:
        super().__init__(leader.setup)
        self._leader, self._ahead = leader, iter(taken)

    @property
    def balance(self) -> Balance:
        return self._leader.balance

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        taken = next(self._ahead)
        setting = ExposureSetting(**taken["setting"])
        return Decision(**{**taken, "setting": setting, "motion_px": self._leader.motion_px})


# By title: a name in the rows of `results`, and how it is shown.
COLUMNS: dict[str, tuple[str, str]] = {
    "mean": ("objective_ratio_mean", "{:.3f}"),
    "worst 5 %": ("objective_ratio_p05", "{:.3f}"),
    "settle": ("settle_frames", "{:.0f}"),
    "stuck": ("stuck_share", "{:.2f}"),
    "lost pairs": ("lost_pair_share", "{:.3f}"),
}


def write_ablation(ablation: Ablation, folder: Path) -> Path:
    """Write `ablation.md` into a folder, with what changed no decision apart; returns its path."""
    heads, unaltered, *rows = _cells(ablation)
    changed, idle = [unaltered], dict[tuple[str, ...], list[str]]()
    for row, trial in zip(rows, ablation.trials, strict=True):
        if trial.idle:
            *constant, altered = row[:4]
            idle.setdefault(tuple(constant), []).append(altered)
        else:
            changed.append(row)
    parts = [
        f"# Every constant of `{ablation.policy}`",
        text_beside(__file__),
        _courses(ablation),
        markdown_table(heads, changed, texts=4),
        "## What changed no decision on these courses",
        markdown_table(heads[:4], ([*constant, ", ".join(altered)] for constant, altered in idle.items()), texts=4),
        not_altered(ablation),
    ]
    path = folder / "ablation.md"
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def print_ablation(ablation: Ablation, console: Console) -> None:
    """The table without reasons and scenarios, and what is not in it."""
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    head, *rows = [[line[0], *line[2 : 4 + len(COLUMNS)]] for line in _cells(ablation)]
    for title in head:
        table.add_column(title, justify="right" if table.columns else "left", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console.print(table)
    console.print(f"{_courses(ablation)} {not_altered(ablation)}", highlight=False)


def ablation_document(ablation: Ablation) -> dict[str, Any]:
    """All of it as plain data."""
    return {**asdict(ablation), "not_altered": not_altered(ablation)}


def not_altered(ablation: Ablation) -> str:
    """What the table lacks."""
    python = list(python_files(ablation.policy).values())
    numbers = sum(count_python(path.read_text(encoding="utf-8")).numbers for path in python)
    in_c = {path: count_c(path.read_text(encoding="utf-8")).numbers for path in c_files(python)}
    named = ", ".join(str(path.relative_to(ROOT)) for path, count in in_c.items() if count)
    constants = len({(trial.constant.module, trial.constant.name) for trial in ablation.trials})
    copied = ", ".join(constant.name for constant in policy_constants(ablation.policy)[1]) or "none"
    return (
        f"Altered: {constants} constants. Not altered: numbers in tables and within functions (Python has {numbers} "
        f"numbers in all), and all {sum(in_c.values())} in C, which is built already ({named}), so none of which C "
        f"has a copy: {copied}."
    )


def _courses(ablation: Ablation) -> str:
    return "Courses: " + ", ".join(f"{scenario} {scene} {seed}" for scenario, scene, seed in ablation.courses) + "."


def _cells(ablation: Ablation) -> list[list[str]]:
    """The table, line by line, heads first."""
    scenarios = [scenario for scenario in ablation.unaltered if scenario != ALL]

    def figures(of: Figures) -> list[str]:
        whole = [_shown(of[ALL][key], form) for key, form in COLUMNS.values()]
        shares = list(COLUMNS.values())[:2]
        return [*whole, *(" / ".join(_shown(of[each][key], form) for key, form in shares) for each in scenarios)]

    lines = [
        ["constant", "what it is", "value", "altered", *COLUMNS, *scenarios],
        ["unaltered", "", "", "", *figures(ablation.unaltered)],
    ]
    for trial in ablation.trials:
        constant = trial.constant
        name = f"{constant.module.removeprefix('autoexpose_daemon.control.')}.{constant.name}"
        altered = f"{trial.what}: {constant.alterations[trial.what].text}" if trial.what == "off" else trial.what
        same = ["="] * (len(COLUMNS) + len(scenarios))
        failed = [f"fails: {trial.error}", *[""] * (len(same) - 1)]
        shown = failed if trial.error else same if trial.idle else figures(trial.figures)
        lines.append([f"`{name}`", constant.reason, f"{constant.value:g}", altered, *shown])
    return lines


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
