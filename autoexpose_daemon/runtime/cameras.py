"""From configuration to opened cameras."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from autoexpose_daemon.config.document import Config
from calibration.response.file import ResponseFile
from drivers.aravis import open_camera
from drivers.camera import Camera
from drivers.errors import ConfigurationError
from drivers.frames import Side
from drivers.setup import CameraSetup, LinkShare, TriggerSetup


def openers(config: Config) -> dict[Side, Callable[[], Camera]]:
    """For each side of the rig, a function that opens its camera as configured."""
    return {
        side: partial(
            _open,
            camera.serial,
            config.responses[side],
            CameraSetup(
                trigger=_trigger(config, side),
                pixel_format=config.image.pixel_format,
                binning=config.image.binning,
                packet_size_bytes=config.transport.packet_size_bytes,
                link_share=LinkShare(len(config.sides), config.transport.link_mbps) if config.transport.plan else None,
            ),
        )
        for side, camera in config.sides.items()
    }


def _open(serial: str, response: ResponseFile, setup: CameraSetup) -> Camera:
    """Open a camera, and refuse a response file made for another pixel format than it sends."""
    camera = open_camera(serial, setup)
    try:
        response.check_belongs(serial, camera.description.pixel_format)
    except ConfigurationError:
        camera.close()
        raise
    return camera


def _trigger(config: Config, side: Side) -> TriggerSetup:
    """In mode primary the left camera runs by its own clock, and its exposures trigger the right one."""
    trigger = config.trigger
    return TriggerSetup(
        "external" if side in config.triggered_sides else "free_run",
        trigger.line,
        trigger.rate_hz,
        config.exposure.max_time_us,
        trigger.output_line if trigger.mode == "primary" and side == "left" else None,
    )
