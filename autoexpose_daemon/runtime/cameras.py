"""From configuration to opened cameras."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from autoexpose_daemon.config.camera_setup import camera_setup
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.tuning import Tuning
from drivers.aravis import open_camera
from drivers.camera import Camera
from drivers.setup import CameraSetup
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.frames import Side


def openers(config: Config) -> dict[Side, Callable[[], Camera]]:
    """For each side of the rig, a function that opens its camera as configured."""
    tuning = Tuning(config)
    return {side: partial(_open, tuning, side, camera_setup(config, side)) for side in config.sides}


def refusals(config: Config) -> Iterator[tuple[Side, AutoexposeError | None]]:
    """Why each side's camera cannot be opened, set up and exposed as configured, or None; it is closed again."""
    for side, opener in openers(config).items():
        try:
            opener().close()
        except AutoexposeError as error:
            yield side, error
        else:
            yield side, None


def _open(tuning: Tuning, side: Side, setup: CameraSetup) -> Camera:
    """Open a camera; refuse one that is not as files, limits or regions need it."""
    camera = open_camera(tuning.config.sides[side].serial, setup)
    try:
        tuning.config.check_frames(side, camera.description)
        tuning.limits([camera.limits])
        tuning.check_region(side, camera.description)
    except ConfigurationError:
        camera.close()
        raise
    return camera
