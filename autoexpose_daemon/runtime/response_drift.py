"""Checks the cameras' responses against their frames in operation, and keeps refined copies if configured."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from autoexpose_daemon.config.document import Config
from calibration.response.drift import Change, ResponseWatch, misfit_grey, refine
from calibration.response.file import ResponseFile
from drivers.log_throttle import LogThrottle
from imaging.errors import ConfigurationError
from imaging.frames import CameraName, FrameSet
from imaging.python310 import UTC

log = logging.getLogger(__name__)

_THROTTLE = LogThrottle(600.0)  # in changing light an attempt is made every second or so

DOUBTFUL_GREY = 3.0
"""Misfit (grey levels rms) above which a response is doubted: a good one is off by half a grey level."""

TRUSTED_GREY = 2.0
"""Misfit below which it is trusted again."""

REFINE_EVERY = 64
"""Changes of exposure between two attempts at a better response."""


@dataclass(slots=True)
class _Camera:
    serial: str
    file: ResponseFile
    watch: ResponseWatch
    next_attempt: int = REFINE_EVERY


class ResponseDrift:
    """Watches the responses of a configuration's cameras; for one thread."""

    def __init__(self, config: Config) -> None:
        # How far responses are off: grey levels rms, for each side with a verdict; in words, where it does not hold.
        self.residual_grey: dict[CameraName, float] = {}
        self.misfits: dict[CameraName, str] = {}
        self._refines = config.response.refine
        self._last_trigger = -1
        self._copies = refined_paths({camera: file.path for camera, file in config.responses.items() if file.path})
        self._cameras = {
            camera: _Camera(config.cameras[camera].serial, file, ResponseWatch(file.response))
            for camera, file in config.responses.items()
        }

    def see(self, pair: FrameSet) -> None:
        """The next pair; frames without their own exposure metadata are ignored."""
        follows, self._last_trigger = pair.trigger == self._last_trigger + 1, pair.trigger
        for name, camera in self._cameras.items():
            frame = pair.frames.get(name)
            if frame is None or not follows or frame.setting_source != "chunk":
                camera.watch.interrupt()
                continue
            counted = camera.watch.counted
            camera.watch.see(frame.sparse_grey8(), frame.setting.level)
            if camera.watch.counted > counted:
                self._judge(name, camera)

    def _judge(self, name: CameraName, camera: _Camera) -> None:
        residual = camera.watch.residual_grey
        if residual is None:
            return
        self.residual_grey[name] = residual
        if name not in self.misfits and residual > DOUBTFUL_GREY:
            self.misfits[name] = (
                f"response off by {residual:.1f} grey levels rms when the exposure changes: "
                f"autoexpose calibrate response --camera {camera.serial}"
            )
            log.warning("%s camera: %s", name, self.misfits[name])
        elif name in self.misfits and residual < TRUSTED_GREY:
            del self.misfits[name]
            log.info("%s camera: its response holds again", name)
        if self._refines and name in self._copies and camera.watch.counted >= camera.next_attempt:
            camera.next_attempt = camera.watch.counted + REFINE_EVERY
            arguments = name, camera.file, self._copies[name], list(camera.watch.changes)
            threading.Thread(target=_refine, args=arguments, name=f"refine-{name}", daemon=True).start()


def refined_paths(calibrated: Mapping[CameraName, Path]) -> dict[CameraName, Path]:
    """Where the refined copies of response files are kept: in the service's state directory, else beside them.

    Files of one name would share a copy there: the names of theirs begin with the side.
    """
    state = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    paths = {camera: Path(state or file.parent, f"{file.stem}.refined.yaml") for camera, file in calibrated.items()}
    if len(set(paths.values())) == len(paths):
        return paths
    return {camera: path.with_name(f"{camera}.{path.name}") for camera, path in paths.items()}


def _refine(camera: CameraName, file: ResponseFile, path: Path, changes: list[Change]) -> None:
    """Write a better response than the calibrated one, if the changes show one."""
    better = refine(file.response, changes)
    if better is None:
        return
    before, after = misfit_grey(file.response, changes), misfit_grey(better, changes)
    try:
        origin = replace(file.origin, date=datetime.now(UTC))
        replace(file, response=better, origin=origin, model="free", parameters={}, residual_grey=after).save(path)
    except ConfigurationError as error:
        if _THROTTLE.due((path, "failed"), time.monotonic_ns()):
            log.warning("%s camera: the refined response could not be written: %s", camera, error)
        return
    if not _THROTTLE.due((path, "refined"), time.monotonic_ns()):
        return
    log.info("%s camera: %s refined: off by %.1f grey levels rms, was %.1f", camera, path, after, before)
