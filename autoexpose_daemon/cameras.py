"""From configuration to opened cameras."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from autoexpose_daemon.config import Config
from drivers.aravis import open_camera
from drivers.camera import Camera
from drivers.frames import Side
from drivers.setup import CameraSetup, TriggerSetup


def openers(config: Config) -> dict[Side, Callable[[], Camera]]:
    """For each side of the rig, what opens its camera as configured."""
    mode = config.trigger.mode
    if mode == "primary":
        raise AssertionError("the configuration refuses it")
    setup = CameraSetup(
        trigger=TriggerSetup(mode, config.trigger.line, config.trigger.rate_hz),
        pixel_format=config.image.pixel_format,
        binning=config.image.binning,
        packet_size_bytes=config.transport.packet_size_bytes,
    )
    return {side: partial(open_camera, camera.serial, setup) for side, camera in config.sides.items()}
