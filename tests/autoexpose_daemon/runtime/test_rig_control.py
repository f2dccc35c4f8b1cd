"""Which pairs control decides on, and what is said, done and shown of the cameras meanwhile."""

from __future__ import annotations

import logging
from contextlib import nullcontext
from dataclasses import replace
from itertools import pairwise
from typing import cast

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import OWN
from autoexpose_daemon.control.policies.published.mean import Fixed
from autoexpose_daemon.control.policy import Observation, Target
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.runtime.rig_health import (
    BESIDE_ANOTHER,
    FIRST_PAUSE_NS,
    INCOMPLETE_FRAMES,
    LIKE_ALL,
    LONGEST_PAUSE_NS,
    StuckStreams,
    Troubles,
)
from autoexpose_daemon.runtime.setup import ActiveLoop, Tuning
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import newest_setting
from autoexpose_daemon.status.telemetry import GONE
from drivers.camera import CameraDescription, IncompleteFrame, RefusedPackets
from drivers.rig.events import CameraGone, CameraReady, CameraSilent, Command, FrameArrived, PacketsRefused
from drivers.rig.supervision import Slots
from imaging.errors import CameraLostError, ConfigurationError, NodeError, UnsupportedCameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
from imaging.pixels import PixelFormat
from tests.autoexpose_daemon.virtual import SteadyLoop, tuning

PERIOD_NS = 20_000_000
SETTING = ExposureSetting(1000.0, 0.0)
READY = {
    camera: CameraReady(
        camera,
        CameraDescription("ours", "scripted", camera, pixel_format=PixelFormat.MONO8, size=(90, 68)),
        ExposureLimits(20.0, 15_000.0, 0.0, 30.0),
    )
    for camera in SIDES
}


class NoCameras:
    """Takes what control writes (see `autoexpose_daemon.runtime.rig_control.Cameras`)."""

    def write(self, command: Command) -> None:
        pass

    def pace(self, camera: CameraName, slots: Slots) -> None:
        raise AssertionError("triggered from outside")

    def reopen(self, camera: CameraName, why: str) -> None:
        raise AssertionError("not silent for long")


def arrived(camera: CameraName, trigger: int) -> FrameArrived:
    time_ns = trigger * PERIOD_NS
    return FrameArrived(camera, Frame(np.full((68, 90), 99, np.uint8), 8, trigger, time_ns, time_ns, time_ns, SETTING))


def rig_of_two() -> RigControl:
    """Control of two cameras that are ready."""
    cameras = {camera: {"serial": camera} for camera in SIDES}
    config = Config.model_validate({"cameras": cameras, "trigger": {"rate_hz": 50}, "control": {"policy": "fixed"}})
    control = RigControl(config, NoCameras(), now_ns=lambda: 3 * PERIOD_NS)
    control.take(list(READY.values()))
    return control


def test_a_pair_of_which_one_frame_was_decided_on_alone_is_counted_and_goes_out_once() -> None:
    control = rig_of_two()
    seen: list[tuple[int, int, bool]] = []
    control.outlets.append(
        lambda step: seen.append((step.pair.trigger, len(step.pair.frames), step.decision is not None))
    )
    control.take([arrived(camera, 1) for camera in SIDES])
    control.take([arrived("left", 2), CameraSilent("right")])
    control.take([arrived("right", 2)])
    first = seen[0][0]
    assert seen == [(first, 2, True), (first + 1, 1, True)]
    assert control.telemetry.counts.pairs_without_decision == 1
    assert control.record.tally.pairs == 2


def test_pairs_of_which_one_frame_was_decided_on_before_the_other_camera_was_there_are_no_anomaly() -> None:
    control = rig_of_two()
    control.take([arrived(camera, 1) for camera in SIDES])
    control.take([CameraGone("right", CameraLostError("unplugged"), final=False), arrived("left", 2)])
    control.take([arrived("left", 3), READY["right"]])
    control.take([arrived("right", 3)])  # its first frame comes when the other one's has been used
    assert control.record.tally.pairs == 2
    assert control.telemetry.counts.pairs_without_decision == 0
    control.take([arrived(camera, 4) for camera in SIDES])
    control.take([arrived("left", 5), CameraSilent("right")])
    control.take([arrived("right", 5)])
    assert control.telemetry.counts.pairs_without_decision == 1


