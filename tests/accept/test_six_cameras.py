"""Six cameras in three groups through stock Aravis: one is killed and started again, and the others do not mind."""

from __future__ import annotations

import contextlib

import pytest

from tests.autoexpose_daemon.stereo import ON_USB, rig_cameras, running
from tests.fakes import FakeCamera, fake_camera, usb3_camera

pytestmark = pytest.mark.realtime

RATE_HZ = 4.0  # a slow machine bears it: the fakes themselves lose what they are a period late with
OPTIONS = ["--still", "--line0-rate-hz", f"{RATE_HZ:g}"]
KILLED = "rear_right"
FRAMES = 10
NOISE = 2
"""Frames that a busy machine loses. To the frame it is shown in virtual time: tests/soak."""


def started_again(camera: FakeCamera) -> contextlib.AbstractContextManager[FakeCamera]:
    if ON_USB:
        return usb3_camera(camera.serial, socket=camera.socket, place=KILLED, line0=camera.line0, options=OPTIONS)
    return fake_camera(camera.serial, place=KILLED, line0=camera.line0, options=OPTIONS)


def test_one_is_killed_and_started_again_and_no_frame_of_the_others_is_lost() -> None:
    with rig_cameras(6, *OPTIONS) as cameras, contextlib.ExitStack() as later:
        named = {name: {"serial": cameras[name].serial, "group": name.partition("_")[0]} for name in cameras}
        settings = {"cameras": named, "trigger": {"rate_hz": RATE_HZ}, "exposure": {"max_time_us": 50_000}}
        truths = [camera.truth_file for camera in cameras.values()]
        with running(cameras, truths, settings) as run:
            run.wait_for_pairs(FRAMES)
            lost = run.daemon.telemetry.cameras.frames_lost
            cameras[KILLED].kill()
            run.wait_until(lambda: KILLED not in run.seen[-1][0].frames, "sets without it")
            alone = len(run.seen)
            run.wait_until(lambda: len(run.seen) > alone + FRAMES, "the others going on")
            truths.append(later.enter_context(started_again(cameras[KILLED])).truth_file)
            run.wait_for_pairs(FRAMES)
            assert run.daemon.telemetry.counts.reconnects == 1
            meanwhile = {name: now - lost[name] for name, now in run.daemon.telemetry.cameras.frames_lost.items()}
            assert meanwhile.pop(KILLED) >= FRAMES
            assert max(meanwhile.values()) <= NOISE, meanwhile
        tally = run.daemon.tally
    assert {name: tally.frames[name] + tally.frames_lost[name] for name in cameras} == dict.fromkeys(
        cameras, tally.triggers
    )
