"""Reading a configuration file: YAML on disk, and one sentence for each mistake in it."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from autoexpose_daemon.config.camera_setup import refuse_driven_features
from autoexpose_daemon.config.document import CameraConfig, Config
from drivers.config.readable import readable
from drivers.config.strict_yaml import load_mapping
from drivers.errors import ConfigurationError


def load_config(path: Path) -> Config:
    """Read and check a configuration file, with the response, gain and mask files it names.

    Raises
    ------
    ConfigurationError
        One sentence for each thing that is wrong, with file and key.
    """
    content = load_mapping(path, "begin with `cameras:`; see docs/configuration.md")
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError("\n".join(_sentence(path, each) for each in error.errors())) from error
    try:
        config = _with_absolute_paths(config, path.resolve().parent)
        # Read now, so that errors in them are reported now.
        _ = config.responses, config.gain_scales, config.control.roi.regions
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    refuse_driven_features(path, config)
    return config


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


def _sentence(path: Path, error: ErrorDetails) -> str:
    """What is wrong, on one line whatever the file contains."""
    return readable(f"{path}: {_complaint(error)}")


def _complaint(error: ErrorDetails) -> str:
    key = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        *parents, last = [str(part) for part in error["loc"]]
        near = difflib.get_close_matches(last, _keys_of(parents), n=1)
        hint = f"did you mean {'.'.join([*parents, near[0]])}?" if near else f"known: {', '.join(_keys_of(parents))}"
        return f"{key}: unknown key; {hint}"
    if error["type"] == "missing":
        return f"{key}: is missing"
    message = error["msg"].removeprefix("Value error, ")
    return f"{key + ': ' if key else ''}{message[0].lower()}{message[1:]}"


def _keys_of(parents: list[str]) -> list[str]:
    """The known keys below a path of keys, taken from the models themselves."""
    model: type[BaseModel] = Config
    for parent in parents:
        if parent.isdecimal():  # a place in a list
            continue
        annotation: Any = model.model_fields[parent].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        model = next(c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel))
    return list(model.model_fields)