def test_the_exposure_that_is_shown_is_not_that_of_a_camera_which_is_gone() -> None:
    control = rig_of_two()
    control.take([arrived(camera, 1) for camera in SIDES])
    control.take([CameraGone("left", CameraLostError("unplugged"), final=False)])
    alone = ExposureSetting(2 * SETTING.exposure_time_us, SETTING.gain_db)
    event = arrived("right", 60)
    control.take([replace(event, frame=replace(event.frame, setting=alone))])
    status = describe(control.telemetry, control.config)
    assert (status.cameras["left"].applied, status.cameras["right"].applied) == (None, alone)
    assert newest_setting(status) == alone


def test_packets_of_others_are_counted_and_named_only_while_the_camera_is_silent() -> None:
    control = rig_of_two()
    refused = PacketsRefused("left", RefusedPackets(7, ("10.0.0.9:40000",), ("10.0.0.2",)))
    control.take([arrived("left", 1), refused])
    assert not control.telemetry.cameras.troubles
    control.take([CameraSilent("left"), refused])
    trouble = control.telemetry.cameras.troubles["left", "strangers"]
    for part in ("10.0.0.9:40000", "10.0.0.2", "give it one address", "docs/understand/hostile-packets.md"):
        assert part in trouble
    control.take([arrived("left", 2)])
    assert not control.telemetry.cameras.troubles
    assert control.telemetry.counts.refused_packets == 14


def test_holes_before_a_camera_was_lost_are_not_held_against_it_afterwards() -> None:
    control = rig_of_two()
    holes = FrameArrived("left", IncompleteFrame(1, None))
    control.take([holes] * INCOMPLETE_FRAMES)
    assert ("left", "incomplete") in control.telemetry.cameras.troubles
    control.take([CameraGone("left", CameraLostError("unplugged"), final=False), READY["left"], holes])
    assert not control.telemetry.cameras.troubles


CANNOT_BE_DRIVEN = UnsupportedCameraError("camera S: it has no PixelFormat")


def test_a_camera_that_comes_back_and_cannot_be_driven_stays_out_and_the_other_one_goes_on() -> None:
    control = rig_of_two()
    control.take([CameraGone("left", CANNOT_BE_DRIVEN, final=True)])
    control.take([arrived("right", 2), CameraSilent("left")])
    assert control.telemetry.cameras.troubles["left", "gone"].startswith(f"{CANNOT_BE_DRIVEN}; it stays out")
    assert control.telemetry.newest == {"right": SETTING}
    refused = NodeError("camera T: its ExposureAuto has no Off, only Continuous")
    with pytest.raises(NodeError, match="camera T"):
        control.take([CameraGone("right", refused, final=True)])


@pytest.mark.parametrize(("opened_ns", "ends"), [(0, True), (-60_000_000_000, False)])
def test_a_camera_that_cannot_be_driven_ends_the_start_but_not_what_runs_for_long(opened_ns: int, ends: bool) -> None:
    control = rig_of_two()
    control.telemetry.opened_ns = opened_ns
    control._health._ever_ready.discard("left")
    control.take([CameraGone("left", CameraLostError("nobody there"), final=False)])
    with pytest.raises(UnsupportedCameraError) if ends else nullcontext():
        control.take([CameraGone("left", CANNOT_BE_DRIVEN, final=True)])


TENTH_NS = 100_000_000
CAMERAS: dict[CameraName, str] = {"left": "A 1", "right": "B 2"}


def attempts_s(
    right: str = "B 2", left_flows: bool = True, until_s: float = 100.0, period_s: float = 1 / 60
) -> list[float]:
    """When the right camera is reopened, which sent its last frame at 0."""
    stuck = StuckStreams(period_s, needs_pulses=True)
    cameras: dict[CameraName, str] = {"left": "A 1", "right": right}
    for camera in cameras:
        stuck.arrived(camera, 0)
    attempts = []
    for now_ns in range(0, 100_000_000_000, TENTH_NS):
        if left_flows:
            stuck.arrived("left", now_ns)
        for camera, why in stuck.reasons(cameras, now_ns).items():
            assert (camera, why) == ("right", BESIDE_ANOTHER)
            attempts.append(now_ns * 1e-9)
    return attempts


