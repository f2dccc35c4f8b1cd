"""The daemon on two fake cameras through stock Aravis; at the end the account of triggers is compared with the wire."""

from __future__ import annotations

import contextlib
import random

import numpy as np
import pytest

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.messages.frames import realtime_offset_ns
from drivers.aravis import open_nodes
from drivers.genicam.features import differing
from drivers.rig import supervision
from drivers.setup import parse_features
from fake_camera.device.faults import Fault
from imaging.exposure import ExposureSetting
from tests.autoexpose_daemon.publish.steps import endpoint
from tests.autoexpose_daemon.stereo import Run, running_daemon, stereo_cameras
from tests.fakes import ptp_master

pytestmark = pytest.mark.realtime

CONTROL = {"policy": "neves2009"}


def median_skew_periods(run: Run, rate_hz: float) -> float:
    """How far apart the frames of a pair started, by the cameras' clocks."""
    starts_ns = [[frame.host_time_ns for frame in pair.frames.values()] for pair, _ in run.seen]
    skews_ns = [abs(left - right) for left, right in (pair for pair in starts_ns if len(pair) == 2)]
    return float(np.median(skews_ns)) * 1e-9 * rate_hz


def test_pairs_arrive_are_decided_on_and_written() -> None:
    with stereo_cameras("--still") as cameras, running_daemon(cameras, {"control": CONTROL}) as run:
        run.wait_for_pairs(60)

        def applied() -> int:
            decided = {round(decision.setting.level, 3) for _, decision in run.seen}
            return len(decided & {round(pair.reference.setting.level, 3) for pair, _ in run.seen})

        run.wait_until(lambda: applied() > 1, "decisions that frames show")
        assert median_skew_periods(run, 60) < 0.1


@pytest.mark.gige_only  # over USB3 the contract of cameras shows it for one
def test_the_daemon_triggers_both_cameras_by_software() -> None:
    """At a rate that a busy machine holds. What it does not trigger in time is accounted for."""
    trigger = {"mode": "software", "rate_hz": 20}
    with (
        stereo_cameras("--still") as cameras,
        running_daemon(cameras, {"control": CONTROL, "trigger": trigger}) as run,
    ):
        run.wait_for_pairs(40)
        assert median_skew_periods(run, 20) < 0.1
        assert run.daemon.telemetry.skew_ms.count > 0
    tally = run.daemon.tally
    assert tally.window_start_ns is not None and tally.window_end_ns is not None
    periods = (tally.window_end_ns - tally.window_start_ns) * 20e-9  # not whole: it ends at any time
    assert abs(tally.triggers - periods) <= 1


