"""What the demo reports at its end, from made-up figures."""

from __future__ import annotations

import io
import re
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from autoexpose_daemon.demo.analysis import DemoRun, LightStep, StepLog, figures, in_words
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.status.panel import lost_in_words
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.triggers.outcomes import Tally

FIGURES: dict[str, Any] = {
    "transport": "gige",
    "rate_hz": 60.0,
    "seconds": 20.0,
    "fps": 59.3,
    "triggers": 1200,
    "pairs": 1186,
    "lost": {"startup": 13, "shutdown": 1},
    "fakes": {"overruns": 0, "cpu_percent": [12.4, 13.6]},
    "pixel_format": "Mono8",
    "width": 720,
    "height": 540,
    "counts": {"pairs": 1186, "decisions_at_darkest_limit": 3},
    "settings": [{"lux": 150.0, "exposure_time_us": 99.0, "gain_db": 26.1}],
    "pairing_ms": {"p50": 0.2, "p99": 1.1},
    "decision_ms": {"p50": 3.1, "p99": 7.4},
    "held_ms": {"p50": 0.1, "p99": 3.0},
    "write_ms": {"p50": 1.2, "p99": 3.0},
    "frame_to_node_ms": {"p50": None, "p99": None},
    "command_to_effect_ms": {"p50": None, "p99": None},
    "skew_ms": {"p50": None, "p99": None},
    "published": None,
    "daemon_cpu_percent": 31.2,
    "reference_step_ms": 3.256,
}
STEP = LightStep(4.0, 150.0, 1.0, 4, 4, "held")


def said(**changed: Any) -> dict[str, str]:
    """The rows by name."""
    screen = io.StringIO()
    Console(file=screen, width=200).print(in_words(FIGURES | changed, [STEP]))
    rows = (re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in screen.getvalue().splitlines())
    return {name: text.strip() for name, text in rows}


def test_every_figure_has_a_unit_and_a_meaning() -> None:
    assert said() == {
        "light at 4.0 s": "150 to 1 lux: well exposed and steady after 4 frames (67 ms)",
        "under 150 lux": "0.10 ms of exposure, 26.1 dB of gain (medians)",
        "seen": "1186 stereo pairs in 20.0 s, 59.3 per second, from two fake GigE Vision cameras, Mono8 720x540",
        "lost": "none; 13 before every camera was open, 1 at the end; of 1200 triggers on the cameras' wire",
        "pairing": "0.2 ms, 99 of 100 within 1.1 ms: From a pair in memory to the control step on it.",
        "decision": "3.1 ms, 99 of 100 within 7.4 ms: One control step.",
        "hold": "0.1 ms, 99 of 100 within 3.0 ms: From a decision to the start of the safe write window.",
        "write": "1.2 ms, 99 of 100 within 3.0 ms: Writing exposure time and gain to a camera.",
        "processor": "daemon 31 % of a core, fakes 12 % and 14 %",
        "this machine": "3.3 ms for a step of the published algorithm",
    }


def test_anomalies_are_listed_if_any() -> None:
    counts = {"mismatched_pairs": 2, "late_writes": 3, "pairs_without_decision": 1}
    rows = said(counts=counts, published=7)
    assert rows["anomalies"] == "pairs without a decision: 1, mismatched pairs: 2, late writes: 3"
    assert rows["published"] == "7 stereo pairs, for other processes"


@pytest.mark.parametrize(
    ("lost", "overruns", "words"),
    [
        ({"left_missing": 40}, 38, "40 without the left frame (38 of these frames because a fake camera was late)"),
        ({"left_missing": 40}, 0, "40 without the left frame"),
        ({"startup": 9}, 4, "none; 9 before every camera was open"),
        (
            {"both_missing": 2, "stale": 1, "startup": 9},
            99,
            "2 without either frame, 1 seen too late (4 of these frames because a fake camera was late); "
            "9 before every camera was open",
        ),
    ],
)
def test_losses_of_the_simulation_are_not_blamed_on_the_daemon(lost: dict[str, int], overruns: int, words: str) -> None:
    rows = said(lost=lost, fakes={"overruns": overruns, "cpu_percent": [1, 1]})
    assert rows["lost"] == f"{words}; of 1200 triggers on the cameras' wire"


def test_cameras_that_ran_for_several_daemons_take_their_share_of_all_that_time() -> None:
    daemon: Any = SimpleNamespace(tally=Tally(), telemetry=Telemetry())
    options = DemoOptions(60.0, "fixed", None, None, "room", None, 0, "gige", None, False, False, None, True)
    cameras: Any = [SimpleNamespace(overruns=0, cpu_s=30.0)] * 2
    run = DemoRun(options, 30.0, daemon, cameras, [], StepLog(1.0), 60.0, 120.0, 15.0, 3.0)
    result = figures(run, [])
    assert result["fakes"]["cpu_percent"] == [25.0, 25.0]
    assert result["daemon_cpu_percent"] == 25.0


def test_an_unknown_reason_keeps_its_name() -> None:
    assert lost_in_words({"moonlight": 3, "shutdown": 0}) == "3 moonlight"
