"""A control loop in virtual time, whose decisions take effect some frames later."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from evaluation.stage.camera import LIMITS
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction


class DelayedLoop:
    """Takes each frame with the setting decided `delay_frames` earlier, and decides on it. `loop`: decides. The first
    `delay_frames` frames are taken with its start. `delay_frames`: a decision on frame k applies from frame k +
    delay_frames, which is at least 1. `decisions`: one for each frame so far, with M_g."""

    def __init__(self, loop: ControlLoop, delay_frames: int) -> None:
        self.loop = loop
        self.loop.metric_asked = True
        self.decisions: list[Decision] = []
        self._settings = [loop.setup.start] * delay_frames

    @property
    def metrics(self) -> list[float]:
        """M_g of each frame so far."""
        return [decision.metric for decision in self.decisions if decision.metric is not None]

    @property
    def settings(self) -> list[ExposureSetting]:
        """The setting of each frame so far."""
        return self._settings[: len(self.decisions)]

    def step(self, take: Callable[[ExposureSetting], StereoPair]) -> StereoPair:
        """Take the next frame with `take`, decide on it, and return it."""
        pair = take(self._settings[len(self.decisions)])
        self.decisions.append(self.loop.step(pair))
        self._settings.append(self.decisions[-1].setting)
        return pair


MakeLoop = Callable[[ResponseFunction, ExposureLimits, ExposureSetting], ControlLoop]


@dataclass(frozen=True, slots=True)
class Entrant:
    """A participant: its name, its delay (see `DelayedLoop`), and how its control loop is made."""

    name: str
    delay_frames: int
    make_loop: MakeLoop

    @classmethod
    def of(cls, policy_id: str, delay_frames: int = 2) -> Entrant:
        """A policy by its id."""
        return cls(policy_id, delay_frames, partial(ControlLoop, policy_id))

    def enter(self, start: ExposureSetting) -> DelayedLoop:
        """A fresh loop for linear cameras that starts from a setting."""
        return DelayedLoop(self.make_loop(ResponseFunction.linear(), LIMITS, start), self.delay_frames)
