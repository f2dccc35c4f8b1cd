"""How to open each camera, according to the configuration."""

from __future__ import annotations

from pathlib import Path

from autoexpose_daemon.config.document import Config
from drivers.genicam.features import refuse_driven
from drivers.setup import CameraSetup, LinkShare, TriggerMode, TriggerSetup
from imaging.errors import ConfigurationError
from imaging.frames import Side


def camera_setup(config: Config, side: Side) -> CameraSetup:
    """How to open the camera of a side."""
    return CameraSetup(
        trigger=_trigger(config, side),
        pixel_format=config.image.pixel_format,
        binning=config.image.binning,
        packet_size_bytes=config.transport.packet_size_bytes,
        link_share=LinkShare(len(config.sides), config.transport.link_mbps) if config.transport.plan else None,
        features=config.sides[side].features,
        gain_scale=config.gain_scales[side],
        exposure_count_us=config.sides[side].exposure_count_us,
    )


def refuse_driven_features(path: Path, config: Config) -> None:
    """Raise ConfigurationError with a sentence for each feature in the file that the daemon drives itself."""
    refused = [
        f"{path}: cameras.{side}.features: {error}"
        for side in config.sides
        for error in refuse_driven(camera_setup(config, side))
    ]
    if refused:
        raise ConfigurationError("\n".join(refused))


def _trigger(config: Config, side: Side) -> TriggerSetup:
    """In mode primary the left camera runs by its own clock, and its exposures trigger the right one."""
    trigger = config.trigger
    mode: TriggerMode
    output_line = None
    if trigger.mode != "primary":
        mode = trigger.mode
    elif side == "right":
        mode = "external"
    else:
        mode, output_line = "free_run", trigger.output_line
    return TriggerSetup(mode, trigger.line, trigger.rate_hz, config.exposure.max_time_us, output_line)
