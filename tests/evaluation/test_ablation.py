"""Constants as the source has them, altered before anything copies them, and judged by what is unaltered."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.arena import ablation as ablation_module
from evaluation.arena.ablation import (
    ALL,
    Ablation,
    ablate,
    ablation_courses,
    ablation_document,
    judge,
    policy_constants,
    print_ablation,
    start_of,
    write_ablation,
)
from evaluation.arena.altered_policy import (
    AlteredModule,
    AlteredRequest,
    Course,
    Decisions,
    constants_in_c,
    constants_of,
    roll_out,
    run_altered,
)
from evaluation.arena.race import CourseScore
from evaluation.jobs.kept import ResultCache
from evaluation.jobs.run import here
from evaluation.scenes.scenarios import SCENARIOS, WARM_UP_FRAMES
from imaging.errors import AutoexposeError, ConfigurationError

SOURCE = '''\
"""Größe: bytes and characters differ."""
STEP = 0.4
"""Stops per frame: no more.

And more of it."""
NEAR, FAR = 1 / 8, -3
"""Stops, e.g. between sightings ...
and cells. More."""
FIRST = 12
SECOND = 1
"""Frames."""

LONE: Final = 1e3

class Rule:
    GAIN: ClassVar[float] = 0.25; """Share."""
    PROBES = Probes(2.0, worth=5, kind="far")
    lower = 7
TABLE = (1, 2, 3)
DERIVED = STEP * 2
NAME = "4"
FLAG = True
NONE = 0
NEUTRAL = {"STEP": math.inf, "Rule.GAIN": 0.0, "NONE": 9}
'''


def test_constants_have_value_reason_and_alterations() -> None:
    found = {constant.name: constant for constant in constants_of("m", SOURCE)}
    assert {name: constant.value for name, constant in found.items()} == {
        **{"STEP": 0.4, "NEAR": 0.125, "FAR": -3, "FIRST": 12, "SECOND": 1, "LONE": 1e3, "NONE": 0},
        **{"Rule.GAIN": 0.25, "Rule.PROBES.worth": 5},
    }
    assert found["STEP"].reason == "Stops per frame: no more."
    assert found["NEAR"].reason == found["FAR"].reason == "Stops, e.g. between sightings ... and cells."
    assert found["FIRST"].reason == found["SECOND"].reason == "Frames."
    assert found["LONE"].reason == ""
    texts = {name: {what: each.text for what, each in constant.alterations.items()} for name, constant in found.items()}
    assert texts["STEP"] == {"x 2": "0.8", "/ 2": "0.2", "off": "math.inf"}
    assert texts["Rule.GAIN"] == {"x 2": "0.5", "/ 2": "0.125", "off": "0.0"}
    assert texts["FAR"] == {"x 2": "-6", "/ 2": "-2"}  # a whole number stays one
    assert texts["SECOND"] == {"x 2": "2"} and texts["NONE"] == {"off": "9"}


def test_alterations_take_the_place_of_the_number_alone() -> None:
    source = SOURCE.encode()
    places = {
        constant.name: source[each.start : each.end].decode()
        for constant in constants_of("m", SOURCE)
        for each in constant.alterations.values()
    }
    assert places == {
        **{"STEP": "0.4", "NEAR": "1 / 8", "FAR": "-3", "FIRST": "12", "SECOND": "1", "LONE": "1e3", "NONE": "0"},
        **{"Rule.GAIN": "0.25", "Rule.PROBES.worth": "5"},
    }


def test_what_copies_a_constant_sees_it_altered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = "STEP = 0.5\nOTHER = 0.5\nDERIVED = [STEP]\ndef default(step=STEP):\n    return step\n"
    (tmp_path / "altered_original.py").write_text(source)
    (tmp_path / "altered_copy.py").write_text("from altered_original import STEP, OTHER, DERIVED, default\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.import_module("altered_original")  # leaves bytecode, which must not be taken
    step = constants_of("altered_original", source)[0]
    names = ("altered_original", "altered_copy")
    for name in names:
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(sys, "meta_path", [AlteredModule(step.alterations["x 2"]), *sys.meta_path])
    try:
        copy: Any = importlib.import_module("altered_copy")
        assert (copy.STEP, copy.OTHER, copy.DERIVED, copy.default()) == (1.0, 0.5, [1.0], 1.0)
    finally:
        for name in names:
            sys.modules.pop(name, None)


def test_nothing_of_control_is_loaded_before_the_alteration() -> None:
    asked = "import sys, evaluation.arena.altered_policy; print([m for m in sys.modules if m.startswith('auto')])"
    assert subprocess.check_output([sys.executable, "-c", asked], text=True).strip() == "[]"


def test_a_fresh_process_runs_what_is_altered() -> None:
    module = "autoexpose_daemon.control.policies.published.begin2022"
    source = Path(importlib.import_module(module).__file__ or "").read_text(encoding="utf-8")
    (alteration, *_) = constants_of(module, source)[0].alterations.values()
    broken = replace(alteration, text="unheard_of")
    request = AlteredRequest(broken, "begin2022", [("step_down", "room", 0)], [(100.0, 0.0)], frames=1)
    answer = run_altered(asdict(request))
    assert answer == "NameError: name 'unheard_of' is not defined"


def test_every_constant_of_the_default_policy_is_found() -> None:
    alterable, copied = ({constant.name for constant in each} for each in policy_constants(DEFAULT_POLICY))
    assert {"BRIGHTNESS_LOSS", "MEMORY_S", "NOTHING"} < alterable
    assert "CELLS" in copied


def test_constants_of_c_are_found_by_name_and_value() -> None:
    source = """
