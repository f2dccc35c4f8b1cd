"""What the state says of cameras, triggers and publishing, and which consumers and lines are shown."""

from __future__ import annotations

import io
import itertools
import logging
import time
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import display, line_of, table_of
from autoexpose_daemon.status.states import ADJUSTED, START_PATIENCE_NS, Expectation, Health, State, judge
from autoexpose_daemon.status.telemetry import (
    GONE,
    GONE_NS,
    MOST_KNOWN,
    MOST_LISTED,
    CameraTally,
    Consumers,
    DropReason,
    PublishTally,
    Telemetry,
)
from imaging.frames import CameraName
from imaging.geometry import SIDES
from tests.autoexpose_daemon.samples import EXPOSING

NOW_NS = 100_000_000_000
JUST_NS = NOW_NS - 100_000_000
LONG_AGO_NS = NOW_NS - 3_000_000_000
STEREO = Expectation(("left", "right"), 1 / 60, True, since_ns=0)


def telemetry(left: str = "A 1", right: str = "B 2", silent: str = "") -> Telemetry:
    """Cameras by name; of those in `silent`, and of pairs if it has them, the last came long ago."""
    last_ns = {what: LONG_AGO_NS if what in silent else JUST_NS for what in ("left", "right", "pairs")}
    frames: dict[CameraName, int] = {camera: last_ns[camera] for camera in SIDES}
    return Telemetry(cameras=CameraTally({"left": left, "right": right}, frames), last_pair_ns=last_ns["pairs"])


@pytest.mark.parametrize(
    ("seen", "health"),
    [
        (telemetry(), "exposing"),
        (telemetry(silent="left right pairs"), "degraded: no triggers"),
        (telemetry(right=GONE, silent="right pairs"), "degraded: right camera gone"),
        (telemetry(right=GONE, silent="left right pairs"), "degraded: right camera gone; no triggers"),
        (telemetry(GONE, GONE, "left right pairs"), "degraded: left camera gone; right camera gone"),
        (telemetry(silent="left pairs"), "degraded: no frames from the left camera"),
        (telemetry(silent="pairs"), "degraded: frames form no stereo pairs"),
    ],
)
def test_the_state_names_what_is_missing(seen: Telemetry, health: str) -> None:
    assert str(judge(seen, STEREO, NOW_NS)) == health


def test_a_trigger_has_stopped_for_both_even_if_the_last_frame_of_one_was_lost() -> None:
    seen = telemetry(silent="pairs")
    seen.cameras.last_frame_ns = {"left": NOW_NS - 1_010_000_000, "right": NOW_NS - 990_000_000}
    assert str(judge(seen, STEREO, NOW_NS)) == "degraded: no triggers"


@pytest.mark.parametrize(
    ("seen", "troubles", "health"),
    [
        (telemetry(), {("left", ADJUSTED): "25 us was asked for, the camera took 24 us"}, "exposing"),
        (
            telemetry(silent="left pairs"),
            {("left", "incomplete"): "all its frames arrive incomplete"},
            "degraded: left camera: all its frames arrive incomplete",
        ),
        (
            telemetry(right=GONE, silent="right pairs"),
            {("left", "refused"): "1 us was refused", ("right", "gone"): "no camera with serial B answers"},
            "degraded: right camera gone: no camera with serial B answers; left camera: 1 us was refused",
        ),
    ],
)
def test_what_is_wrong_with_a_camera_stands_in_the_state(
    seen: Telemetry, troubles: dict[Any, str], health: str
) -> None:
    seen.cameras.troubles = troubles
    assert str(judge(seen, STEREO, NOW_NS)) == health


def test_a_calibration_that_does_not_fit_degrades() -> None:
    seen = telemetry()
    seen.cameras.misfits["left"] = "its response is of Mono8"
    health = judge(seen, STEREO, NOW_NS)
    assert health.state is State.DEGRADED and "left camera does not fit: its response is of Mono8" in str(health)


@pytest.mark.parametrize(
    ("expected", "health"),
    [
        (Expectation(("left", "right"), 10.0, True, since_ns=0), "exposing"),  # slow triggers are waited for
        (Expectation(("left",), 1 / 60, False, since_ns=0), "degraded: no frames"),  # runs freely
    ],
)
def test_a_silence_is_judged_by_what_is_expected(expected: Expectation, health: str) -> None:
    seen = telemetry(silent="left right pairs")
    assert str(judge(seen, expected, NOW_NS)) == health


def test_a_rig_is_starting_until_its_first_pair_but_not_for_ever() -> None:
    seen = Telemetry(cameras=CameraTally({"left": "A 1", "right": GONE}))
    assert judge(seen, STEREO, START_PATIENCE_NS - 1) == Health(State.STARTING)
    assert judge(seen, STEREO, START_PATIENCE_NS).state is State.DEGRADED
    assert judge(telemetry(), STEREO, NOW_NS).state is State.EXPOSING


CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}}})


def degraded() -> Status:
    return describe(Telemetry(cameras=CameraTally({"left": "Camera L"}), opened_ns=0, last_pair_ns=0), CONFIG)


def test_without_a_terminal_the_log_gets_a_line_ever_more_seldom(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    now_s = 0
    monkeypatch.setattr("autoexpose_daemon.status.panel.time.monotonic", lambda: now_s)
    said_s: list[int] = []
    with display(Console(file=io.StringIO()), str) as show:
        for now_s in range(12 * 3600):
            show(degraded)
            if len(caplog.records) > len(said_s):
                said_s.append(now_s)
    assert said_s[:3] == [5, 15, 35]
    assert [later - earlier for earlier, later in itertools.pairwise(said_s)][-3:] == [3600, 3600, 3600]


def test_a_terminal_shows_which_flicker_was_found() -> None:
    for flicker_hz, shown in ((120.0, True), (None, False)):
        screen = io.StringIO()
        Console(file=screen, width=100).print(table_of(replace(EXPOSING, flicker_hz=flicker_hz)))
        assert ("120 Hz" in screen.getvalue()) == shown


def test_a_terminal_shows_the_state() -> None:
    screen = io.StringIO()
    with display(Console(file=screen, force_terminal=True, width=100), lambda: "autoexpose") as show:
        show(degraded)
    assert "degraded: no triggers" in screen.getvalue()


def test_a_consumer_that_falls_silent_is_forgotten() -> None:
    consumers = Consumers()
    consumers.heard("slam", ConsumerTally(pairs=5), 0)
    assert dict(consumers.listed(GONE_NS - 1)) == {"slam": ConsumerTally(pairs=5)}
    assert not consumers.listed(GONE_NS)


def test_those_that_take_pairs_are_listed_before_names_that_somebody_made_up() -> None:
    consumers = Consumers()
    for number in range(MOST_LISTED):
        consumers.heard(f"invented{number}", ConsumerTally(pairs=7), number)
    for pairs in range(2):
        consumers.heard("slam", ConsumerTally(pairs=pairs), 100)
    listed = list(consumers.listed(100))
    assert listed == ["slam", *(f"invented{number}" for number in range(MOST_LISTED - 1))]
    assert consumers.unlisted(100) == 1


def test_made_up_names_are_not_remembered_without_bound_and_drive_nobody_out() -> None:
    consumers = Consumers()
    for pairs in range(2):
        consumers.heard("slam", ConsumerTally(pairs=pairs), 0)
    for number in range(3 * MOST_KNOWN):
        consumers.heard(f"invented{number}", ConsumerTally(), 1)
    assert "slam" in consumers.listed(1)
    assert consumers.unlisted(1) == MOST_KNOWN - MOST_LISTED
    for pairs in range(2):
        consumers.heard("late", ConsumerTally(pairs=pairs), 2)
    assert list(consumers.listed(2))[:2] == ["slam", "late"]
    assert not consumers.unlisted(GONE_NS + 2)


def test_a_consumer_is_announced_when_it_takes_its_first_pairs_and_not_among_a_crowd() -> None:
    consumers = Consumers()
    announced = [consumers.heard("slam", ConsumerTally(pairs=pairs), 0) for pairs in (0, 0, 3, 6)]
    assert announced == [False, False, True, False]
    for number in range(MOST_LISTED):
        consumers.heard(f"invented{number}", ConsumerTally(), 0)
    assert not consumers.heard("invented0", ConsumerTally(pairs=1), 0)


def test_the_operator_reads_it_all_in_one_line() -> None:
    tally = PublishTally(sent=100, trouble="no such endpoint")
    tally.dropped[DropReason.BEHIND] = 2
    tally.consumers.heard("slam", ConsumerTally(pairs=90, missed=3, lost=2, too_slow=1), time.monotonic_ns())
    for number in range(MOST_LISTED):
        tally.consumers.heard(f"c{number}", ConsumerTally(), time.monotonic_ns())
    line = line_of(describe(Telemetry(publishing=tally), CONFIG))
    assert "published 100, dropped: 2 behind" in line
    assert "not published no such endpoint" in line
    assert "consumer slam 90 pairs, 3 missed, 2 lost, 1 too slow" in line
    assert "consumers 1 more, not listed" in line


def test_frames_that_cannot_be_published_degrade_the_daemon() -> None:
    seen = telemetry()
    seen.publishing = PublishTally()
    assert judge(seen, STEREO, NOW_NS).state is State.EXPOSING
    seen.publishing.trouble = "no such endpoint"
    assert str(judge(seen, STEREO, NOW_NS)) == "degraded: frames are not published: no such endpoint"
