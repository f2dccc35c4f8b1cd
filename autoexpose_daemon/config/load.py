"""Reading a configuration file, and what it says of how to open each camera."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from importlib.metadata import entry_points
from pathlib import Path

from pydantic import ValidationError

from autoexpose_daemon.config.control import BracketConfig
from autoexpose_daemon.config.document import CameraConfig, Config
from autoexpose_daemon.config.section import error_sentences
from autoexpose_daemon.control.policies.ids import GROUP
from documents.strict_yaml import load_mapping
from documents.text import readable
from drivers.genicam.features import refuse_driven
from drivers.setup import CameraSetup, LinkShare, TriggerMode, TriggerSetup
from imaging.errors import ConfigurationError
from imaging.frames import CameraName


def camera_setup(config: Config, camera: CameraName) -> CameraSetup:
    """How to open a camera."""
    return CameraSetup(
        trigger=_trigger(config, camera),
        pixel_format=config.image.pixel_format,
        binning=config.image.binning,
        packet_size_bytes=config.transport.packet_size_bytes,
        link_share=_link_share(config, camera),
        features=config.cameras[camera].features,
        gain_scale=config.gain_scales[camera],
        exposure_count_us=config.cameras[camera].exposure_count_us,
        offset_stops=config.cameras[camera].offset_stops,
    )


def _link_share(config: Config, camera: CameraName) -> LinkShare | None:
    """Its part of the link to the host, if that is planned, among the cameras that name the same link."""
    if not config.transport.plan:
        return None
    links = [each.link for each in config.cameras.values()]
    return LinkShare(links.count(config.cameras[camera].link), config.transport.link_mbps)


def refuse_driven_features(path: Path, config: Config) -> None:
    """Raise ConfigurationError with a sentence for each feature in the file that the daemon drives itself."""
    refused = [
        f"{path}: cameras.{camera}.features: {error}"
        for camera in config.cameras
        for error in refuse_driven(camera_setup(config, camera))
    ]
    if refused:
        raise ConfigurationError("\n".join(refused))


def _trigger(config: Config, camera: CameraName) -> TriggerSetup:
    """In mode primary the first camera runs by its own clock, and its exposures trigger the others."""
    trigger = config.trigger
    mode: TriggerMode
    output_line = None
    if trigger.mode != "primary":
        mode = trigger.mode
    elif camera != config.primary:
        mode = "external"
    else:
        mode, output_line = "free_run", trigger.output_line
    return TriggerSetup(mode, trigger.line, trigger.rate_hz, config.exposure.max_time_us, output_line)


_RANGE = re.compile(r"1:(\d{1,9}(?:\.\d+)?)")


def bracketed(config: Config, bracket: bool, exposures: int | None, range_: str | None, keep: bool) -> Config:
    """A configuration with the brackets that options ask for; without `bracket`, the configuration itself.

    Its own brackets give what the options leave open; `range_` is as in ``1:64``. Raises ConfigurationError naming the
    option at fault.
    """
    if not bracket:
        if exposures is not None or range_ is not None or keep:
            raise ConfigurationError("--exposures, --range and --keep are for brackets: add --bracket")
        return config
    given: dict[str, object] = {} if exposures is None else {"exposures": exposures}
    if range_ is not None:
        given["range_stops"] = _stops(range_)
    if keep:
        given["keep"] = True
    own = {} if config.control.bracket is None else config.control.bracket.model_dump()
    try:
        brackets = BracketConfig.model_validate({**own, **given})
    except ValidationError as error:
        raise ConfigurationError(f"--bracket: {error_sentences(error, BracketConfig)[0]}") from error
    return config.model_copy(update={"control": config.control.model_copy(update={"bracket": brackets})})


def _stops(range_: str) -> float:
    match = _RANGE.fullmatch(range_)
    if match is None or float(match[1]) <= 1.0:
        raise ConfigurationError(f"--range {range_} is no range: give 1:N, as in 1:64")
    return math.log2(float(match[1]))


_OPTIONAL = ("publish", "control.bracket", "motion.imu")
"""Sections without which nothing is published, and so on."""


def _know_policies() -> None:
    """Those of other packages, if there are any: only they need control, which needs its C extension, to be tried."""
    if entry_points(group=GROUP):
        from autoexpose_daemon.own_policy.installed import register_policies  # noqa: PLC0415

        register_policies()


def load_config(path: Path) -> Config:
    """Read and check a configuration file, with the calibration and mask files it names.

    Raises ConfigurationError with one sentence for each thing that is wrong, with file and key.
    """
    _know_policies()
    content = load_mapping(path, "begin with `cameras:`; see docs/look-up/configuration.md")
    _refuse_empty(path, content)
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        sentences = (readable(f"{path}: {mistake}") for mistake in error_sentences(error, Config))
        raise ConfigurationError("\n".join(sentences)) from error
    try:
        config = _with_absolute_paths(config, path.resolve().parent)
        # Read now, so that errors in them are reported now.
        _ = config.responses, config.gain_scales, config.calibrations, config.vignettings, config.control.regions
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
    cameras: dict[str, CameraConfig] = {name: camera.relative_to(folder) for name, camera in config.cameras.items()}
    publish = config.publish and config.publish.relative_to(folder, "publish")
    imu = config.motion.imu and config.motion.imu.relative_to(folder, "motion.imu")
    return config.model_copy(
        update={
            "cameras": cameras,
            "control": config.control.relative_to(folder),
            "motion": config.motion.model_copy(update={"imu": imu}),
            "publish": publish,
        }
    )
