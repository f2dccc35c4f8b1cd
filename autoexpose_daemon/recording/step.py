"""What a recording is made of: steps of control, and now and then the state of control after one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.control.loop import ControlSetup
from autoexpose_daemon.control.override import NO_OVERRIDE, Override
from autoexpose_daemon.control.picture.steering import Steering
from autoexpose_daemon.control.snapshot import Plain
from imaging.errors import AutoexposeError
from imaging.frames import Side, StereoPair
from imaging.geometry import CameraGeometry


class RecordingError(AutoexposeError):
    """A recording cannot be written or read; the message names the file."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """One step of control.

    Attributes
    ----------
    sequence
        Counts the steps of control: a gap is what the recorder dropped.
    cameras
        How many cameras the rig has.
    pair
        What control looked at. A gap in its `trigger` without one in `sequence` means pairs that never reached control.
    decision
        What control decided.
    angular_rate_rad_s
        How fast the camera turned; None: control was not given it, and used optical flow.
    light_ahead
        What control knew of an earlier drive; None: nothing.
    override
        What overrode the policy.
    requests
        What was requested of control since the step before, and who asked.
    steering
        Where consumers were known to track; None: nothing was known.
    calibrations
        Geometry of the calibrated cameras, in CameraInfo; a replay needs none.
    stamp_ns
        Of a step that was read: the stamp of its messages, CLOCK_REALTIME.
    """

    sequence: int
    cameras: int
    pair: StereoPair
    decision: Decision
    angular_rate_rad_s: float | None = None
    light_ahead: LightAhead | None = None
    override: Override = NO_OVERRIDE
    requests: tuple[str, ...] = ()
    steering: Steering | None = None
    calibrations: Mapping[Side, CameraGeometry] = field(default_factory=dict)
    stamp_ns: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """A new control loop, which makes the steps that follow.

    Attributes
    ----------
    control
        What the loop is built from.
    made_with
        The software that made the decisions, with versions.
    """

    control: ControlSetup
    made_with: dict[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """The state of the control loop after the step before it, `ControlLoop.state`."""

    control: Plain


Item = Setup | Step | State
"""In the order of the file: a setup, its first step, the state after it, more steps, the next state, ..."""