def test_a_silent_camera_beside_one_that_sends_is_reopened_less_and_less_often() -> None:
    attempts = attempts_s()
    assert attempts[0] == pytest.approx(FIRST_PAUSE_NS * 1e-9 + 0.5, abs=0.2)
    pauses = [later - earlier for earlier, later in pairwise(attempts)]
    assert pauses == pytest.approx([6, 12, 24, 48], abs=0.3)
    assert max(pauses) < LONGEST_PAUSE_NS * 1e-9


def test_a_stopped_trigger_or_a_lost_camera_reopens_nothing() -> None:
    assert attempts_s(left_flows=False) == []
    assert attempts_s(right=GONE) == []


def test_with_a_slow_trigger_it_waits_for_many_periods() -> None:
    assert attempts_s(period_s=2.0)[0] == pytest.approx(60, abs=1)


def test_once_it_sends_again_the_pause_is_reset() -> None:
    stuck = StuckStreams(1 / 60, needs_pulses=True)
    for start_ns in (0, 10 * FIRST_PAUSE_NS):
        for camera in CAMERAS:
            stuck.arrived(camera, start_ns)
        assert stuck.reasons(CAMERAS, start_ns) == {}
        stuck.arrived("left", start_ns + 2 * FIRST_PAUSE_NS)
        assert stuck.reasons(CAMERAS, start_ns + FIRST_PAUSE_NS) == {}
        assert stuck.reasons(CAMERAS, start_ns + 2 * FIRST_PAUSE_NS) == {"right": BESIDE_ANOTHER}


