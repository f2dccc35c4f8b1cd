"""Control of cameras that are exposed together: decides on their frames, and says what to write to them."""

from __future__ import annotations

from dataclasses import replace

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.runtime.requests import Requests
from autoexpose_daemon.runtime.setup import ActiveLoop, Tuning
from autoexpose_daemon.status.telemetry import GroupTally
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName


def starts(config: Config, start: ExposureSetting | None = None) -> dict[CameraName, ExposureSetting]:
    """The setting that each camera starts with: `start`, within the bounds of its group; None: as configured."""
    found: dict[CameraName, ExposureSetting] = {}
    for group, cameras in config.cameras_of_groups.items():
        part = config.of_group(group)
        begin = part.start if start is None else part.exposure.limits().nearest(start)
        found |= dict.fromkeys(cameras, begin)
    return found


class GroupControl:
    """The loop of a group, what is requested of it, and the setting that its cameras were asked for last."""

    def __init__(
        self,
        config: Config,  # as if the rig had no other cameras
        tally: GroupTally,
        start: ExposureSetting,  # the setting that the cameras start with
        period_ns: float,
    ) -> None:
        self.cameras = tuple(config.cameras)
        self.tally = tally
        self.active = ActiveLoop(Tuning(config))
        self.requests = Requests(self.active, tally.requests, start, period_ns)
        self.asked: ExposureSetting | None = start  # None: write the next one, even if it is the same
        tally.cameras, tally.policy = self.cameras, config.control.policy

    def step(self, inputs: StepInputs, *, first: bool) -> ControlStep | None:
        """Decide on the group's part of a set; None: there is none, or no camera of the group has been ready yet.

        The light ahead is of what the `first` group sees.
        """
        part = inputs.pair.of(self.cameras)
        if part is None:
            return None
        mine = inputs
        if part.frames.keys() != inputs.pair.frames.keys():
            steering = inputs.steering if inputs.steering is None else inputs.steering.of(self.cameras)
            mine = replace(inputs, pair=part, light_ahead=inputs.light_ahead if first else None, steering=steering)
        mine = replace(mine, override=self.requests.override(part))
        decision = self.active.step(mine)
        if decision is None or self.active.loop is None:
            return None
        self.tally.decision, self.tally.flicker_hz = decision, self.active.loop.flicker_hz
        return ControlStep(mine, decision)

    def look(self, now_ns: int) -> None:
        """To be called at least ten times a second."""
        self.requests.look(now_ns)
        self.tally.policy = self.active.tuning.config.control.policy
