"""Watching whether the cameras' responses still hold while the daemon works, and keeping better ones."""

from __future__ import annotations

import logging
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from autoexpose_daemon.config import Config
from calibration.refinement import LEAST_PAIRS, ResponseWatch
from calibration.response_file import ResponseFile
from drivers.errors import ConfigurationError
from drivers.frames import Side, StereoPair

log = logging.getLogger(__name__)

DRIFT_GREY = 3.0
"""Predictions that are off by more are told: a calibration that is `with care` is as good."""
SPARSE = 4
"""Every so many rows and columns are enough for quantiles; means would be too bright where black cuts noise off."""


class RigWatch:
    """One `ResponseWatch` for each camera of a rig, on frames that say themselves what they were taken with."""

    def __init__(self, config: Config) -> None:
        self.drift_grey: dict[Side, float] = {}
        self._files = {side: camera.response for side, camera in config.sides.items()}
        self._refine = config.response.refine
        self._watches = {side: ResponseWatch(config.response_of(side)) for side in config.sides}
        self._judged_pairs = dict.fromkeys(config.sides, 0)
        self._last_trigger = -1

    def observe(self, pair: StereoPair) -> None:
        """Take the frames of the next pair, and judge anew once there is enough to say something new."""
        follows = pair.trigger == self._last_trigger + 1
        self._last_trigger = pair.trigger
        frames = {"left": pair.left, "right": pair.right}
        for side, watch in self._watches.items():
            frame = frames[side]
            if not follows or frame is None or frame.setting_source != "chunk":
                watch.interrupt()
            if frame is not None and frame.setting_source == "chunk":
                watch.observe(frame.grey8()[::SPARSE, ::SPARSE], frame.setting.level)
            if watch.pairs >= self._judged_pairs[side] + LEAST_PAIRS:
                self._judged_pairs[side] = watch.pairs
                drift_grey = watch.drift_grey
                if drift_grey is not None:
                    self.drift_grey[side] = drift_grey

    def save(self) -> None:
        """With `response.refine`, write what was learned next to each response file; the file itself stays."""
        if not self._refine:
            return
        for side, path in self._files.items():
            refined = self._watches[side].refined
            if path is None or refined is None:
                continue
            measured = ResponseFile.load(path)
            origin = replace(measured.origin, date=datetime.now(UTC).replace(microsecond=0))
            file = ResponseFile(
                refined, origin, "free", covered=measured.covered, noise=measured.noise, latency=measured.latency
            )
            target = refined_path(path)
            try:
                file.save(target)
            except ConfigurationError as error:
                log.error("%s", error)
            else:
                log.info("%s camera: refined response, from %d pairs: %s", side, self._watches[side].pairs, target)


def refined_path(path: Path) -> Path:
    """Where the refined copy of a response file is kept."""
    return path.with_suffix(".refined.yaml")