def test_where_no_pulses_are_needed_all_silent_cameras_are_reopened() -> None:
    stuck = StuckStreams(1 / 60, needs_pulses=False)
    for camera in CAMERAS:
        stuck.arrived(camera, 0)
    assert stuck.reasons(CAMERAS, FIRST_PAUSE_NS // 2) == {}
    assert stuck.reasons(CAMERAS, 2 * FIRST_PAUSE_NS) == {"left": LIKE_ALL, "right": LIKE_ALL}
    assert stuck.reasons({"left": "A 1"}, 2 * FIRST_PAUSE_NS + 1, untriggered=["left"]) == {}


@pytest.fixture
def troubles(caplog: pytest.LogCaptureFixture) -> Troubles:
    caplog.set_level(logging.WARNING)
    return Troubles({})


def test_a_trouble_is_logged_when_it_begins_and_when_it_returns(
    troubles: Troubles, caplog: pytest.LogCaptureFixture
) -> None:
    troubles.begin("left", "refused", "1 us was refused")
    troubles.begin("left", "refused", "2 us was refused")
    assert troubles.present == {("left", "refused"): "1 us was refused"}
    troubles.end("left", "refused")
    assert troubles.present == {}
    troubles.begin("left", "refused", "3 us was refused")
    assert caplog.messages == ["left camera: 1 us was refused", "left camera: 3 us was refused"]


def test_each_new_sentence_about_a_lost_camera_is_logged_once_however_they_alternate(
    troubles: Troubles, caplog: pytest.LogCaptureFixture
) -> None:
    for sentence in ("no answer", "another serial", "no answer", "another serial"):
        troubles.change("left", "gone", sentence)
        assert troubles.present == {("left", "gone"): sentence}
    assert caplog.messages == ["left camera: no answer", "left camera: another serial"]
    troubles.end("left", "gone")
    troubles.change("left", "gone", "no answer")
    assert len(caplog.messages) == 3


def test_a_verdict_is_logged_when_it_changes(troubles: Troubles, caplog: pytest.LogCaptureFixture) -> None:
    for verdict in (None, "120 Hz", "120 Hz", "30 Hz", None):
        troubles.judge("right", "rate", verdict)
    assert caplog.messages == ["right camera: 120 Hz", "right camera: 30 Hz"]
    assert troubles.present == {}


def test_a_cameras_troubles_go_with_it_and_no_others(troubles: Troubles) -> None:
    for camera in ("left", "right"):
        for kind in ("refused", "rate"):
            troubles.begin(camera, kind, "wrong")  # type: ignore[arg-type]
    troubles.end_all("left")
    assert troubles.present.keys() == {("right", "refused"), ("right", "rate")}


class LoopUnderLamps(SteadyLoop):
    """Finds, step by step, what it was told."""

    def __init__(self, *found_hz: float | None) -> None:
        super().__init__(ExposureLimits(20.0, 7500.0, 0.0, 30.0), ExposureSetting(2000.0, 0.0))
        self._found_hz = list(found_hz)

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        self.flicker_hz = self._found_hz.pop(0)
        return super().step(inputs)


def test_the_log_says_once_that_the_light_flickers_or_no_longer_does(caplog: pytest.LogCaptureFixture) -> None:
    active, pair = ActiveLoop(tuning(2000.0)), FrameSet(0, {})
    active.loop = cast(ControlLoop, LoopUnderLamps(None, 100.0, 100.0, None))
    with caplog.at_level("INFO"):
        for _ in range(4):
            active.step(StepInputs(pair))
    assert caplog.messages == [
        "the light flickers at 100 Hz: exposure times of whole periods, where they fit",
        "the light no longer flickers: any exposure time",
    ]


class Faulty(Fixed):
    """A policy of another package, on frames that its author did not think of."""

    def decide(self, observation: Observation) -> Target:
        raise ZeroDivisionError("no window in view")


def test_a_policy_that_fails_on_the_newest_frames_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OWN, "faulty", Faulty)
    cameras = {"cameras": {"left": {"serial": "A"}}}
    active = ActiveLoop(Tuning(Config.model_validate(cameras)))
    active.ready(
        CameraReady("left", CameraDescription("Maker", "Model 7", "A"), ExposureLimits(20.0, 7500.0, 0.0, 30.0))
    )
    frame = Frame(np.full((90, 120), 100, np.uint8), 8, 1, 0, 0, 0, ExposureSetting(2000.0, 0.0))
    active.step(StepInputs(FrameSet(1, {"left": frame})))
    with pytest.raises(ConfigurationError, match=r"policy faulty .*ZeroDivisionError: no window in view"):
        active.tune(Tuning(Config.model_validate(cameras | {"control": {"policy": "faulty"}})))
    assert active.tuning.config.control.policy == "belief"


@pytest.mark.parametrize(("range_stops", "told"), [(6.0, True), (3.0, False)])
def test_brackets_that_do_not_fit_into_the_limits_are_told(
    range_stops: float, told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    sections = {"start": {"exposure_time_us": 2000}, "bracket": {"exposures": 3, "range_stops": range_stops}}
    active = ActiveLoop(tuning(2000.0, control=sections))
    camera = CameraDescription("Maker", "Model 7", "A")
    active.ready(CameraReady("left", camera, ExposureLimits(1000.0, 2000.0, 0.0, 12.0)))
    warned = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert warned == told * [
        "brackets of 6.0 stops do not fit into the 3.0 stops of these limits, and their outer shots are clipped: widen "
        "`exposure`, or narrow the brackets"
    ]


def test_cameras_whose_offset_leaves_no_common_gain_are_refused_with_what_each_takes() -> None:
    cameras = {"left": {"serial": "A"}, "right": {"serial": "B", "offset_stops": 5}}
    active = ActiveLoop(Tuning(Config.model_validate({"cameras": cameras})))
    camera, twelve_db = CameraDescription("Maker", "Model 7", "A"), ExposureLimits(20.0, 7500.0, 0.0, 12.0)
    active.ready(CameraReady("left", camera, twelve_db))
    with pytest.raises(ConfigurationError, match="leave no gain to choose") as refused:
        active.ready(CameraReady("right", camera, replace(twelve_db, min_gain_db=-30.1, max_gain_db=-18.1)))
    assert "the right camera takes 20 to 7500 us, -30.1 to -18.1 dB with its offset_stops of 5 taken off" in str(
        refused.value
    )
