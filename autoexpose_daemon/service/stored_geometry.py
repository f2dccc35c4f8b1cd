"""The geometry of cameras that others measured while the daemon ran, kept for good in place of the configured files."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.config.request import GeometryRequest, Request
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import Answer
from calibration.geometry.file import check_camera, check_pair, load_geometry
from calibration.geometry.numbers import check_plausible
from calibration.geometry.opencv import ros_yaml
from documents.text import quoted
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.frames import CameraName
from imaging.geometry import CameraGeometry, DistortionModel
from imaging.python310 import FutureTimeoutError

log = logging.getLogger(__name__)

_PATIENCE_S = 4.0
_MODELS: Mapping[str, DistortionModel] = {name: name for name in get_args(DistortionModel)}


@dataclass(frozen=True)
class StoredGeometry:
    """Files of cameras below a folder, in a folder named after the rig; None: kept until the process ends."""

    folder: Path | None

    @classmethod
    def in_state_folder(cls) -> StoredGeometry:
        """In the one that systemd gives the service; otherwise in the user's, as the XDG specification has it."""
        given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
        home = os.environ.get("XDG_STATE_HOME", "")
        own = Path(home) if Path(home).is_absolute() else Path.home() / ".local/state"
        return cls((Path(given) if given else own / "autoexpose") / "geometry")

    def applied(self, config: Config) -> Config:
        """A configuration, whose files have not been read yet, with what is stored in place of its own files.

        What is stored for another camera is left out, and so is the file of a camera that does not fit what is stored
        for the other one of its pair; the log says so.
        """
        found = {name: self._load(config, name) for name in config.cameras}
        stored = {name: geometry for name, geometry in found.items() if geometry is not None}
        if not stored:
            return config
        files: dict[CameraName, Path | None] = {name: self._file(config, name) for name in stored}
        for left, right in config.stereo_pairs.values():
            for name, other in ((left, right), (right, left)):
                if name in stored and other not in stored and config.cameras[other].calibration is not None:
                    files |= _fitting(config, {name: stored[name]}, other)
        for name, file in files.items():
            if file is not None:
                log.info("%s camera: its geometry is the one that was set, %s", name, file)
        cameras = {
            name: camera.model_copy(update={"calibration": files[name]}) if name in files else camera
            for name, camera in config.cameras.items()
        }
        others = {name: getattr(config, name) for name in Config.model_fields}
        return Config.model_validate({**others, "cameras": cameras})

    def ask(self, daemon: Daemon, request: Request) -> Future[Answer]:
        """Have control answer a request, which may be to store geometry, and to use it from the next frames on."""
        if request.geometry is None:
            return daemon.ask(request)
        try:
            self._take(daemon, {name: it for name, it in request.geometry.items() if it is not None}, request.by)
        except AutoexposeError as error:
            refused: Future[Answer] = Future()
            refused.set_exception(error)
            return refused
        return daemon.ask(Request(by=request.by))

    def _take(self, daemon: Daemon, asked: Mapping[CameraName, GeometryRequest], by: str) -> None:
        config, present = daemon.config, _present(daemon)
        geometries: dict[CameraName, CameraGeometry | None] = {}
        for name, request in asked.items():
            geometries[name] = _checked(config, daemon, name, request)
        for left, right in config.stereo_pairs.values():
            if asked.keys() & {left, right}:
                geometries |= _with_partner(present, geometries, left, right)
        for name, geometry in geometries.items():
            self._keep(config, name, geometry)
        taken = daemon.calibrate(geometries)
        try:
            taken.result(_PATIENCE_S)
        except FutureTimeoutError:
            raise AutoexposeError("control does not respond: the geometry is stored, for the next start") from None
        for name, geometry in geometries.items():
            if geometry is None:
                log.warning("%s camera: its geometry does not fit that of its pair any longer: set it, too", name)
            else:
                where = "until the end" if self.folder is None else f"stored in {self._file(config, name)}"
                log.info("%s camera: geometry of %s, %s", name, by, where)

    def _keep(self, config: Config, name: CameraName, geometry: CameraGeometry | None) -> None:
        if self.folder is None:
            return
        file = self._file(config, name)
        part = file.with_suffix(".part")
        try:
            if geometry is None:
                file.unlink(missing_ok=True)
                return
            file.parent.mkdir(parents=True, exist_ok=True)
            part.write_text(ros_yaml(geometry, config.side_of(name)), encoding="ascii")
            part.replace(file)
        except OSError as error:
            raise AutoexposeError(f"the geometry cannot be stored in {file}: {error.strerror or error}") from error

    def _load(self, config: Config, name: CameraName) -> CameraGeometry | None:
        """What is stored for a camera; None if there is nothing, or nothing usable."""
        if self.folder is None or not (file := self._file(config, name)).exists():
            return None
        try:
            geometry = load_geometry(file, config.side_of(name))
            check_camera(geometry, config.cameras[name].serial)
        except ConfigurationError as error:
            log.warning("%s camera: %s is not used: %s", name, file, error)
            return None
        return geometry

    def _file(self, config: Config, name: CameraName) -> Path:
        assert self.folder is not None
        return self.folder / (config.publish or PublishConfig()).rig / f"{name}.yaml"


