"""`autoexpose arena`: the race with its JSON and report, and what --count counts."""

from __future__ import annotations

import json
from collections.abc import Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena import arena_app, count, runs
from evaluation.arena.arena_app import arena_app as app
from evaluation.arena.arena_report import informed, mean_ratios, outcomes
from evaluation.arena.count import Count, count_c, count_python, python_files, snapshot_fields
from evaluation.arena.race import CourseScore, Series
from evaluation.arena.runs import ArenaRun, document, full_plan, quick_plan, results
from evaluation.experiments.worth.matches.courses import courses
from evaluation.jobs import run as jobs_run
from evaluation.jobs.native import c_files
from evaluation.scenes.scenarios import SCENARIOS, WARM_UP_FRAMES
from evaluation.stage.camera import Entrant
from imaging.errors import AutoexposeError, ConfigurationError

FIGURES = {
    "settle_frames": (int, float, type(None)), "overshoot_stops": float, "steady_std_stops": float,
    "metric_ratio_mean": float, "metric_ratio_p05": float, "bad_frame_share": float, "gain_db_mean": float,
    "objective_ratio_mean": float, "objective_ratio_p05": float, "any_split_ratio_mean": float,
    "pair_ratio_mean": float, "lost_pair_share": float,
}  # fmt: skip

COMMON = {"policy": str, "scenario": str, "delay_frames": int, "split": str, **FIGURES}


def made_up(
    policy: str, scenario: str, settle: int | None, ratio: float, *, delay: int = 2, seed: int = 1000
) -> ArenaRun:
    score = CourseScore(settle, 0.1, 0.05, ratio, ratio / 2, 0.0, 12.0, ratio, ratio / 2, ratio, ratio, 0.0)
    return ArenaRun(policy, scenario, "room", seed, delay, "heldout", score)


SHORT = {name: replace(SCENARIOS[name], frames=WARM_UP_FRAMES + 10) for name in ("step_up", "step_down")}


@pytest.fixture
def short_scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, scenario in SHORT.items():
        monkeypatch.setitem(SCENARIOS, name, scenario)
    monkeypatch.setattr(runs, "HELD_OUT_SEEDS", {"shelves": 1, "street": 1})


@pytest.mark.usefixtures("short_scenarios")
def test_quick_arena_writes_json_and_report(tmp_path: Path) -> None:
    out, folder = tmp_path / "out.json", tmp_path / "report"
    options = ["--quick", "--jobs", "1", "--policies", "begin2022,fixed", "--scenarios", "step_up,step_down"]
    options += ["--kept", str(tmp_path / "kept")]
    result = CliRunner().invoke(app, [*options, "--json", str(out), "--report", str(folder)])
    assert result.exit_code == 0, result.output
    figures = json.loads(out.read_text())
    assert set(figures) == {"default_policy", "runs", "results"}
    assert len(figures["runs"]) == len(figures["results"]) == 4
    for run in figures["runs"]:
        check(run, {**COMMON, "scene": str, "seed": int})
        assert run["settle_frames"] is None or isinstance(run["settle_frames"], int)
        assert run["split"] == "heldout" and run["seed"] >= 1000
    for row in figures["results"]:
        check(row, {**COMMON, "stuck_share": float})
    report = (folder / "arena.md").read_text()
    assert "`begin2022`" in report and "| step_up | step_down |" in report
    assert {file.name for file in folder.iterdir()} == {"arena.md", "table.png", "step_up.png", "step_down.png"}


def test_rows_of_another_unit_are_known() -> None:
    metrics = {"a": 0.5, "b": 0.4}
    rows = [{"policy": name, "objective_ratio_mean": 0.5, "metric_ratio_mean": m} for name, m in metrics.items()]
    assert informed(rows) == {"b"}


def check(entry: dict[str, object], schema: dict[str, object]) -> None:
    assert set(entry) == set(schema)
    for key, kind in schema.items():
        assert isinstance(entry[key], kind), key  # type: ignore[arg-type]


