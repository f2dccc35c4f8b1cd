"""The control loop in use: built when cameras are ready, and rebuilt when their limits or the tuning change."""

from __future__ import annotations

import logging

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.runtime.setup import Tuning
from drivers.camera import CameraDescription
from drivers.rig.events import CameraReady
from imaging.exposure import ExposureLimits
from imaging.frames import Side, StereoPair

log = logging.getLogger(__name__)

_ROUNDING_STOPS = 0.05
"""Brackets that are clipped by less are not worth a word."""


class ActiveLoop:
    """Holds the loop that decides.

    Attributes
    ----------
    tuning
        What the loop is built from, apart from the cameras' limits.
    loop
        None until a camera is ready.
    """

    def __init__(self, tuning: Tuning) -> None:
        self.tuning = tuning
        self.loop: ControlLoop | None = None
        self._limits: dict[Side, ExposureLimits] = {}
        self._cameras: dict[Side, CameraDescription] = {}
        self._newest: StereoPair | None = None

    def ready(self, event: CameraReady) -> None:
        """Take over the limits of a camera; raises ConfigurationError if no common range is left."""
        self._limits[event.side] = event.limits
        self._cameras[event.side] = event.description
        limits = self.tuning.limits(self._limits.values())
        if self.loop is None or limits != self.loop.setup.limits:
            self._install(self.tuning.loop(limits))

    @property
    def knows_all_limits(self) -> bool:
        """Whether every camera has been ready."""
        return self._limits.keys() >= self.tuning.config.sides.keys()

    def has_been_open(self, side: Side) -> bool:
        """Whether a camera has been ready."""
        return side in self._cameras

    def tune(self, tuning: Tuning) -> None:
        """Switch to another tuning; ConfigurationError, with nothing changed, if it does not fit cameras or frames."""
        self.use(tuning, self.prepared(tuning))

    def prepared(self, tuning: Tuning) -> ControlLoop:
        """The loop of another tuning, for `use`; ConfigurationError if it does not fit cameras or frames."""
        tuning.check_belongs(self._cameras)
        loop = tuning.loop(tuning.limits(self._limits.values()))
        for side, camera in self._cameras.items():
            tuning.check_region(side, camera)
        if self._newest is not None:
            loop.step(self._newest)
        return loop

    def use(self, tuning: Tuning, loop: ControlLoop) -> None:
        """Switch to another tuning and its loop."""
        self.tuning = tuning
        if self._limits:
            self._install(loop)

    def step(self, inputs: StepInputs) -> Decision | None:
        """Decide; None before a camera is ready."""
        if self.loop is None:
            return None
        known_hz = self.loop.flicker_hz
        decision = self.loop.step(inputs)
        if self.loop.flicker_hz != known_hz:
            log.info("%s", _flicker_in_words(self.loop.flicker_hz))
        self._newest = inputs.pair
        return decision

    def _install(self, loop: ControlLoop) -> None:
        limits = loop.setup.limits
        log.info(
            "exposure within %g to %g us, %g to %g dB",
            limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db,
        )  # fmt: skip
        bracketing = self.tuning.config.control.bracket
        room = limits.brightest.level - limits.darkest.level
        if bracketing is not None and bracketing.range_stops > room + _ROUNDING_STOPS:
            log.warning(
                "brackets of %.1f stops do not fit into the %.1f stops of these limits, and their outer shots are "
                "clipped: widen `exposure`, or narrow the brackets", bracketing.range_stops, room,
            )  # fmt: skip
        self.loop = loop


def _flicker_in_words(flicker_hz: float | None) -> str:
    if flicker_hz is None:
        return "the light no longer flickers: any exposure time"
    return f"the light flickers at {flicker_hz:g} Hz: exposure times of whole periods, where they fit"
