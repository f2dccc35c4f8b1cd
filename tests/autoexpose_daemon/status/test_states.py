from __future__ import annotations

import pytest

from autoexpose_daemon.status.states import ADJUSTED, START_PATIENCE_NS, Expectation, Health, State, judge
from autoexpose_daemon.status.telemetry import GONE, CameraTally, Telemetry
from imaging.frames import Side

NOW_NS = 100_000_000_000
JUST_NS = NOW_NS - 100_000_000
LONG_AGO_NS = NOW_NS - 3_000_000_000
STEREO = Expectation(("left", "right"), 1 / 60, True, since_ns=0)


def telemetry(
    left: str = "A 1",
    right: str = "B 2",
    left_ns: int = JUST_NS,
    right_ns: int = JUST_NS,
    pair_ns: int | None = JUST_NS,
) -> Telemetry:
    frames: dict[Side, int] = {"left": left_ns, "right": right_ns}
    return Telemetry(cameras=CameraTally({"left": left, "right": right}, frames), last_pair_ns=pair_ns)


@pytest.mark.parametrize(
    ("seen", "health"),
    [
        (telemetry(), "exposing"),
        (telemetry(left_ns=LONG_AGO_NS, right_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS), "degraded: no triggers"),
        (telemetry(right=GONE, right_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS), "degraded: right camera gone"),
        (
            telemetry(right=GONE, left_ns=LONG_AGO_NS, right_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS),
            "degraded: right camera gone; no triggers",
        ),
        (
            telemetry(GONE, GONE, LONG_AGO_NS, LONG_AGO_NS, LONG_AGO_NS),
            "degraded: left camera gone; right camera gone",
        ),
        (telemetry(left_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS), "degraded: no frames from the left camera"),
        (telemetry(pair_ns=LONG_AGO_NS), "degraded: frames form no stereo pairs"),
    ],
)
def test_the_state_names_what_is_missing(seen: Telemetry, health: str) -> None:
    assert str(judge(seen, STEREO, NOW_NS)) == health


def test_a_trigger_has_stopped_for_both_even_if_the_last_frame_of_one_was_lost() -> None:
    left_ns, right_ns = NOW_NS - 1_010_000_000, NOW_NS - 990_000_000
    seen = telemetry(left_ns=left_ns, right_ns=right_ns, pair_ns=left_ns)
    assert str(judge(seen, STEREO, NOW_NS)) == "degraded: no triggers"


def test_a_calibration_that_does_not_fit_degrades() -> None:
    seen = telemetry()
    seen.cameras.misfits["left"] = "its response is of Mono8"
    assert str(judge(seen, STEREO, NOW_NS)) == (
        "degraded: calibration of the left camera does not fit: its response is of Mono8"
    )


def test_what_is_wrong_with_a_camera_stands_in_the_state() -> None:
    seen = telemetry(right=GONE, right_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS)
    seen.cameras.troubles = {
        ("left", "refused"): "1 us was refused",
        ("right", "gone"): "no camera with serial B answers",
    }
    assert str(judge(seen, STEREO, NOW_NS)) == (
        "degraded: right camera gone: no camera with serial B answers; left camera: 1 us was refused"
    )


def test_a_camera_whose_frames_are_all_incomplete_sends_frames() -> None:
    seen = telemetry(left_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS)
    seen.cameras.troubles = {("left", "incomplete"): "all its frames arrive incomplete"}
    assert str(judge(seen, STEREO, NOW_NS)) == "degraded: left camera: all its frames arrive incomplete"


def test_a_camera_that_rounds_is_as_good_as_another() -> None:
    seen = telemetry()
    seen.cameras.troubles = {("left", ADJUSTED): "25 us was asked for, the camera took 24 us"}
    assert judge(seen, STEREO, NOW_NS).state is State.EXPOSING


def test_a_rig_is_starting_until_its_first_pair_but_not_for_ever() -> None:
    seen = Telemetry(cameras=CameraTally({"left": "A 1", "right": GONE}))
    assert judge(seen, STEREO, START_PATIENCE_NS - 1) == Health(State.STARTING)
    assert judge(seen, STEREO, START_PATIENCE_NS).state is State.DEGRADED
    assert judge(telemetry(), STEREO, NOW_NS).state is State.EXPOSING


def test_slow_triggers_are_waited_for() -> None:
    slow = Expectation(("left", "right"), 10.0, True, since_ns=0)
    assert judge(telemetry(left_ns=LONG_AGO_NS, right_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS), slow, NOW_NS).state is (
        State.EXPOSING
    )


def test_a_camera_that_runs_freely_has_no_triggers_to_miss() -> None:
    free = Expectation(("left",), 1 / 60, False, since_ns=0)
    assert str(judge(telemetry(left_ns=LONG_AGO_NS, pair_ns=LONG_AGO_NS), free, NOW_NS)) == "degraded: no frames"
