"""Every constant of a policy altered, one at a time, and what that does to its courses.

What is altered must not judge itself. So only decisions leave the altered process; an unaltered one takes the same
frames again and judges all by one yardstick: the best exposure of each frame by the unaltered objective, split as the
unaltered policy splits it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing
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
from evaluation.arena.runs import MAIN_DELAY, TUNE_SCENES, ArenaRun, results
from evaluation.jobs.native import ROOT, c_files
from evaluation.long_runs import KeptResults, LongProgress
from evaluation.pool import over_processes
from evaluation.prose import table_row, text_beside
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import Entrant, MakeLoop
from evaluation.stage.oracle import Oracle, best_start
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import FrameSet
from imaging.response import ResponseFunction

# Those in which single rules of an earlier default weighed most: jumps out of white, motion, light that beats.
QUICK_SCENARIOS = ("step_up", "pan", "flicker")
# The folders whose files decide what comes out.
_CODE = ("autoexpose_daemon/control", "calibration", "drivers", "evaluation", "fake_camera/world", "imaging")
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
    jobs: int,
    folder: Path,
    *,
    console: Console,
    frames: int | None = None,
) -> Ablation:
    """Take a policy through all courses with each constant altered, in `jobs` processes. What is finished is kept in
    `folder`, and found there by the next call unless any code changed. Raises AutoexposeError if the unaltered policy
    fails, or does not decide the same twice."""
    kept = _Kept(folder)
    trials = [(constant, what) for constant in constants for what in constant.alterations]
    starts = dict(over_processes(start_of, courses, jobs))
    plain = AlteredRequest(None, policy, courses, [starts[course] for course in courses], frames)
    requests = [plain, *(replace(plain, alteration=constant.alterations[what]) for constant, what in trials)]
    with LongProgress(console, 3600.0) as progress:
        bar = progress.add_task("alterations", total=len(requests))
        taken = _taken(requests, jobs, kept, lambda: progress.update(bar, advance=1))
        if isinstance(taken[0], str):
            raise AutoexposeError(f"{policy} fails without any alteration: {taken[0]}")
        bar = progress.add_task("judged courses", total=len(courses))
        ways = [
            {json.dumps(each[place]) for each in taken if not isinstance(each, str)} for place in range(len(courses))
        ]
        asked = [
            (policy, course, sorted(ways_of_one), frames) for course, ways_of_one in zip(courses, ways, strict=True)
        ]
        scores = _judged(asked, jobs, kept, lambda: progress.update(bar, advance=1))
    for course, each in zip(courses, taken[0], strict=True):
        if scores[course][json.dumps(each)] != scores[course][policy]:
            raise AutoexposeError(f"{policy} decides otherwise when it takes {course} again: it cannot be compared")

    def figures(name: str, decisions: list[Decisions]) -> Figures:
        runs = [
            ArenaRun(name, *course, MAIN_DELAY, "tune", CourseScore(**scores[course][json.dumps(each)]))
            for course, each in zip(courses, decisions, strict=True)
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


class _Kept(KeptResults[Any]):
    """Results by what was asked, and the code that answered."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        state = hashlib.sha256()
        for path in sorted(path for room in _CODE for path in (ROOT / room).rglob("*")):
            if path.suffix in (".py", ".so", ".npz"):
                state.update(str(path.relative_to(ROOT)).encode() + path.read_bytes())
        self._code = state.hexdigest()

    def key(self, asked: Any) -> str:
        return hashlib.sha256(json.dumps([self._code, asked], sort_keys=True).encode()).hexdigest()


def _taken(
    requests: Sequence[AlteredRequest], jobs: int, kept: _Kept, advance: Callable[[], None]
) -> list[list[Decisions] | str]:
    """The decisions of each request, or how it failed."""

    def answer(request: AlteredRequest) -> list[Decisions] | str:
        found = kept.get(asdict(request))
        if found is None:
            found = (run_altered(request),)
            kept.put(asdict(request), found[0])
        decisions: list[Decisions] | str = found[0]
        return decisions

    with ThreadPoolExecutor(jobs) as pool:  # each waits for a process of its own
        futures = [pool.submit(answer, request) for request in requests]
        try:
            for future in as_completed(futures):
                future.result()
                advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [future.result() for future in futures]


_Asked = tuple[str, Course, list[str], int | None]


def _judged(
    asked: Sequence[_Asked], jobs: int, kept: _Kept, advance: Callable[[], None]
) -> dict[Course, dict[str, dict[str, Any]]]:
    """The scores of all ways to take each course, by the decisions as JSON."""
    scores = {}
    for each in asked:
        found = kept.get(each)
        if found is not None:
            scores[each[1]] = found[0]
            advance()
    missing = [each for each in asked if each[1] not in scores]
    with closing(over_processes(_judge, missing, min(jobs, max(len(missing), 1)))) as finished:
        for each, result in finished:
            kept.put(each, result)
            scores[each[1]] = result
            advance()
    return scores


def _judge(asked: _Asked) -> dict[str, dict[str, Any]]:
    policy, course, ways, frames = asked
    scores = judge(policy, course, {way: json.loads(way) for way in ways}, frames)
    return {way: asdict(score) for way, score in scores.items()}


def start_of(course: Course) -> tuple[float, float]:
    """Exposure time (us) and gain (dB) that all start a course with."""
    stage, _ = course_of(*course)
    start = best_start(Oracle(stage, ("left", "right") if stage.has_lamp else ("left",)))
    return start.exposure_time_us, start.gain_db


def judge(
    policy: str, course: Course, rolled_out: Mapping[str, Decisions], frames: int | None = None
) -> dict[str, CourseScore]:
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
    """Write `ablation.md` into a folder; returns its path."""
    head, *rows = _cells(ablation)
    lines = [head, ["---"] * len(head), *rows]
    table = "\n".join(map(table_row, lines))
    path = folder / "ablation.md"
    title = f"# Every constant of `{ablation.policy}`"
    parts = [title, text_beside(__file__), _courses(ablation), table, not_altered(ablation)]
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