def _present(daemon: Daemon) -> dict[CameraName, CameraGeometry]:
    tunings: list[Tuning] = [group.active.tuning for group in daemon.groups.values()]
    return {name: geometry for tuning in tunings for name, geometry in tuning.calibrations.items()}


def _checked(config: Config, daemon: Daemon, name: CameraName, asked: GeometryRequest) -> CameraGeometry:
    """What was asked for; ConfigurationError if no camera has such a geometry, or this one does not."""
    if name not in config.cameras:
        raise ConfigurationError(f"geometry.{name}: the rig has no {name} camera")
    model = _MODELS.get(asked.distortion_model)
    if model is None:
        raise ConfigurationError(
            f"geometry.{name}: distortion_model is {quoted(asked.distortion_model)}: give one of {', '.join(_MODELS)}"
        )
    serial = config.cameras[name].serial
    geometry = CameraGeometry(asked.width, asked.height, model, asked.d, asked.k, asked.r, asked.p, serial)
    try:
        check_plausible(geometry)
        for group in daemon.groups.values():
            if (camera := group.active.cameras.get(name)) is not None:
                check_camera(geometry, serial, camera.size)
    except ConfigurationError as error:
        raise ConfigurationError(f"geometry.{name}: {error}") from error
    return geometry


def _with_partner(
    present: Mapping[CameraName, CameraGeometry],
    asked: Mapping[CameraName, CameraGeometry | None],
    left: CameraName,
    right: CameraName,
) -> dict[CameraName, CameraGeometry | None]:
    """What becomes of a pair; a geometry that was there before gives way to a new one that it does not fit.

    Raises ConfigurationError for one that does not fit the pair at all.
    """
    one, other = asked.get(left), asked.get(right)
    if one is not None:
        check_pair(one, None, left, right)
    if other is not None:
        check_pair(None, other, left, right)
    try:
        check_pair(one or present.get(left), other or present.get(right), left, right)
    except ConfigurationError:
        if one is not None and other is not None:
            raise
        return {right if other is None else left: None}
    return {}


def _fitting(
    config: Config, stored: Mapping[CameraName, CameraGeometry], other: CameraName
) -> dict[CameraName, Path | None]:
    """The configured file of the other camera of a pair is left out if it does not fit what is stored for the one."""
    file = config.cameras[other].calibration
    assert file is not None
    left, right = next(pair for pair in config.stereo_pairs.values() if other in pair and stored.keys() & {*pair})
    try:
        configured = load_geometry(file, config.side_of(other))
        both = {**stored, other: configured}
        check_pair(both[left], both[right], left, right)
    except ConfigurationError as error:
        log.warning("%s camera: %s is not used beside the geometry that was set: %s", other, file, error)
        return {other: None}
    return {}
