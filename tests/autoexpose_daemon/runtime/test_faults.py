"""The rows of docs/faults.md that show at the cameras, in virtual time: what is reported and counted, and recovery.

Each has its own rig. Nothing but what is named is counted, all is well again at the end, and every trigger of the
wire is accounted for. That these faults look like this on the wire is for tests/accept/test_faults.py.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from autoexpose_daemon.runtime.rig_health import FIRST_PAUSE_NS
from calibration.response.file import ResponseFile
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.virtual import VirtualRun
from tests.soak.clock import MS, SECOND
from tests.soak.faults import SURELY_JUDGED
from tests.soak.rig import CONFIG, RATE_HZ

FIRST_PAIR = {"pairs_without_decision": 1}
"""Of the first pair after a silence: one frame of it was decided on before its partner came."""


@pytest.fixture
def run() -> VirtualRun:
    return VirtualRun()


def test_camera_lost_and_back(run: VirtualRun) -> None:
    """It starts with the exposure that the other one has by then."""
    run.left.vanish()
    run.wait_for_state("degraded: left camera gone: camera left does not answer any more; trying again")
    alone = len(run.pairs)
    run.let_pass(120)
    assert len(run.pairs) >= alone + 100
    assert {pair.reference_side for pair in run.pairs[alone:]} == {"right"}
    run.ask(1000)
    run.left.present = True
    counted = run.counted()
    taken = {pair.frames["left"].setting.exposure_time_us for pair in run.pairs[alone:] if len(pair.frames) == 2}
    assert taken == {1000}
    assert counted.pop("camera_gone") > 120
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes"}  # while the dead camera was asked a last time


def test_both_cameras_gone_and_back_is_counted_by_the_clock(run: VirtualRun) -> None:
    for device in (run.left, run.right):
        device.vanish()
    run.let_pass(300)
    for device in (run.left, run.right):
        device.present = True
    counted = run.counted()
    assert counted.pop("camera_gone") > 300
    assert counted == {"reconnects": 2}


def test_a_camera_that_stays_away_is_named_and_the_other_one_continues(run: VirtualRun) -> None:
    run.left.vanish()
    run.wait_for_state("degraded: left camera gone: no camera left; trying again")
    alone = len(run.pairs)
    run.let_pass(60 * RATE_HZ)
    assert len(run.pairs) > alone + 59 * RATE_HZ
    assert run.telemetry.counts.reconnects == 0


def test_a_camera_that_is_not_counted_is_named_until_it_is(run: VirtualRun) -> None:
    loop = run.rig.control.active.loop
    loop.uncounted = {"right": "shows nothing, not counted"}  # type: ignore[union-attr, misc, assignment]
    run.wait_for_state("degraded: right camera: shows nothing, not counted")
    loop.uncounted = {}  # type: ignore[union-attr, misc, assignment]
    assert run.counted() == {}


def test_the_status_says_at_which_frequency_the_light_flickers(run: VirtualRun) -> None:
    for flicker_hz in (100.0, None):
        run.rig.control.active.loop.flicker_hz = flicker_hz  # type: ignore[union-attr, misc]
        run.let_pass(10)
        assert run.telemetry.flicker_hz == flicker_hz
    assert run.counted() == {}


def test_trigger_stopped(run: VirtualRun) -> None:
    """Absent triggers do not count."""
    run.wire.stop_periods = 110
    run.wait_for_state("degraded: no triggers")
    assert run.counted() == FIRST_PAIR


def test_a_short_pause_of_the_trigger_looks_like_ignored_triggers(run: VirtualRun) -> None:
    run.wire.stop_periods = 20
    run.let_pass(30)
    assert run.counted() == {"trigger_ignored": 19, **FIRST_PAIR}
    assert run.said == []


def test_trigger_doubled(run: VirtualRun) -> None:
    run.wire.doubled = 70
    for side in ("left", "right"):
        run.wait_for_state(f"{side} camera: starts 120.0 frames a second where trigger.rate_hz is 60: check")
    assert run.counted() == {"surplus_frames": 140}


def test_trigger_halved(run: VirtualRun) -> None:
    run.wire.halved = SURELY_JUDGED
    run.wait_for_state("right camera: starts 30.0 frames a second", "exposure and readout fit into one period")
    assert run.counted() == {"trigger_ignored": SURELY_JUDGED}


def test_a_trigger_at_another_rate_is_reported_at_the_start(caplog: pytest.LogCaptureFixture) -> None:
    run = VirtualRun(trigger={**CONFIG.trigger.model_dump(exclude_unset=True), "rate_hz": 50})
    run.let_pass(60)
    assert "left camera: starts 60.0 frames a second where trigger.rate_hz is 50" in caplog.text


def test_frames_lost(run: VirtualRun) -> None:
    run.left.lose, run.right.ignore = 3, 2
    run.let_pass(10)
    run.right.lose = 1
    run.let_pass(10)
    assert run.counted() == {"left_missing": 1, "trigger_ignored": 2, "right_missing": 1}


def test_frames_of_both_lost(run: VirtualRun) -> None:
    run.left.lose = run.right.lose = 3
    run.let_pass(10)
    assert run.counted() == {"both_missing": 3}


def test_frames_late(run: VirtualRun) -> None:
    """They make pairs if their partners have not been used alone."""
    run.left.delay_ns = 100 * MS
    run.let_pass(20)
    assert run.counted().keys() <= {"pairs_without_decision"}


def test_frame_truncated(run: VirtualRun) -> None:
    run.left.truncate = 40
    run.wait_for_state(
        "degraded: left camera: all its frames arrive incomplete: "
        "check its cable, and network or USB for what they can carry"
    )
    assert run.counted() == {"incomplete": 40}


def test_a_camera_whose_frames_all_have_holes_is_not_reopened(run: VirtualRun) -> None:
    run.left.truncate = 400  # longer than silence may last
    run.wait_for_state(
        "degraded: left camera: all its frames arrive incomplete: "
        "check its cable, and network or USB for what they can carry"
    )
    assert run.counted() == {"incomplete": 400}


def test_transfer_stalled(run: VirtualRun) -> None:
    began_ns = run.rig.clock.now_ns
    run.left.halted = True
    run.wait_for_state("degraded: no frames from the left camera")
    run.wait_for_state(
        "left camera gone: camera left sends no frames while the other one does; it is reopened; trying again"
    )
    assert run.rig.clock.now_ns - began_ns > FIRST_PAUSE_NS
    counted = run.counted()
    assert counted.pop("camera_gone") > FIRST_PAUSE_NS / SECOND * RATE_HZ
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes", *FIRST_PAIR}


def test_chunk_missing(run: VirtualRun) -> None:
    """As over GigE Vision, or with chunks that are not numbers; over USB3 Vision it looks like truncation."""
    run.left.untell = 40
    run.wait_for_state(
        "degraded: left camera: its frames no longer say how they were taken: "
        "their exposure is inferred from when it was written"
    )
    assert run.counted() == {"frames_without_exposure_metadata": 40}


@pytest.mark.parametrize(
    "why", ["could not set ExposureTime to 1000", "node ExposureTime was set to 1000 us and reads back 2000 us"]
)
def test_node_refuses_or_sticks(run: VirtualRun, why: str) -> None:
    run.left.refuses = why
    run.ask(1000)
    run.wait_for_state(f"degraded: left camera: 1000 us, 0.0 dB was refused: camera left: {why}")
    run.left.refuses = ""
    run.wait_for_taken(1000)
    counted = run.counted()
    assert counted.pop("refused_writes") >= 1
    assert counted.keys() <= {"late_writes", "mismatched_pairs"}


def test_node_clips(run: VirtualRun, caplog: pytest.LogCaptureFixture) -> None:
    run.left.clips_us = 3800
    run.ask(4000)
    run.let_pass(60)
    assert "left camera: 4000 us, 0.0 dB was asked for, the camera took 3800 us, 0.0 dB" in caplog.text
    run.ask(2000)
    run.wait_for_taken(2000)
    counted = run.counted()
    assert counted.pop("mismatched_pairs") > 50
    assert counted == {"adjusted_writes": 1}


def test_exposure_frozen(run: VirtualRun) -> None:
    run.left.frozen = True
    run.ask(500)
    run.wait_for_state(
        "degraded: left camera: its frames do not follow what is written: its nodes hold 500 us, 0.0 dB, "
        "frames are taken with 2000 us, 0.0 dB; switch the camera off and on"
    )
    run.left.frozen = False
    run.ask(600)
    run.wait_for_taken(600)
    counted = run.counted()
    assert counted.pop("frames_off_setting") >= 20
    assert counted.pop("unexplained_mismatches") >= 20
    assert counted.keys() == {"mismatched_pairs"}


@pytest.mark.parametrize("jump_s", [10, -10])
def test_clock_jumps(run: VirtualRun, caplog: pytest.LogCaptureFixture, jump_s: int) -> None:
    run.left.clock_offset_ns += jump_s * SECOND
    run.let_pass(90)
    assert f"left camera: its clock jumped by {jump_s:+.1f} s; its frames keep their place" in caplog.text
    assert run.counted() == {"clock_jumps": 1}


def test_response_file_edited_while_running(run: VirtualRun, tmp_path: Path) -> None:
    file = tmp_path / "left.response.yaml"
    ResponseFile(ResponseFunction.linear()).save(file)
    cameras = {"left": {"serial": "left", "response": file}, "right": {"serial": "right"}}
    run.ask(2000, cameras=cameras)
    file.write_text("log2_exposure: [0, 1,")
    with pytest.raises(ConfigurationError, match=f"{re.escape(str(file))}: not a YAML file"):
        run.ask(2000, cameras=cameras)
    file.unlink()
    with pytest.raises(ConfigurationError, match=f"{re.escape(str(file))}: cannot be read"):
        run.ask(2000, cameras=cameras)
    run.left.vanish()
    run.left.present = True
    run.wait_until(lambda: run.telemetry.counts.reconnects == 1, "the camera back")
    counted = run.counted()
    assert counted.pop("camera_gone") > 0
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes", *FIRST_PAIR}


@pytest.mark.parametrize("forgotten", [False, True], ids=["usb3", "gige"])
def test_a_pause_of_5_s_heals(run: VirtualRun, forgotten: bool) -> None:
    """GigE Vision cameras drop their controller after 3 s; USB3 Vision cameras continue."""
    run.rig.stop_process(5 * SECOND)
    run.let_pass(3 * RATE_HZ)
    for device in (run.left, run.right) if forgotten else ():
        device.vanish()
        device.present = True
    run.let_pass(2 * RATE_HZ)
    run.wait_until(lambda: run.telemetry.counts.reconnects == 2 * forgotten, "the cameras")
    counted = run.counted()
    if forgotten:
        assert counted.pop("camera_gone") > 3 * RATE_HZ
        assert counted.pop("reconnects") == 2
    else:
        assert counted.pop("both_missing") > 4 * RATE_HZ
    assert counted.keys() <= {"both_missing", "late_writes", "stale", "pairs_without_decision"}
