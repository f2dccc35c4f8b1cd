"""From configuration to opened cameras."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from autoexpose_daemon.config import Config, TriggerConfig
from drivers.aravis import open_camera
from drivers.camera import Camera
from drivers.frames import Side
from drivers.setup import CameraSetup, TriggerSetup


def openers(config: Config) -> dict[Side, Callable[[], Camera]]:
    """For each side of the rig, what opens its camera as configured."""
    return {
        side: partial(
            open_camera,
            camera.serial,
            CameraSetup(
                trigger=_trigger(config.trigger, side),
                pixel_format=config.image.pixel_format,
                binning=config.image.binning,
                packet_size_bytes=config.transport.packet_size_bytes,
            ),
        )
        for side, camera in config.sides.items()
    }


def _trigger(trigger: TriggerConfig, side: Side) -> TriggerSetup:
    """With mode primary the left camera runs by its own clock, and its exposures trigger the right one."""
    if trigger.mode == "primary" and side == "left":
        return TriggerSetup("free_run", rate_hz=trigger.rate_hz, output_line=trigger.output_line)
    return TriggerSetup("free_run" if trigger.mode == "free_run" else "external", trigger.line, trigger.rate_hz)
