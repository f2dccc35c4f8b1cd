"""Findings on the features that the configuration sets."""

from __future__ import annotations

from collections.abc import Iterator

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.doctor.finding import Finding
from autoexpose_daemon.runtime.cameras import refusals


def judge_features(config: Config) -> Iterator[Finding]:
    """Open each camera as the daemon would, and close it again."""
    for side, error in refusals(config):
        camera = config.sides[side]
        if error is None:
            sentence = f"{side} camera {camera.serial} takes all {len(camera.features)} features"
            yield Finding("features", "ok", sentence)
        else:
            yield Finding("features", "stops", f"{side} camera: {error}", f"autoexpose features {camera.serial}")
