"""Stamps against the truth: when does the picture itself say that it was taken?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.demo.fakes import read_pulses
from autoexpose_daemon.messages.frames import realtime_offset_ns
from fake_camera.world.render.renderer import Pinhole, Renderer
from fake_camera.world.scene.path import CameraPath
from fake_camera.world.scene.room import furnished_room
from fake_camera.world.simulation import RoomView
from tests.autoexpose_daemon.publish.steps import endpoint
from tests.autoexpose_daemon.stereo import PATIENCE_S, running_daemon, stereo_cameras

EXPOSURE_US = 7000.0
RATE_HZ = 20.0
LUX = 15.0
PAIRS = 8
WITHIN_S = 0.012
STEP_S = 0.0005


def seen_at_s(view: RoomView, pixels: np.ndarray, about_s: float) -> float:
    """The instant, seconds since the wire's epoch, whose sharp picture is most like `pixels`."""
    instants_s = about_s + np.arange(-WITHIN_S, WITHIN_S + STEP_S / 2, STEP_S)
    seen = pixels[::3, ::3].astype(np.float64).ravel()
    likeness = []
    for instant_s in instants_s:
        sharp = view.radiance(np.array([instant_s]), LUX)[::3, ::3].ravel()
        likeness.append(np.corrcoef(np.minimum(sharp, np.quantile(sharp, 0.9)), seen)[0, 1])
    best = int(np.argmax(likeness))
    assert 0 < best < len(likeness) - 1
    before, most, after = likeness[best - 1 : best + 2]
    return float(instants_s[best] + STEP_S * (before - after) / 2 / (before - 2 * most + after))


@pytest.mark.realtime
def test_a_moving_room_is_seen_where_it_is_at_the_stamp(tmp_path: Path) -> None:
    light = tmp_path / "light.yaml"
    light.write_text(f"light: [{{at_s: 0, lux: {LUX}}}]")
    at = endpoint()
    settings = {
        "publish": {"listen": [at]},
        "control": {"policy": "fixed", "start": {"exposure_time_us": EXPOSURE_US}},
        "trigger": {"rate_hz": RATE_HZ},
    }
    with (
        stereo_cameras("--line0-rate-hz", str(RATE_HZ), "--light", str(light)) as cameras,
        running_daemon(cameras, settings) as run,
        StereoClient(connect=[at]) as client,
    ):
        run.wait_until(lambda: run.daemon.telemetry.counts.pairs > 0, "pairs")
        pairs: list[ReceivedPair] = []
        while len(pairs) < PAIRS:
            pair = client.next_pair(PATIENCE_S)
            assert pair is not None
            if pair.left.setting.exposure_time_us == pytest.approx(EXPOSURE_US, rel=0.01):
                pairs.append(pair)
        offset_ns = realtime_offset_ns()
        pulse = read_pulses(run.truths)[-1]
    epoch_ns = pulse.host_time_ns - round(pulse.trigger * 1e9 / RATE_HZ)
    height, width = pairs[0].left.pixels.shape
    view = RoomView(Renderer(furnished_room(0), Pinhole(width, height)), CameraPath(), "left")
    stamped_s = [(pair.stamp_ns - offset_ns - epoch_ns) * 1e-9 for pair in pairs]
    late_s = [at_s - seen_at_s(view, pair.left.pixels, at_s) for pair, at_s in zip(pairs, stamped_s, strict=True)]
    print([round(1e3 * late, 2) for late in late_s])
    assert abs(np.median(late_s)) < 0.2 * EXPOSURE_US * 1e-6  # half of it by the start or the end
