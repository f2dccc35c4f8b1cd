"""Which pairs control decides on, and what becomes of the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.rig_control import RigControl
from drivers.camera import CameraDescription
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import SIDES, Frame, Side
from drivers.pixels.formats import PixelFormat
from drivers.rig.events import CameraReady, CameraSilent, FrameArrived
from drivers.rig.pace import Slots

PERIOD_NS = 20_000_000
SETTING = ExposureSetting(1000.0, 0.0)


class NoCameras:
    """Takes what control writes (see `autoexpose_daemon.runtime.rig_control.Cameras`)."""

    def write(self, setting: ExposureSetting, not_before_ns: int) -> None:
        pass

    def pace(self, side: Side, slots: Slots) -> None:
        raise AssertionError("triggered from outside")

    def reopen(self, side: Side, why: str) -> None:
        raise AssertionError("not silent for long")


def arrived(side: Side, trigger: int) -> FrameArrived:
    time_ns = trigger * PERIOD_NS
    return FrameArrived(side, Frame(np.full((68, 90), 99, np.uint8), 8, trigger, time_ns, time_ns, time_ns, SETTING))


def test_a_pair_of_which_one_frame_was_decided_on_alone_is_counted_and_goes_out_once() -> None:
    cameras = {side: {"serial": side} for side in SIDES}
    config = Config.model_validate({"cameras": cameras, "trigger": {"rate_hz": 50}, "control": {"policy": "fixed"}})
    control = RigControl(config, NoCameras(), now_ns=lambda: 3 * PERIOD_NS)
    seen: list[tuple[int, int, bool]] = []
    control.outlets.append(lambda pair, decision: seen.append((pair.trigger, len(pair.frames), decision is not None)))
    described = CameraDescription("ours", "scripted", "", pixel_format=PixelFormat.MONO8, size=(90, 68))
    limits = ExposureLimits(20.0, 15_000.0, 0.0, 30.0)
    control.take([CameraReady(side, replace(described, serial=side), limits) for side in SIDES])
    control.take([arrived(side, 1) for side in SIDES])
    control.take([arrived("left", 2), CameraSilent("right")])
    control.take([arrived("right", 2)])
    first = seen[0][0]
    assert seen == [(first, 2, True), (first + 1, 1, True)]
    assert control.telemetry.counts.pairs_without_decision == 1
    assert control.record.tally.pairs == 2