@pytest.mark.usefixtures("short_scenarios")
def test_a_stopped_arena_goes_on_and_another_policy_costs_its_own_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is asked for later is to the byte what it would be at once."""
    raced: list[tuple[str, list[str]]] = []
    run_course = runs.run_course

    def noted(scenario: str, scene: str, seed: int, entrants: Sequence[Entrant]) -> list[Series]:
        raced.append((scenario, [entrant.name for entrant in entrants]))
        if len(raced) == 2:
            raise KeyboardInterrupt
        return run_course(scenario, scene, seed, entrants)

    def race(*policies: str, kept: str = "kept") -> str:
        file = tmp_path / "out.json"
        given = ["--policies", ",".join(policies), "--kept", str(tmp_path / kept), "--json", str(file)]
        app(["--quick", "--jobs", "1", "--scenarios", "step_up,step_down", *given], standalone_mode=False)
        return file.read_text()

    monkeypatch.setattr(runs, "run_course", noted)
    with pytest.raises(AutoexposeError, match="the same command goes on where it was"):
        race("fixed", "kim2018")
    race("fixed", "kim2018")
    first, again, other = (scenario for scenario, _ in raced)
    assert {first, again} == {"step_up", "step_down"} and again == other
    both = race("neves2009", "fixed", "kim2018")
    assert [names for _, names in raced[3:]] == 2 * [["neves2009"]]
    assert both == race("neves2009", "fixed", "kim2018", kept="anew")


def test_an_arena_whose_process_dies_ends_in_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def killed(*_: object, **__: object) -> None:
        raise BrokenProcessPool

    monkeypatch.setattr(jobs_run, "over_processes", killed)
    with pytest.raises(AutoexposeError, match=r"killed from outside.*fewer --jobs"):
        app(["--quick", "--jobs", "1", "--kept", str(tmp_path)], standalone_mode=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--jobs", "2"], r"say how much: --full takes about \d+ minutes .*, --quick about (a minute|\d+ minutes)"),
        (["--quick", "--full"], "--quick and --full exclude each other"),
        (["--count", "--quick"], "leave the others out"),
        (["--count", "--ablate"], "leave the others out"),
        (["--ablate", "--full"], "leave the others out"),
        (["--ablate", "--policies", "fixed"], "leave the others out"),
        (["--quick", "--policies", "begin"], "there is no policy 'begin'"),
        (["--quick", "--scenarios", "step"], "there is no scenario 'step'"),
        (["--quick", "--json", "nowhere/out.json"], "there is no folder nowhere"),
        (["--quick", "--pictures", "nowhere"], "no .hdr file"),
        (["--quick", "--pictures", "."], "damaged.hdr is not a Radiance picture"),
        (["--quick", "--json", "."], "is a folder"),
        (["--quick", "--report", "damaged.hdr"], "damaged.hdr: cannot be written to"),
    ],
)
def test_bad_options_get_one_sentence_before_any_run(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "damaged.hdr").write_text("no picture")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(arena_app, "run_long", lambda *_: pytest.fail("it ran"))
    with pytest.raises(ConfigurationError, match=message):
        app(options, standalone_mode=False)


def test_median_of_settling_counts_stuck_runs_as_latest() -> None:
    def row(*settle: int | None) -> dict[str, object]:
        return results([made_up("a", "pan", frames, 0.5, seed=1000 + i) for i, frames in enumerate(settle)])[0]

    assert row(4, 8, None)["settle_frames"] == 8
    assert row(4, 8)["settle_frames"] == 6
    assert row(4, None, None)["settle_frames"] is None
    assert row(4, None)["settle_frames"] is None
    assert row(4, None, None)["stuck_share"] == pytest.approx(2 / 3)


def test_results_are_of_held_out_runs_with_two_frames_of_delay() -> None:
    runs = [
        made_up("a", "pan", 3, 0.8),
        made_up("a", "pan", 3, 0.6, seed=1001),
        made_up("a", "pan", 3, 0.1, delay=3),
        ArenaRun(
            "a", "pan", "room", 7, 2, "tune", CourseScore(1, 0.0, 0.0, 0.2, 0.2, 0.0, 0.0, 0.2, 0.2, 0.2, 0.2, 0.0)
        ),
    ]
    figures = document(runs, "a")
    assert len(figures["runs"]) == 4
    assert [row["metric_ratio_mean"] for row in figures["results"]] == [pytest.approx(0.7)]


def test_ranking_is_by_the_mean_over_scenarios() -> None:
    runs = [made_up(p, s, 3, r) for p, s, r in (("a", "pan", 0.9), ("a", "tunnel", 0.1), ("b", "pan", 0.6))]
    assert mean_ratios(results(runs)) == [("b", pytest.approx(0.6)), ("a", pytest.approx(0.5))]


def test_targets_depend_on_the_delay() -> None:
    def share(settle: int | None, delay: int) -> float:
        return outcomes([made_up("a", "step_up", settle, 0.9, delay=delay)])[0][1]

    assert [share(8, 2), share(9, 2), share(11, 3), share(None, 2)] == [1.0, 0.0, 1.0, 0.0]


def test_the_full_plan_keeps_tuning_and_judging_apart() -> None:
    tasks = full_plan(list(SCENARIOS))
    tuned = {task.scene for task in tasks if task.split == "tune"}
    held_out = {task.scene for task in tasks if task.split == "heldout"}
    assert all((task.seed >= 1000) == (task.split == "heldout") for task in tasks)
    assert all(task.seed < 100 or task.split == "heldout" for task in tasks)
    assert len(held_out - tuned) >= 2
    assert {delay for task in tasks for delay in task.delays} == {1, 2, 3}
    quick = quick_plan(list(SCENARIOS))
    assert {task.scenario for task in quick} == set(SCENARIOS)
    assert not {task.seed for task in quick} & {task.seed for task in tasks}  # CI runs it: it may not open a report


def test_no_painting_that_judges_is_among_the_tuning_courses_of_worth() -> None:
    judging = {f"{task.scene}:{task.seed}" for task in full_plan(list(SCENARIOS)) if task.split == "heldout"}
    tuned = {course.scene for course in courses("tuning")}
    assert not judging & tuned
    assert {"hall", "shelves"} <= {scene.partition(":")[0] for scene in tuned}  # so only their seeds are held out


@pytest.mark.parametrize(
    ("source", "numbers", "branches"),
    [
        ('"""3 if 4."""\n# 5 while 6\nX = "7 if 8"', 0, 0),
        ("x = (0, 1, 2, -1, 0.0, 1.0, 2.0, True, None)", 0, 0),
        ("x = (3, -2.5, 1e-3, 0x10, 3j)", 4, 0),  # a complex number is no constant of a decision
        ("if a and b or c:\n    x\nelif d:\n    y\nelse:\n    z", 0, 2),
        ("while a:\n    x\nfor b in c:\n    y\ntry:\n    assert d\nexcept E:\n    z", 0, 1),
        ("x = a if b else c if d else e", 0, 2),
        ("x = [a for b in c for d in e if f if g]\ny = lambda: 7 if h else 8", 2, 3),
        ("match a:\n    case 5:\n        x\n    case [b] if b:\n        y\n    case _:\n        z", 1, 2),
    ],
)
def test_python(source: str, numbers: int, branches: int) -> None:
    assert count_python(source) == Count(numbers, branches)


@pytest.mark.parametrize(
    ("source", "numbers", "branches"),
    [
        ("// 3 if\n/* 4\n * while 5 */\nchar *s = \"6 ? \\\" 7\", c = '8', d = '\\'';", 0, 0),
        ("x = 0 + 1 + 2 - 1 + 0u + 1UL + 2.0f + 0.f + .0 + 0x1 + 1.;", 0, 0),
        ("x = 3 + 10 + 0x10u + 1e-3f + .5 + 2.5 + 20 + 1.01 + 0x1p-4 + 12L;", 10, 0),
        ("x2 = uint8_t + a16[b3];", 0, 0),
        ('#include "a9.h"\n#if X > 7 && \\\n    Y > 8\n#  define N 9\n#elif Z > 3\n#endif', 1, 0),
        ("if (a && b) x; else if (c) y; else z;", 0, 2),
        ("do { x; } while (a); while (b) y; for (;;) z;", 0, 2),
        ("switch (a) { case 5: x; case B: y; default: z; }", 1, 2),
        ("x = a ? b : c ? 4 : 5;", 2, 2),
    ],
)
def test_c(source: str, numbers: int, branches: int) -> None:
    assert count_c(source) == Count(numbers, branches)


def test_follows_imports_within_its_scope_and_the_calls_into_c(tmp_path: Path) -> None:
    control = "autoexpose_daemon/control"
    sources = {
        f"{control}/loop.py": "from autoexpose_daemon.control.policies import table",
        f"{control}/policies/__init__.py": "",
        f"{control}/policies/table.py": "from imaging.errors import Error",
        f"{control}/policies/belief/policy.py": """
