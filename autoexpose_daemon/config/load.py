"""Reading a configuration file: YAML on disk, and one sentence for each mistake in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pydantic import ValidationError

from autoexpose_daemon.config.camera_setup import refuse_driven_features
from autoexpose_daemon.config.cameras import CameraConfig
from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.mistakes import mistakes
from documents.strict_yaml import load_mapping
from documents.text import readable
from imaging.errors import ConfigurationError

_OPTIONAL = ("publish", "cameras.right", "control.bracket", "motion.imu")
"""Sections without which nothing is published, and so on."""


def load_config(path: Path) -> Config:
    """Read and check a configuration file, with the calibration and mask files it names.

    Raises
    ------
    ConfigurationError
        One sentence for each thing that is wrong, with file and key.
    """
    content = load_mapping(path, "begin with `cameras:`; see docs/configuration.md")
    _refuse_empty(path, content)
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        sentences = (readable(f"{path}: {mistake}") for mistake in mistakes(error, Config))
        raise ConfigurationError("\n".join(sentences)) from error
    try:
        config = _with_absolute_paths(config, path.resolve().parent)
        # Read now, so that errors in them are reported now.
        _ = config.responses, config.gain_scales, config.calibrations, config.vignettings, config.control.roi.regions
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    refuse_driven_features(path, config)
    return config


def _refuse_empty(path: Path, content: Mapping[str, object]) -> None:
    """Refuse an optional section whose keys are all commented out: it would be ignored."""
    for name in _OPTIONAL:
        section: object = content
        for key in name.split("."):
            section = section.get(key, {}) if isinstance(section, Mapping) else {}
        if section is None:
            raise ConfigurationError(
                f"{path}: {name}: is empty: give keys below it, {{}} for all defaults, or remove it"
            )


def _with_absolute_paths(config: Config, folder: Path) -> Config:
    """Files are relative to the configuration file, wherever the daemon is started."""
    cameras: dict[str, CameraConfig] = {side: camera.relative_to(folder) for side, camera in config.sides.items()}
    control = config.control.model_copy(update={"roi": config.control.roi.relative_to(folder)})
    publish = config.publish and config.publish.relative_to(folder, "publish")
    imu = config.motion.imu and config.motion.imu.relative_to(folder, "motion.imu")
    return config.model_copy(
        update={
            "cameras": config.cameras.model_copy(update=cameras),
            "control": control,
            "motion": config.motion.model_copy(update={"imu": imu}),
            "publish": publish,
        }
    )
