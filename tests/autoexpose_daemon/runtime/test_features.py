"""Features of the cameras in a running daemon, over the wire; test_on_usb3.py runs it again over USB3 Vision."""

from __future__ import annotations

import pytest

from drivers.aravis import open_nodes
from drivers.genicam.features import differing
from drivers.setup import parse_features
from fake_camera.device.faults import Fault
from tests.autoexpose_daemon.stereo import JOIN_WARNING, running_daemon, stereo_cameras

pytestmark = [pytest.mark.realtime, JOIN_WARNING]

FEATURES = [
    {"UserSetSelector": "Default"}, {"UserSetLoad": "execute"}, {"Width": 320}, {"Height": 200}, {"OffsetX": 200},
    {"OffsetY": 100}, {"ReverseX": True}, {"LineSelector[Line3].LineInverter": True}, {"BlackLevel": 2.5},
]  # fmt: skip


def test_a_camera_that_comes_back_is_set_again() -> None:
    """It comes back in its power-on state, after its plug was pulled."""
    with stereo_cameras("--still") as cameras:
        left, right, _ = cameras
        sides = {"left": {"serial": left.serial, "features": FEATURES}, "right": {"serial": right.serial}}
        settings = {"cameras": sides, "control": {"policy": "fixed"}}
        with running_daemon(cameras, settings) as run:
            run.wait_for_pairs(5)
            left.inject(Fault.VANISH, count=20)
            run.wait_until(lambda: run.daemon.telemetry.counts.reconnects == 1, "the left camera's return")
            run.wait_for_pairs(5)
            pairs = [pair for pair, _ in run.seen if len(pair.frames) == 2]
        shapes = [{side: frame.pixels.shape for side, frame in pair.frames.items()} for pair in (pairs[0], pairs[-1])]
        assert shapes == [{"left": (200, 320), "right": (540, 720)}] * 2
        with open_nodes(left.serial) as nodes:
            assert differing(nodes, parse_features(FEATURES[2:])) == []
