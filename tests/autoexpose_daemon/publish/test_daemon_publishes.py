"""From a daemon's control to a consumer; the cameras do as they are told."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zenoh

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.messages.read import read_exposure_info
from autoexpose_daemon.messages.types import CAMERA_INFO, TYPESTORE
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.runtime.setup import Tuning
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, wait_until
from tests.autoexpose_daemon.scripted import SHAPE, config, scripted_daemon
from tests.calibration.geometry.written import small_ros

pytestmark = pytest.mark.wire

CONTROL = {"policy": "neves2009"}


def test_a_consumer_gets_what_control_saw_and_decided() -> None:
    at = endpoint()
    with (
        scripted_daemon(control=CONTROL, publish={"listen": [at]}) as (_, _, seen),
        StereoClient(connect=[at]) as client,
    ):
        received = [pair for _, pair in zip(range(30), client, strict=False)]
    by_trigger = {pair.trigger: (pair, decision) for pair, decision in seen}
    assert any(pair.decision is not None for pair in received)
    for pair in received:
        original, decision = by_trigger[pair.trigger]
        assert pair.decision == decision
        assert original.frames["right"] is not None
        assert pair.right is not None
        for ours, theirs in ((pair.left, original.frames["left"]), (pair.right, original.frames["right"])):
            assert np.array_equal(ours.pixels, theirs.pixels)
            assert (ours.setting, ours.setting_source) == (theirs.setting, "chunk")
            assert ours.frame_id == theirs.frame_id
    ages_s = [time.time() - pair.stamp_ns * 1e-9 for pair in received[-3:]]
    assert all(0 < age_s < PATIENCE_S for age_s in ages_s)


def test_camera_info_of_both_cameras_follows_their_files_and_reloads(tmp_path: Path) -> None:
    at, (height, width) = endpoint(), SHAPE
    cameras = {}
    for side, serial in (("left", "L"), ("right", "R")):
        cameras[side] = {"serial": serial, "calibration": tmp_path / f"{side}.yaml"}
        (tmp_path / f"{side}.yaml").write_text(yaml.safe_dump(small_ros(side, width, height)))
    infos: dict[str, Any] = {}

    def take(sample: zenoh.Sample) -> None:
        side = str(sample.key_expr).split("/")[2]
        infos[side] = TYPESTORE.deserialize_cdr(sample.payload.to_bytes(), CAMERA_INFO)

    with scripted_daemon(control=CONTROL, publish={"listen": [at]}, cameras=cameras) as (daemon, _, _):
        wait_until(lambda: daemon.telemetry.publishing and daemon.telemetry.publishing.sent, "frames")
        session = open_session("client", Endpoints(connect=[at]))
        with session, session.declare_subscriber("autoexpose/rig/*/camera_info", take):
            wait_until(lambda: len(infos) == 2, "both cameras' information")
            assert (infos["left"].p[3], infos["right"].p[3]) == (0.0, -0.08 * width)
            assert infos["right"].distortion_model == "plumb_bob"
            daemon.tune(Tuning(config(control=CONTROL))).result(PATIENCE_S)
            wait_until(lambda: not infos["left"].k.any(), "that the left camera is not calibrated")


def test_frames_of_a_camera_that_is_left_alone_keep_their_name() -> None:
    at = endpoint()
    with scripted_daemon(control=CONTROL, publish={"listen": [at]}) as (daemon, rig, _):
        wait_until(lambda: daemon.telemetry.publishing and daemon.telemetry.publishing.sent, "frames")
        session = open_session("client", Endpoints(connect=[at]))
        lone: list[str] = []

        def take(sample: zenoh.Sample) -> None:
            if read_exposure_info(sample.payload.to_bytes()).alone:
                lone.append(str(sample.key_expr))

        with session, session.declare_subscriber("autoexpose/rig/*/exposure", take):
            rig.left.lost = True
            wait_until(lambda: len(lone) > 20, "frames of the right camera alone")
        assert set(lone) == {"autoexpose/rig/right/exposure"}
