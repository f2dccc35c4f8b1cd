"""Whether the features and the policy that are configured can work."""

from __future__ import annotations

from collections.abc import Iterator

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.doctor.need import Diagnosis
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction


def judge_features(config: Config) -> Iterator[Diagnosis]:
    """Open each camera as the daemon would, and close it again."""
    from autoexpose_daemon.runtime.setup import refusals  # noqa: PLC0415  needs the C extension

    for side, error in refusals(config):
        camera = config.sides[side]
        if error is None:
            sentence = f"{side} camera {camera.serial} takes all {len(camera.features)} features"
            yield Diagnosis("features", "ok", sentence)
        else:
            yield Diagnosis("features", "stops", f"{side} camera: {error}", f"autoexpose features {camera.serial}")


def judge_policy(config: Config) -> Iterator[Diagnosis]:
    """Build it as the daemon would."""
    limits, start = config.exposure.limits(), config.start
    try:
        from autoexpose_daemon.control.loop import ControlLoop  # noqa: PLC0415  needs the C extension

        ControlLoop(config.control.policy, ResponseFunction.linear(), limits, start, config.control.parameters())
    except ConfigurationError as error:
        yield Diagnosis("policy", "stops", str(error))