@pytest.mark.long
@pytest.mark.gige_only
def test_cameras_with_one_ptp_clock_expose_together_and_go_on_without_their_master(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(supervision, "_CLOCK_PERIOD_NS", 200_000_000)  # readings of the clocks five times as often
    port = random.SystemRandom().randrange(20_000, 30_000, 2)
    trigger = {"mode": "ptp", "rate_hz": 20}
    with (
        contextlib.ExitStack() as master,
        stereo_cameras("--still", "--ptp", str(port)) as cameras,
    ):
        master.enter_context(ptp_master(port))
        with running_daemon(cameras, {"control": CONTROL, "trigger": trigger}) as run:
            telemetry = run.daemon.telemetry
            run.wait_for_pairs(10)
            assert {state.status for state in telemetry.cameras.ptp.values()} <= {"Slave", "Uncalibrated"}
            assert float(np.median(telemetry.skew_ms.latest_ms)) < 1.0
            master.close()
            run.wait_until(lambda: ("left", "clock") in telemetry.cameras.troubles, "a word on the master's end")
            assert "no longer synchronised" in telemetry.cameras.troubles["left", "clock"]
            run.wait_for_pairs(5)
            assert median_skew_periods(run, 20) < 0.1


@pytest.mark.long
@pytest.mark.gige_only
def test_ptp_time_is_stamp_phase_and_what_a_report_on_a_frame_is_known_by() -> None:
    """The master gives the time of this machine, as a computer's own does: UTC."""
    port, at = random.SystemRandom().randrange(20_000, 30_000, 2), endpoint()
    settings = {
        "control": CONTROL,
        "trigger": {"mode": "ptp", "rate_hz": 20, "phase_ms": 15},
        "publish": {"listen": [at], "stamp": "ptp", "ptp_utc_offset_s": 0},
    }
    with (
        ptp_master(port),
        stereo_cameras("--still", "--ptp", str(port)) as cameras,
        running_daemon(cameras, settings) as run,
        StereoClient(connect=[at], name="slam") as client,
    ):
        tracking = run.daemon.telemetry.tracking
        assert tracking is not None
        pairs: list[ReceivedPair] = []

        def is_known() -> bool:
            pair = client.next_pair(0.1)
            if pair is not None:
                pairs.append(pair)
                client.send_tracking(pair.stamp_ns, np.full((6, 8), 20, np.uint16), np.full((6, 8), 20, np.uint16))
            return tracking.reports >= 5

        run.wait_until(is_known, "reports on frames")
    for pair in pairs:
        exposed_ns = round(500 * pair.left.setting.exposure_time_us)
        assert pair.stamp_ns == pair.left.device_time_ns + exposed_ns
        assert abs((pair.left.device_time_ns - 15_000_000) % 50_000_000) < 10_000
        assert abs(pair.stamp_ns - (pair.left.host_time_ns + realtime_offset_ns())) < 10_000_000
    assert tracking.refused["future"] == tracking.refused["stale"] == tracking.refused["unknown_frame"] == 0


@pytest.mark.gige_only  # shots are independent of the transport
def test_a_shot_is_found_by_what_its_frames_say_while_the_exposure_is_locked() -> None:
    """On a slow machine a write may come late, and split the shot or double it."""
    setting = ExposureSetting(400.0, 6.0)
    shot = {"exposure_time_us": setting.exposure_time_us, "gain_db": setting.gain_db}
    with stereo_cameras("--still") as cameras, running_daemon(cameras) as run:
        run.wait_for_pairs(30)
        locked = run.daemon.ask(new_request({"by": "test", "locked": True})).result(10).requests.locked
        assert locked is not None
        run.wait_until(lambda: run.seen[-1][0].reference.setting.agrees_with(locked), "the lock")
        taken = run.daemon.ask(new_request({"by": "test", "shot": shot})).result(10).shot
        assert taken is not None and taken.setting.agrees_with(setting)
        run.wait_for_pairs(10)
        seen = [pair for pair, _ in run.seen if pair.trigger > taken.trigger - 5]
        run.wait_until(lambda: run.seen[-1][0].reference.setting.agrees_with(locked), "the lock to go on")
        assert run.seen[-1][1].reason == "locked"
    shown = {
        pair.trigger: {camera for camera, frame in pair.frames.items() if frame.setting.agrees_with(setting)}
        for pair in seen
    }
    whole = [trigger for trigger, by in shown.items() if len(by) == 2]
    of_left = [trigger for trigger, by in shown.items() if "left" in by]
    assert taken.trigger == (whole or of_left)[0]  # a whole pair, even where one camera had shown it before
    assert sum(map(bool, shown.values())) <= 4


@pytest.mark.gige_only  # the right camera's trigger input is independent of the transport
def test_the_left_camera_may_trigger_the_right_one() -> None:
    trigger = {"mode": "primary", "line": "Line3", "output_line": "Line1", "rate_hz": 40}
    with (
        stereo_cameras("--still", left_triggers_right=True) as cameras,
        running_daemon(cameras, {"control": CONTROL, "trigger": trigger}) as run,
    ):
        run.wait_for_pairs(40)
        assert median_skew_periods(run, 40) < 0.1


FEATURES = [
    {"UserSetSelector": "Default"}, {"UserSetLoad": "execute"}, {"Width": 320}, {"Height": 200}, {"OffsetX": 200},
    {"OffsetY": 100}, {"ReverseX": True}, {"LineSelector[Line3].LineInverter": True}, {"BlackLevel": 2.5},
]  # fmt: skip


def test_a_camera_that_comes_back_is_set_again() -> None:
    """It comes back in its power-on state, after its plug was pulled."""
    with stereo_cameras("--still") as cameras:
        left, right, _ = cameras
        named = {"left": {"serial": left.serial, "features": FEATURES}, "right": {"serial": right.serial}}
        settings = {"cameras": named, "control": {"policy": "fixed"}}
        with running_daemon(cameras, settings) as run:
            run.wait_for_pairs(5)
            left.inject(Fault.VANISH, count=20)
            run.wait_until(lambda: run.daemon.telemetry.counts.reconnects == 1, "the left camera's return")
            run.wait_for_pairs(5)
            pairs = [pair for pair, _ in run.seen if len(pair.frames) == 2]
        shapes = [
            {camera: frame.pixels.shape for camera, frame in pair.frames.items()} for pair in (pairs[0], pairs[-1])
        ]
        assert shapes == [{"left": (200, 320), "right": (540, 720)}] * 2
        with open_nodes(left.serial) as nodes:
            assert differing(nodes, parse_features(FEATURES[2:])) == []
