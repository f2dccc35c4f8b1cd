"""Which pairs control decides on, what becomes of the others, and what is shown of the cameras meanwhile."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.rig_control import RigControl
from autoexpose_daemon.runtime.rig_health import INCOMPLETE_FRAMES
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import newest_setting
from drivers.camera import CameraDescription, IncompleteFrame, RefusedPackets
from drivers.rig.events import CameraGone, CameraReady, CameraSilent, FrameArrived, PacketsRefused
from drivers.rig.supervision import Slots
from imaging.errors import CameraLostError, NodeError, UnsupportedCameraError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import SIDES, Frame, Side
from imaging.pixels import PixelFormat

PERIOD_NS = 20_000_000
SETTING = ExposureSetting(1000.0, 0.0)
READY = {
    side: CameraReady(
        side,
        CameraDescription("ours", "scripted", side, pixel_format=PixelFormat.MONO8, size=(90, 68)),
        ExposureLimits(20.0, 15_000.0, 0.0, 30.0),
    )
    for side in SIDES
}


class NoCameras:
    """Takes what control writes (see `autoexpose_daemon.runtime.rig_control.Cameras`)."""

    def write(self, setting: ExposureSetting, not_before_ns: int, command: int) -> None:
        pass

    def pace(self, side: Side, slots: Slots) -> None:
        raise AssertionError("triggered from outside")

    def reopen(self, side: Side, why: str) -> None:
        raise AssertionError("not silent for long")


def arrived(side: Side, trigger: int) -> FrameArrived:
    time_ns = trigger * PERIOD_NS
    return FrameArrived(side, Frame(np.full((68, 90), 99, np.uint8), 8, trigger, time_ns, time_ns, time_ns, SETTING))


def rig_of_two() -> RigControl:
    """Control of two cameras that are ready."""
    cameras = {side: {"serial": side} for side in SIDES}
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
    control.take([arrived(side, 1) for side in SIDES])
    control.take([arrived("left", 2), CameraSilent("right")])
    control.take([arrived("right", 2)])
    first = seen[0][0]
    assert seen == [(first, 2, True), (first + 1, 1, True)]
    assert control.telemetry.counts.pairs_without_decision == 1
    assert control.record.tally.pairs == 2


def test_pairs_of_which_one_frame_was_decided_on_before_the_other_camera_was_there_are_no_anomaly() -> None:
    control = rig_of_two()
    control.take([arrived(side, 1) for side in SIDES])
    control.take([CameraGone("right", CameraLostError("unplugged"), final=False), arrived("left", 2)])
    control.take([arrived("left", 3), READY["right"]])
    control.take([arrived("right", 3)])  # its first frame comes when the other one's has been used
    assert control.record.tally.pairs == 2
    assert control.telemetry.counts.pairs_without_decision == 0
    control.take([arrived(side, 4) for side in SIDES])
    control.take([arrived("left", 5), CameraSilent("right")])
    control.take([arrived("right", 5)])
    assert control.telemetry.counts.pairs_without_decision == 1


def test_the_exposure_that_is_shown_is_not_that_of_a_camera_which_is_gone() -> None:
    control = rig_of_two()
    control.take([arrived(side, 1) for side in SIDES])
    control.take([CameraGone("left", CameraLostError("unplugged"), final=False)])
    alone = ExposureSetting(2 * SETTING.exposure_time_us, SETTING.gain_db)
    event = arrived("right", 60)
    control.take([replace(event, frame=replace(event.frame, setting=alone))])
    status = describe(control.telemetry, control.active.tuning.config)
    assert (status.cameras["left"].applied, status.cameras["right"].applied) == (None, alone)
    assert newest_setting(status) == alone


def test_packets_of_others_are_counted_and_named_only_while_the_camera_is_silent() -> None:
    control = rig_of_two()
    refused = PacketsRefused("left", RefusedPackets(7, ("10.0.0.9:40000",), ("10.0.0.2",)))
    control.take([arrived("left", 1), refused])
    assert not control.telemetry.cameras.troubles
    control.take([CameraSilent("left"), refused])
    trouble = control.telemetry.cameras.troubles["left", "strangers"]
    for part in ("10.0.0.9:40000", "10.0.0.2", "give it one address", "docs/hostile-packets.md"):
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
