"""The demo's figures, from made-up runs with known answers, and how it reports them."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from autoexpose_daemon.demo.analysis import (
    DemoRun,
    LightSetting,
    LightStep,
    StepLog,
    StepRecord,
    delay_frames,
    figures,
    frames_to_settle,
    frames_to_steady,
    in_words,
    light_settings,
    light_steps,
    lost_pulses,
    pulses_in_window,
)
from autoexpose_daemon.demo.fakes import Pulse
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.demo.plot import draw, headline, mark_losses
from autoexpose_daemon.demo.show import configuration
from autoexpose_daemon.status.panel import lost_in_words
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.triggers.outcomes import Tally
from imaging.exposure import ExposureSetting
from imaging.python310 import exp2

PERIOD_NS = 16_666_667


def record(trigger: int, level: float, clipped: float = 0.0) -> StepRecord:
    setting = ExposureSetting(exp2(level), 0.0)
    return StepRecord(trigger, trigger * PERIOD_NS, setting, level, clipped, 0.0, "held")


def records(
    levels: Iterable[float], clipped: Callable[[int], float] = lambda n: 0.0, every: int = 1
) -> list[StepRecord]:
    return [record(every * n, level, clipped(n)) for n, level in enumerate(levels)]


@pytest.mark.parametrize(
    ("seen", "settled", "steady"),
    [
        (records([10.0, 11.0, 11.5, *[12.0] * 40]), 3, 3),
        (records([*[12.0] * 9, 12.5, *[12.0] * 30]), 10, 10),  # one bad frame in ten
        (records([11.0] * 5 + [12.0] * 25, every=2), None, None),  # every second frame is lost
        ([each for each in records([11.0] * 5 + [12.0] * 55) if each.trigger != 3], 5, 5),
        (records(11.0 + n % 2 for n in range(80)), None, None),
        (records([12.0] * 80, lambda n: 0.6), None, None),
        (records([12.0] * 80, lambda n: 0.6 if n < 7 else 0.1), 7, 7),
        # follows a moving view: at 12.65, 0.25 below 12.895, the median of the last 20
        (records([10.0, 11.0, 11.5, *(12.0 + 0.01 * n for n in range(100))]), 68, 3),
    ],
    ids=["settles", "a bad frame", "losses", "one loss", "oscillates", "white", "no longer white", "moving view"],
)
def test_settled_and_steady_is_the_first_of_ten_good_frames(
    seen: list[StepRecord], settled: int | None, steady: int | None
) -> None:
    assert (frames_to_settle(seen), frames_to_steady(seen)) == (settled, steady)


def seen(count: int, lux: Callable[[int], float]) -> list[Pulse]:
    return [Pulse(n, n * PERIOD_NS, lux(n)) for n in range(count)]


def test_steps_are_found_in_the_light_and_judged_until_the_next() -> None:
    pulses = seen(200, lambda n: 150.0 if (n // 60) % 2 == 0 else 1.0)
    target = [6.0 if (n // 60) % 2 == 0 else 13.0 for n in range(200)]
    records = [record(n, target[max(n - 5, 0)]) for n in range(200)]
    steps = light_steps(pulses, records)
    assert [(step.from_lux, step.to_lux, step.frames_to_settle) for step in steps] == [(150, 1, 5), (1, 150, 5)]
    assert steps[0].time_s == round(60 * PERIOD_NS * 1e-9, 3)


def test_frames_that_control_skipped_right_after_a_step_count() -> None:
    pulses = seen(160, lambda n: 150.0 if n < 60 else 1.0)
    records = [record(n, 6.0 if n < 68 else 13.0) for n in range(160) if not 60 <= n < 65]
    (step,) = light_steps(pulses, records)
    assert (step.frames_to_steady, step.frames_to_settle) == (8, 8)


def test_a_step_that_does_not_settle_quotes_the_policy() -> None:
    pulses = seen(160, lambda n: 150.0 if n < 60 else 1.0)
    (step,) = light_steps(pulses, [record(n, 11.0 + n % 2) for n in range(160)])
    assert step.frames_to_settle is None
    assert step.in_words(60.0) == "not steady before the next step (mostly: held)"


@pytest.mark.parametrize(
    ("steady", "settled", "words"),
    [
        (4, 4, "well exposed and steady after 4 frames (67 ms)"),
        (4, 157, "well exposed and steady after 4 frames (67 ms)"),
        (4, None, "well exposed and steady after 4 frames (67 ms)"),
        (1, 1, "well exposed and steady after 1 frame (17 ms)"),
        (None, 9, "well exposed and steady after 9 frames (150 ms)"),
    ],
)
def test_a_step_is_described_in_words(steady: int | None, settled: int | None, words: str) -> None:
    assert LightStep(3.8, 1.0, 150.0, steady, settled, "held").in_words(60.0) == words


def test_the_settings_under_each_light_are_medians_of_the_frames_taken_under_it() -> None:
    pulses = seen(240, lambda n: 150.0 if (n // 60) % 2 == 0 else 1.0)
    dark, bright = ExposureSetting(7500.0, 30.0), ExposureSetting(100.0, 6.0)
    records = [replace(record(n, 0.0), applied=bright if (n // 60) % 2 == 0 else dark) for n in range(240)]
    records[60:65] = [replace(late, applied=bright) for late in records[60:65]]
    # a clock that is a few us off does not move frames to other pulses
    off = [replace(each, host_time_ns=each.host_time_ns + (-1) ** each.trigger * 5000) for each in records]
    assert light_settings(pulses, off) == [LightSetting(150.0, 100.0, 6.0), LightSetting(1.0, 7500.0, 30.0)]


def test_a_ramp_of_light_is_no_step_and_has_no_settings() -> None:
    assert light_steps(seen(200, lambda n: 10.0 * exp2(n / 60)), records([10.0] * 200)) == []
    late_ramp = seen(120, lambda n: 150.0 if n < 60 else 150.0 - n)
    assert [it.lux for it in light_settings(late_ramp, records([10.0] * 120))] == [150.0]
    assert light_settings([], [record(0, 10.0)]) == []


def test_only_pulses_in_the_window_count() -> None:
    pulses = [Pulse(n, n * 100, 1.0) for n in range(10)]
    assert len(pulses_in_window(pulses, Tally(window_start_ns=250, window_end_ns=650))) == 4
    assert pulses_in_window(pulses, Tally()) == []


def test_pulses_without_a_pair_between_the_first_and_the_last_are_lost() -> None:
    pulses = [Pulse(n, n * PERIOD_NS, 1.0) for n in range(10)]
    pairs_ns = [n * PERIOD_NS + (-1) ** n * 3000 for n in (2, 3, 5, 8)]
    assert lost_pulses(pulses, pairs_ns) == [n * PERIOD_NS for n in (4, 6, 7)]
    assert lost_pulses(pulses, []) == []
    assert lost_pulses(pulses[:1], pairs_ns) == []


@pytest.mark.parametrize(("pulses", "steps"), [(0, 0), (1, 0), (400, 6), (400, 50)])
def test_a_picture_of_any_run_can_be_drawn(tmp_path: Path, pulses: int, steps: int) -> None:
    step_log = StepLog(1.0)
    step_log.steps = [record(n, 10.0) for n in range(5, pulses)]
    step_log.pairs_ns = [step.host_time_ns for step in step_log.steps if step.trigger % 7]
    step_log.pictures = [(step.host_time_ns, np.zeros((3, 4), np.uint8)) for step in step_log.steps[:3]]
    seen = [Pulse(n, n * PERIOD_NS, 150.0 if n % 60 < 30 else 0.0) for n in range(pulses)]
    run = SimpleNamespace(
        options=SimpleNamespace(policy="fixed", scene="room"),
        rate_hz=60.0,
        pulses=seen,
        step_log=step_log,
        cameras=[SimpleNamespace(overruns=steps)],
    )
    frames = itertools.cycle([1, 4, None])
    draw(
        tmp_path / "run.txt",
        run,  # type: ignore[arg-type]
        [LightStep(0.1 * n, 1.0, 150.0, next(frames), None, "held") for n in range(steps)],
    )
    assert (tmp_path / "run.txt").read_bytes().startswith(b"\x89PNG")


def test_the_picture_names_changes_never_followed_and_no_more_late_frames_than_are_missing() -> None:
    steps = [LightStep(4.0, 150.0, 1.0, None, None, "held"), LightStep(8.0, 1.0, 150.0, 3, 3, "held")]
    assert headline(steps[1:]).endswith("again after 3 frames")
    assert headline(steps).endswith("again after 3 frames, but not after 1 of 2 changes")
    axes = Figure().subplots()
    mark_losses(axes, np.array([1.0, 2.0]), 90)
    assert axes.get_title("right") == "| 2 stereo pairs lost (4 frames by late fake cameras)"


def test_the_delay_is_read_off_large_changes() -> None:
    levels = [10.0 if n < 23 else 13.0 for n in range(60)]
    records = [replace(record(n, levels[n]), decided_level=10.0 if n < 20 else 13.0) for n in range(60)]
    assert delay_frames(records) == 3
    assert delay_frames(records[30:]) is None


FIGURES: dict[str, Any] = {
    "transport": "gige",
    "rate_hz": 60.0,
    "seconds": 20.0,
    "fps": 59.3,
    "triggers": 1200,
    "pairs": 1186,
    "lost": {"startup": 13, "shutdown": 1},
    "cameras": {"left": {"frames": 1186, "lost": 14}, "right": {"frames": 1186, "lost": 14}},
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
    "frame_to_node_ms": {"p50": 4.6, "p99": 12.3},
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
    counts = {"mismatched_pairs": 2, "late_writes": 3, "pairs_without_decision": 1}
    rows = said(counts=counts, published=7)
    for name, text in {
        "light at 4.0 s": "150 to 1 lux: well exposed and steady after 4 frames (67 ms)",
        "under 150 lux": "0.10 ms of exposure, 26.1 dB of gain",
        "seen": "1186 stereo pairs in 20.0 s, 59.3 per second",
        "lost": "none; 13 before every camera was open, 1 at the end; of 1200 triggers",
        "delay": "4.6 ms from a frame to new settings in the cameras (99 of 100 within 12.3 ms)",
        "processor": "daemon 31 % of a core, fakes 12 % and 14 %",
        "anomalies": "pairs without a decision: 1, mismatched pairs: 2, late writes: 3",
        "published": "7 stereo pairs",
    }.items():
        assert rows[name].startswith(text)
    assert said(cameras=dict.fromkeys(["a", "b", "c"]))["seen"] == (
        "1186 sets of frames in 20.0 s, 59.3 per second, from 3 fake GigE Vision cameras, Mono8 720x540"
    )
    assert "every 16.7 ms" in rows["delay"]
    assert "faults.md" in rows["anomalies"]
    assert "busy" in said(counts=counts, fakes=FIGURES["fakes"] | {"overruns": 1})["anomalies"]
    assert "faults.md" in said(counts={"late_writes": 12})["anomalies"]
    assert "normal" in said(counts={"late_writes": 11, "pairs_without_decision": 11})["anomalies"]
    assert not {"effect", "decision", "skew", "this machine"} & set(rows)
    assert not {"anomalies", "published"} & set(said())


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
    options = DemoOptions(60.0, "fixed", None, None, "room", None, 0, "gige", None, False, False, None, True)
    daemon: Any = SimpleNamespace(tally=Tally(), telemetry=Telemetry(), config=configuration(options, 60.0))
    cameras: Any = [SimpleNamespace(overruns=0, cpu_s=30.0)] * 2
    run = DemoRun(options, 30.0, daemon, cameras, [], StepLog(1.0), 60.0, 120.0, 15.0, 3.0)
    result = figures(run, [])
    assert result["fakes"]["cpu_percent"] == [25.0, 25.0]
    assert result["daemon_cpu_percent"] == 25.0


def test_an_unknown_reason_keeps_its_name() -> None:
    assert lost_in_words({"moonlight": 3, "shutdown": 0}) == "3 moonlight"
