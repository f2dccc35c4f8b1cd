"""The tuning of control: the part of a configuration that may change while the cameras run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.loop import ControlLoop
from drivers.exposure import ExposureLimits
from drivers.frames import Side


class Tuning:
    """Bounds, policy, parameters, response and regions; reads their files unless the configuration has.

    Raises
    ------
    ConfigurationError
        When one of the files cannot be used.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.responses = {side: file.response for side, file in config.responses.items()}
        self._regions = config.control.roi.regions

    def check_belongs(self, pixel_formats: Mapping[Side, str | None]) -> None:
        """Refuse a response file made for another pixel format than a camera sends; raises ConfigurationError."""
        for side, pixel_format in pixel_formats.items():
            self.config.responses[side].check_belongs(self.config.sides[side].serial, pixel_format)

    def limits(self, cameras: Iterable[ExposureLimits]) -> ExposureLimits:
        """The bounds, cut to those of the cameras; raises ConfigurationError if nothing is left."""
        limits = self.config.exposure.limits()
        for own in cameras:
            limits = limits.within(own)
        return limits

    def loop(self, limits: ExposureLimits) -> ControlLoop:
        """A new control loop."""
        control = self.config.control
        return ControlLoop(
            control.policy,
            self.responses,
            limits,
            self.config.start,
            parameters=control.parameters(),
            regions=self._regions,
        )