from typing import TYPE_CHECKING
from autoexpose_daemon.control import _native
from imaging.response import Response
import imaging.exposure
if TYPE_CHECKING:
    from autoexpose_daemon.control.unreached import Type
def decide():
    from autoexpose_daemon.control.late import late
    _native.sum_of(3)
""",
        f"{control}/late.py": "",
        f"{control}/unreached.py": "X = 3",
        f"{control}/policies/published/fixed.py": "X = 3",
        "imaging/__init__.py": "",
        "imaging/response.py": "",
        "imaging/exposure.py": "",
        "imaging/errors.py": "X = 3",
        f"{control}/native/bindings.c": '#include <math.h>\n#include "sums.h"\nX = { "sum_of", f, 0 };',
        f"{control}/native/sums.h": '#include "image.h"',
        f"{control}/native/sums.c": '#include "sums.h"',
        f"{control}/native/image.h": "",
        f"{control}/native/others.c": '#include "image.h"\nX = {"product_of", f, 0};',
    }
    for name, source in sources.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(source)
    python = python_files(DEFAULT_POLICY, tmp_path)
    assert set(python) == {
        "autoexpose_daemon.control.loop",
        "autoexpose_daemon.control.policies.table",
        "autoexpose_daemon.control.policies.belief.policy",
        "autoexpose_daemon.control.late",
        "imaging.response",
        "imaging.exposure",
    }
    assert [path.name for path in c_files(list(python.values()), tmp_path)] == [
        *("bindings.c", "image.h", "sums.c", "sums.h")
    ]
    with pytest.raises(ConfigurationError, match="checkout"):
        c_files([], tmp_path / "installed")


def test_fields_of_a_snapshot_have_names() -> None:
    state = {
        "level": 1.0,
        "past": [{"level": 1.0, "pair": [1, 2]}, {"level": 2.0, "pair": [3, 4]}],
        "views": {"left": {"curve": np.zeros(9)}, "right": {"curve": np.zeros(9)}},
        "served": {"left": 0.5, "waited": 3},  # a field that is called left, not a camera
        "nothing": None,
        "empty": [],
    }
    assert len(snapshot_fields(state)) == 1 + 2 + 1 + 2 + 1 + 1


def test_a_snapshot_is_of_the_policy() -> None:
    stateless, stateful = (snapshot_fields(count.snapshot_of(policy, frames=1)) for policy in ("fixed", "shin2019"))
    assert len(stateless) < len(stateful)


def test_command_counts_the_default_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(count, "snapshot_of", lambda policy: {"level": 1.0, "target": None})
    result = CliRunner().invoke(app, ["--count", "--json", str(tmp_path / "count.json")])
    assert result.exit_code == 0, result.output
    counts = json.loads((tmp_path / "count.json").read_text())
    assert (counts["policy"], counts["snapshot_fields"]) == (DEFAULT_POLICY, 2)
    files = {each["file"]: each for each in counts["files"]}
    assert {"autoexpose_daemon/control/loop.py", "imaging/exposure.py"} < set(files)
    assert any(name.endswith(".c") for name in files) and not any("published" in name for name in files)
    for what in ("numbers", "branches"):
        assert counts[what] == sum(each[what] for each in counts["files"])
        assert str(counts[what]) in result.output
