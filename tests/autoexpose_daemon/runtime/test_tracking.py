"""Which reports of consumers on their tracking are believed, and why others are not."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.control.inputs import COLUMNS, ROWS, TrackedCells
from autoexpose_daemon.control.picture.steering import FORGOTTEN_S, MOST_CONSUMERS, CellExposure
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.runtime.inputs import APART_NS, MOST_WAITING, OLDEST_REPORT_S, Tracking
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, Side, StereoPair

SECOND = 1_000_000_000
SETTING = ExposureSetting(1000.0, 0.0)
PERIOD_NS = SECOND // 60
NOW_NS = 70 * SECOND
CELLS = np.full((ROWS, COLUMNS), 20, np.uint16)
WELL = CellExposure(np.ones((ROWS, COLUMNS), np.float32), np.ones((ROWS, COLUMNS), np.float32))


class Run:
    """Two seconds of frames, the newest now."""

    def __init__(self, sides: tuple[Side, ...] = ("left", "right")) -> None:
        self.now_ns = NOW_NS
        self.tracking = Tracking(sides, 60.0, now_ns=lambda: self.now_ns)
        for number in range(120, -1, -1):
            self.tracking.saw(NOW_NS - number * PERIOD_NS, dict.fromkeys(sides, WELL))

    def report(self, taken_ns: int = NOW_NS, consumer: str = "slam", side: Side = "left") -> str | None:
        """Why a report is refused."""
        before = dict(self.tracking.tally.refused)
        self.tracking.take(TrackedCells(consumer, 0, side, CELLS, CELLS), taken_ns)
        self.tracking(self.now_ns)
        refused = [name for name, count in self.tracking.tally.refused.items() if count != before[name]]
        return refused[0] if refused else None


def test_a_report_on_a_frame_that_control_has_seen_steers() -> None:
    run = Run()
    assert run.tracking(NOW_NS) is None
    assert run.report(NOW_NS - 30 * PERIOD_NS) is None
    steering = run.tracking(NOW_NS)
    assert steering is not None and (steering.by, steering.age_s) == (("slam",), 0.5)
    assert run.tracking.tally.reports == 1
    pair = StereoPair(0, {"left": Frame(np.zeros((1, 1), np.uint8), 8, 0, NOW_NS, NOW_NS, NOW_NS, SETTING)})
    loop: Any = SimpleNamespace(steered=True, cell_exposures={"left": WELL})
    run.tracking.decided(StepInputs(pair, steering=steering), loop)
    assert str(run.tracking.tally) == "by slam, age 0.5 s   reports: 1, refused: none"
    assert run.tracking(NOW_NS + round(FORGOTTEN_S * SECOND)) is None


@pytest.mark.parametrize(
    ("taken_ns", "why"),
    [
        (NOW_NS - APART_NS, None),
        (NOW_NS - APART_NS - 1, "unknown_frame"),
        (NOW_NS + APART_NS, None),
        (NOW_NS + APART_NS + 1, "future"),
        (NOW_NS + (1 << 62), "future"),
        (NOW_NS - 59 * PERIOD_NS, None),
        (NOW_NS - round(OLDEST_REPORT_S * SECOND) - 1, "stale"),
        (-(1 << 62), "stale"),
    ],
)
def test_a_stamp_must_be_that_of_a_frame_of_late(taken_ns: int, why: str | None) -> None:
    assert Run().report(taken_ns) == why


def test_a_report_before_any_frame_or_on_a_camera_that_was_missing_is_refused() -> None:
    tracking = Tracking(("left", "right"), 60.0, now_ns=lambda: NOW_NS)
    seen: tuple[dict[Side, CellExposure], ...] = ({}, {"right": WELL})
    for frames in seen:
        tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
        assert tracking(NOW_NS) is None
        tracking.saw(NOW_NS, frames)
    tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
    assert tracking(NOW_NS) is None
    assert (tracking.tally.refused["unknown_frame"], tracking.tally.refused["passed_over"]) == (1, 2)


def test_a_camera_that_the_rig_does_not_have_cannot_be_reported_on(caplog: pytest.LogCaptureFixture) -> None:
    run = Run(("left",))
    with caplog.at_level(logging.WARNING):
        assert [run.report(side="right") for _ in range(3)] == ["no_camera"] * 3
    assert caplog.messages == ["a report of consumer slam on its tracking is ignored: the rig has no right camera"]


def test_more_consumers_than_can_steer_are_refused_until_others_are_silent() -> None:
    run = Run()
    assert [run.report(consumer=f"c{number}") for number in range(MOST_CONSUMERS)] == [None] * MOST_CONSUMERS
    assert run.report(consumer="one more") == "too_many_consumers"
    assert run.report(consumer="c3") is None
    run.now_ns += round(FORGOTTEN_S * SECOND)
    run.tracking.saw(run.now_ns, {"left": WELL})
    assert run.report(run.now_ns, "one more") is None


def test_a_flood_between_two_frames_is_cut_and_counted() -> None:
    run = Run()
    for _ in range(MOST_WAITING + 100):
        run.tracking.take(TrackedCells("slam", 0, "left", CELLS, CELLS), NOW_NS)
    run.tracking(NOW_NS)
    assert (run.tracking.tally.reports, run.tracking.tally.refused["too_often"]) == (MOST_WAITING, 100)
