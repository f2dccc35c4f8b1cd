"""Statuses of a daemon, as the node reads them."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.status.counters import Bounds, RequestTally
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.telemetry import GroupTally, Telemetry
from imaging.exposure import ExposureSetting
from imaging.geometry import CameraPose

POSE = CameraPose("left", (0.08, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def told(**groups: tuple[str, ...]) -> dict[str, Any]:
    """What a daemon of these groups of cameras says, by default one of left and right."""
    of_groups = groups or {"all": ("left", "right")}
    cameras = {camera: {"serial": camera} for cameras in of_groups.values() for camera in cameras}
    config = Config.model_validate({"cameras": cameras, "publish": {}})
    telemetry = Telemetry(period_s=1 / 60)
    bounds = Bounds(20.0, 7500.0, 0.0, 30.0)
    telemetry.groups = {
        name: GroupTally(cameras, "belief", requests=RequestTally(bounds=bounds)) for name, cameras in of_groups.items()
    }
    telemetry.cameras.names = dict.fromkeys(cameras, "Fake 1")
    telemetry.cameras.temperatures_c = dict.fromkeys(cameras, 46.0)
    telemetry.newest = dict.fromkeys(cameras, ExposureSetting(1000.0, 3.0))
    status = describe(telemetry, config)
    if "right" in cameras:
        right = replace(status.cameras["right"], pose=POSE, link_mbps=1000.0)
        status = replace(status, cameras={**status.cameras, "right": right})
    return dict(json.loads(status.to_json()))