#define NEAR_PX 0.4
#define ROUND (1.0 / 12.0) /* of 12 */
#define SHARE 1e-3f // of all
#define GUARD_H
#define CALL(x) (3)
enum { CELLS = 8, ALL = CELLS * CELLS, BIG = 1 << 4, LAST = 3 };
int x = 3 *
    width;
"""
    assert constants_in_c(source) == {("NEAR_PX", 0.4), ("ROUND", 1 / 12), ("SHARE", 1e-3), ("CELLS", 8), ("LAST", 3)}


def test_a_course_taken_again_has_the_same_scores() -> None:
    course, frames = ("step_down", "room", 0), WARM_UP_FRAMES + 4
    decisions = roll_out(DEFAULT_POLICY, course, start_of(course), frames)
    darker = [{**each, "setting": {"exposure_time_us": 20.0, "gain_db": 0.0}} for each in decisions]
    own, again, dark = judge(DEFAULT_POLICY, course, [decisions, darker], frames)
    assert again == own
    assert dark.objective_ratio_mean < 0.5 * own.objective_ratio_mean


COURSES: list[Course] = [("step_up", "room", 0), ("pan", "leaves", 0)]
CONSTANTS = constants_of("autoexpose_daemon.control.made_up", 'IDLE = 4.0\n"""Frames | idle."""\nBUSY = 3.0\nBAD = 5.0')


def fake_run(request: dict[str, Any]) -> list[Decisions] | str:
    """Decides by what is altered, as if a policy had these constants."""
    text = request["alteration"]["text"] if request["alteration"] else ""
    if text == "10.0":
        return "ZeroDivisionError: no frames"
    level = {"6.0": 7, "1.5": 8}.get(text, 5)
    return [[{"level": level}] for _ in request["courses"]]


def fake_start(course: list[Any]) -> list[float]:
    return [100.0, 0.0]


def fake_judge(policy: str, course: Course, ways: list[Decisions]) -> list[CourseScore]:
    """The more, the better; at level 8 the pan is stuck."""
    scores = []
    for level in [5, *(decisions[0]["level"] for decisions in ways)]:
        settle = None if (level, course[0]) == (8, "pan") else 3
        scores.append(CourseScore(settle, *[0.0] * 6, level / 10, level / 20, *[0.0] * 3))
    return scores


def ablated(folder: Path, constants: int = 3) -> Ablation:
    given = DEFAULT_POLICY, CONSTANTS[:constants], COURSES
    return ablate(*given, kept=ResultCache(folder), workers=here(1), console=Console(quiet=True))


@pytest.fixture
def made_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation_module, "run_altered", fake_run)
    monkeypatch.setattr(ablation_module, "judge", fake_judge)
    monkeypatch.setattr(ablation_module, "start_of", fake_start)


@pytest.mark.usefixtures("made_up")
def test_table_has_a_row_for_each_alteration(tmp_path: Path) -> None:
    console = Console(record=True, width=200)
    ablation = ablated(tmp_path)
    trials = {(trial.constant.name, trial.what): trial for trial in ablation.trials}
    assert [trial.idle for trial in ablation.trials] == [True, True, False, False, False, True]
    assert ablation.unaltered[ALL]["objective_ratio_mean"] == pytest.approx(0.5)
    assert trials["BUSY", "x 2"].figures["pan"]["objective_ratio_mean"] == pytest.approx(0.7)
    stuck = trials["BUSY", "/ 2"].figures
    assert (stuck[ALL]["stuck_share"], stuck["pan"]["settle_frames"], stuck["step_up"]["settle_frames"]) == (
        0.5,
        None,
        3,
    )
    assert trials["BAD", "x 2"].error == "ZeroDivisionError: no frames"
    changed, _, unchanged = write_ablation(ablation, tmp_path).read_text().partition("\n## ")
    rows, idle = (
        {line.split(" | ")[0]: line for line in part.splitlines() if line.startswith("| ")}
        for part in (changed, unchanged)
    )
    for table in (rows, idle):
        assert all(line.replace("\\|", "").count("|") == table["| constant"].count("|") for line in table.values())
    assert "0.500 | 0.250 | 3 | 0.00 | 0.000 | 0.500 / 0.250 | 0.500 / 0.250" in rows["| unaltered"]
    assert "Frames \\| idle." in idle["| `made_up.IDLE`"] and "x 2, / 2" in idle["| `made_up.IDLE`"]
    assert "| `made_up.IDLE`" not in rows
    print_ablation(ablation, console)
    shown = console.export_text()
    assert "fails: ZeroDivisionError" in shown and "contrast.c" in shown
    json.dumps(ablation_document(ablation), allow_nan=False)


@pytest.mark.usefixtures("made_up")
def test_an_interrupted_ablation_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def counted(request: dict[str, Any]) -> list[Decisions] | str:
        asked.append(request["alteration"]["text"] if request["alteration"] else "")
        return fake_run(request)

    monkeypatch.setattr(ablation_module, "run_altered", counted)
    ablated(tmp_path, constants=1)
    whole = ablated(tmp_path)
    assert sorted(asked) == ["", "1.5", "10.0", "2.0", "2.5", "6.0", "8.0"]
    monkeypatch.setattr(ablation_module, "judge", lambda *_: pytest.fail("it was judged again"))
    assert ablated(tmp_path) == whole


@pytest.mark.usefixtures("made_up")
def test_a_policy_that_cannot_be_compared_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ablation_module, "run_altered", lambda request: [[{"level": 6}] for _ in request["courses"]])
    with pytest.raises(AutoexposeError, match="decides otherwise"):
        ablated(tmp_path)
    monkeypatch.setattr(ablation_module, "run_altered", lambda request: "ValueError: no")
    with pytest.raises(AutoexposeError, match="fails without any alteration: ValueError: no"):
        ablated(tmp_path / "other")


def test_quick_has_few_courses_and_all_are_for_tuning() -> None:
    whole, quick = (ablation_courses(list(SCENARIOS), quick) for quick in (False, True))
    assert [scenario for scenario, _, _ in whole] == list(SCENARIOS) and set(quick) < set(whole)
    assert ablation_courses(["pan"], False) == [course for course in whole if course[0] == "pan"]
    with pytest.raises(ConfigurationError, match="step_up"):
        ablation_courses(["tunnel"], True)
