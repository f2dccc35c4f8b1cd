"""What the frames of a running rig reveal about trouble with its cameras."""

from __future__ import annotations

import logging
from collections import Counter

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.runtime.complaints import Complaints
from autoexpose_daemon.status.telemetry import Telemetry
from drivers.triggers.rate import HOST_RATE_TOLERANCE, RATE_TOLERANCE, RateWatch
from drivers.triggers.record import RigRecord
from drivers.triggers.writes import EffectWatch
from imaging.frames import Doubt, Frame, Side

log = logging.getLogger(__name__)

INCOMPLETE_FRAMES = 20
"""This many in a row are no coincidence."""

_INCOMPLETE = "all its frames arrive incomplete: check its cable, and network or USB for what they can carry"
_NO_METADATA = "its frames no longer say how they were taken: their exposure is inferred from when it was written"


class FrameWatch:
    """Checks every complete frame; counts in `telemetry`, complains in `complaints`."""

    def __init__(self, telemetry: Telemetry, complaints: Complaints, record: RigRecord, config: Config) -> None:
        self._telemetry = telemetry
        self._complaints = complaints
        self._record = record
        tolerance = HOST_RATE_TOLERANCE if config.trigger.by_host else RATE_TOLERANCE
        self._rates = RateWatch(config.trigger.rate_hz, config.trigger_sources, tolerance)
        self._effects = {side: EffectWatch() for side in config.sides}
        self._with_metadata: set[Side] = set()
        self._incomplete: Counter[Side] = Counter()

    def refused(self, side: Side) -> None:
        """A camera refused a setting, and may have taken part of it."""
        self._effects[side].gone()

    def frame(self, side: Side, frame: Frame) -> None:
        """The next complete frame of a camera."""
        self._incomplete[side] = 0
        self._complaints.end(side, "incomplete")
        self._complaints.judge(side, "rate", self._rates.frame(side, frame))
        self._complaints.judge(side, "effect", self._effects[side].frame(frame, self._record.history(side)))
        self._telemetry.counts.frames_off_setting = sum(watch.frames_off_setting for watch in self._effects.values())
        if frame.setting_source == "chunk":
            self._with_metadata.add(side)
            self._complaints.end(side, "metadata")
        elif side in self._with_metadata:
            self._telemetry.counts.frames_without_exposure_metadata += 1
            self._complaints.begin(side, "metadata", _NO_METADATA)

    def doubt(self, side: Side, doubt: Doubt) -> None:
        """A camera's numbers or time stamps are not believed: told with any complete frame, and once."""
        self._telemetry.counts.clock_jumps += doubt.kind == "jump"
        log.warning("%s camera: %s", side, doubt.sentence)

    def incomplete(self, side: Side) -> None:
        """A frame of a camera arrived with holes."""
        self._incomplete[side] += 1
        if self._incomplete[side] >= INCOMPLETE_FRAMES:
            self._complaints.begin(side, "incomplete", _INCOMPLETE)

    def silent(self, side: Side) -> None:
        """A camera sends no frames: complaints about them end."""
        self._rates.gone(side)
        self._incomplete[side] = 0
        for kind in ("rate", "incomplete"):
            self._complaints.end(side, kind)

    def gone(self, side: Side) -> None:
        """The camera is lost: everything is judged afresh when it returns."""
        self._rates.gone(side)
        self._effects[side].gone()
        self._incomplete[side] = 0
        self._with_metadata.discard(side)
