"""One step of control: what it is given, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.inputs import LightAhead
from autoexpose_daemon.control.picture.steering import Steering
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet


@dataclass(frozen=True, slots=True)
class Override:
    """What applies to one step besides its frames."""

    ev_stops: float = 0.0  # stops that are added to what the policy decides
    held: ExposureSetting | None = None  # the setting to stay at, whatever the policy decides; None: as it decides
    shot: ExposureSetting | None = None  # the setting of the next pair alone, even if one is held; None: no shot
    unseen: bool = False  # this pair was taken for a shot: the policy does not see it. Only with `held`

    @property
    def reason(self) -> str:
        """Why a setting is asked for that the policy has not decided on."""
        if self.shot is not None:
            return "one shot"
        return "held: this pair is a shot" if self.unseen else "locked"


NO_OVERRIDE = Override()


@dataclass(frozen=True, slots=True, eq=False)
class StepInputs:
    """Everything that decides on the next setting, apart from what the loop remembers.

    What is added here is passed on, recorded and replayed by itself: it needs a source while the daemon runs, and
    something that uses it.
    """

    pair: FrameSet  # the frames
    # how fast the camera turns, from an inertial sensor; the speed of image points is then this rate times the focal
    # length, and no flow is computed. None: flow
    angular_rate_rad_s: float | None = None
    # what an earlier drive along the same route saw, which `belief` uses; None: nothing is known
    light_ahead: LightAhead | None = None
    # what overrides the policy. While a setting is held, the policy keeps looking, so it knows the light when it
    # decides again
    override: Override = NO_OVERRIDE
    # where consumers track well, for policies that are `STEERED`; None: nothing is known
    steering: Steering | None = None

    @classmethod
    def of(cls, given: StepInputs | FrameSet) -> StepInputs:
        """What is given, of which a pair alone is shorthand."""
        return cls(given) if isinstance(given, FrameSet) else given


@dataclass(frozen=True, slots=True, eq=False)
class ControlStep:
    """A step of a running daemon, for those who watch it."""

    inputs: StepInputs  # what control was given: the pair alone if it made no decision
    decision: Decision | None = None  # none: a newer pair arrived before control looked at this one
    requests: tuple[str, ...] = ()  # the requests that took effect with this step, and who asked
    # where not all cameras are exposed together, the step of each group by its name: `decision` is then the first's
    groups: Mapping[str, ControlStep] = field(default_factory=dict)

    @property
    def pair(self) -> FrameSet:
        """The frames."""
        return self.inputs.pair

    @property
    def decisions(self) -> dict[CameraName, Decision]:
        """What was decided for each camera; empty: nothing."""
        steps = self.groups.values() or [self]
        return {name: each.decision for each in steps if each.decision is not None for name in each.pair.frames}
