"""One step of the control loop: a set of frames in, a decision out."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from autoexpose_daemon.control.balance import Balance, whole_periods_us
from autoexpose_daemon.control.decision import Decision, Grounds
from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S, REMEMBERED_STEPS
from autoexpose_daemon.control.picture.image import median
from autoexpose_daemon.control.picture.motion import FarnebackMotion, Motion, TileMotion
from autoexpose_daemon.control.picture.steering import CellExposure
from autoexpose_daemon.control.policies.flicker import FlickerWatch
from autoexpose_daemon.control.policies.table import build_policy
from autoexpose_daemon.control.policy import ExposurePolicy, Look, Objective, Observation, PastStep, Target
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built, Plain, Stateful, restore, take
from autoexpose_daemon.control.step import StepInputs
from autoexpose_daemon.control.view import Compensation, View
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.response import ResponseFunction

REFERENCE_RATE_HZ = 60.0
"""Image speeds are in pixels per 1/60 s, the unit of the paper's tuning."""

_MOTIONS: dict[str, Callable[[ResponseFunction], Motion]] = {
    "tiles": TileMotion,
    "farneback": FarnebackMotion,
}

STATE_FORMAT = "autoexpose-control/15"
"""Format of `ControlSetup` and `ControlLoop.state` as plain data: a new number when names, types or meaning change."""


class ControlLoop(Stateful):
    """Decides once per set of frames, for cameras that are exposed together.

    Targets are absolute: the level of this frame, from its metadata, plus a change. So frames in flight while a setting
    is written are never corrected twice. Raises ConfigurationError for a policy that does not exist.
    The arguments of a `ControlSetup` do as well: ``ControlLoop("belief", responses, limits, start)``.
    """

    inputs: Built[StepInputs | None] = None  # what the latest step was given; None before the first
    metric_asked: Built[bool] = False  # whether decisions are to tell M_g even if the policy does not go by it
    _compensation: Built[Compensation | None] = None  # follows from the override
    _seen: Built[list[Look]]
    _past: deque[PastStep]
    _motions: dict[CameraName, Motion]
    _motion_camera: CameraName | None = None
    _motion_px: float = 0.0
    _policy: ExposurePolicy
    _flicker: FlickerWatch | None

    def __init__(self, setup: ControlSetup | str, *parts: Any, **named: Any) -> None:
        self.setup = setup if isinstance(setup, ControlSetup) else ControlSetup(setup, *parts, **named)
        setup, parameters = self.setup, self.setup.parameters
        self._limits = setup.limits
        self._metric = setup.metric
        self._policy = build_policy(setup)
        self._flicker = FlickerWatch(setup.responses) if parameters.flicker_hz is None else None
        self._views = {
            camera: View(response, setup.regions.get(camera), setup.vignettings.get(camera))
            for camera, response in setup.responses.items()
        }
        flow = self._policy.FLOW if parameters.motion == "policy" else parameters.motion
        self._motions = {camera: _MOTIONS[flow](response) for camera, response in setup.responses.items()}
        self._seen = []
        self._past = deque(maxlen=REMEMBERED_STEPS)

    @property
    def balance(self) -> Balance:
        """How the policy splits a level into time and gain."""
        return self._policy.balance

    @property
    def objective(self) -> Objective:
        """What the policy is judged by."""
        return self._policy.OBJECTIVE

    @property
    def uncounted(self) -> Mapping[CameraName, str]:
        """The cameras whose frames the policy does not count at present, and why, in words to follow "left camera"."""
        return self._policy.uncounted

    @property
    def grounds(self) -> Grounds | None:
        """What the latest decision rests on, to be drawn; None: none yet, or the policy has no belief."""
        return self._policy.grounds

    @property
    def light_belief(self) -> float | None:
        """How far the latest decision believed the light ahead, 0 to 1; None: it knew none, or the policy uses none."""
        return None if self.inputs is None or self.inputs.light_ahead is None else self._policy.light_belief

    @property
    def steered(self) -> bool:
        """Whether the latest decision used where consumers track: not if another setting was asked for."""
        if self.inputs is None or self.inputs.steering is None:
            return False
        return self._policy.STEERED and not (self.inputs.override.shot or self.inputs.override.held)

    @property
    def cell_exposures(self) -> dict[CameraName, CellExposure]:
        """How the frames of the latest step are exposed: for reports on them."""
        return {look.camera: CellExposure.of(look.image, look.response) for look in self._seen}

    @property
    def flicker_hz(self) -> float | None:
        """The flicker found in the light, flashes per second; None: none, or it is not looked for."""
        return None if self._flicker is None else self._flicker.flicker_hz

    def state(self) -> dict[str, Plain]:
        """Everything besides `setup` that later decisions depend on, as plain data (a copy)."""
        return take(self)

    def restore(self, state: Plain) -> None:
        """Continue from the `state` of a loop with the same setup; ValueError if it does not fit."""
        restore(self, state)

    def check_ev(self, ev_stops: float) -> None:
        """Raise ConfigurationError for an EV compensation that the policy cannot take; `step` does not check."""
        if ev_stops > 0 and self._policy.compensated == "darker":
            raise ConfigurationError(
                f"policy {self.setup.policy_id} takes no EV compensation above 0, since it would go by what that "
                "saturates: give 0 or less, or choose another policy"
            )

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        """Look at a pair, alone or with whatever else is known, and decide on the next setting of its cameras.

        Frames must have at least 90x68 pixels, colour mosaics 180x136. They may have been taken with different
        settings: everything refers to the reference frame, the first that is not `uncounted`, and to its own setting.
        Raises ConfigurationError for a frame that is too small, a region or a vignetting that does not fit the
        frames, or an angular rate beyond `FASTEST_TURN_RAD_S` or without a focal length.
        """
        self.inputs = inputs = StepInputs.of(inputs)
        override = inputs.override
        self._compensate(override.ev_stops)
        looks = self._seen = self._looks(inputs.pair)
        observation = self._observe(inputs, looks)
        target = None if override.unseen else self._policy.decide(observation)
        asked = override.shot or override.held
        if asked is not None:
            setting = self._limits.nearest(asked)
            level, reason = setting.level, override.reason
        else:
            assert target is not None, "what is unseen is held"
            level = self._limits.clamp_level(target.level + override.ev_stops)
            setting = self._split(target, level, observation)
            reason = _in_words(target, override.ev_stops, level)
        self._remember(observation, None if asked is not None else target, setting, level)
        metric, saturated, black = self._figures(looks[0], observation)
        return Decision(setting, level, reason, metric, saturated, black, observation.motion_px)

    def _compensate(self, ev_stops: float) -> None:
        if ev_stops == 0.0 or self._policy.compensated == "targets":
            self._compensation = None
        elif self._compensation is None or self._compensation.stops != ev_stops:
            self._compensation = Compensation(ev_stops, self.setup.responses, self._limits)

    def _looks(self, pair: FrameSet) -> list[Look]:
        """What is seen of each frame, the reference first."""
        uncounted = self.uncounted
        cameras = sorted(pair.frames, key=lambda each: each in uncounted)  # a stable sort
        return [self._views[each].look(each, pair.frames[each], filtered=self._policy.FILTERED) for each in cameras]

    def _observe(self, inputs: StepInputs, looks: list[Look]) -> Observation:
        """What the policy is shown, the first look being at the reference frame."""
        frame = inputs.pair.frames[looks[0].camera]
        limits, setting = self._limits, frame.setting
        if self._compensation is not None:
            limits, setting = self._compensation.limits, self._compensation.setting(setting)
            looks = [self._compensation.look(look) for look in looks]
        look = looks[0]
        if self._flicker is not None:
            self._flicker.see(look, setting, frame.device_time_ns)
        saturated_share, black_share = self._views[look.camera].shares.measure(look.image, look.weights)
        return Observation(
            looks=looks,
            setting=setting,
            metric=self._metric_of(look),
            saturated_share=saturated_share,
            black_share=black_share,
            motion_px=self._speed_px(look, frame, setting, inputs.angular_rate_rad_s),
            limits=limits,
            inputs=inputs,
            past=self._past,
            flicker_hz=self.flicker_hz,
            ev_stops=0.0 if self._compensation is not None else inputs.override.ev_stops,
        )

    def _split(self, target: Target, level: float, observation: Observation) -> ExposureSetting:
        """Time and gain for a level (stops)."""
        wanted_us = target.exposure_time_us
        if wanted_us is None:
            wanted_us = self._policy.balance.exposure_time_us(level, observation.motion_px, self._limits)
            if observation.flicker_hz is not None:
                wanted_us = whole_periods_us(wanted_us, level, self._limits, observation.flicker_hz)
        return self._limits.realise(level, wanted_us)

    def _remember(
        self, observation: Observation, target: Target | None, setting: ExposureSetting, level: float
    ) -> None:
        """Keep what was asked of the cameras, in the terms of the policy; `target` None: the policy was not asked.

        From this the policy recognises what its own targets led to, and learns the delay of the loop.
        """
        if self._compensation is not None:
            setting, level = self._compensation.setting(setting), level - self._compensation.stops
        if target is None or observation.ev_stops:
            target = Target(level, target.reason if target else "")
        self._past.append(PastStep(setting, observation.setting.level, observation.metric, target))

    def _metric_of(self, look: Look) -> float | None:
        """M_g of a frame, if the policy or anybody else asks for it."""
        if self._policy.FILTERED:
            return self._metric.measure(look.image, look.weights)
        return self._metric.measure(median(look.unfiltered), look.weights) if self.metric_asked else None

    def _figures(self, look: Look, observation: Observation) -> tuple[float | None, float, float]:
        """Metric, saturated and black share of the reference frame as it is."""
        if self._compensation is None:
            return observation.metric, observation.saturated_share, observation.black_share
        shares = self._views[look.camera].shares.measure(look.image, look.weights)
        return self._metric_of(look), *shares

    def _speed_px(self, look: Look, frame: Frame, setting: ExposureSetting, angular_rate_rad_s: float | None) -> float:
        """Mean speed of image points, pixels of full resolution per 1/60 s."""
        if angular_rate_rad_s is None:
            return self._flow_px(look, frame, setting)
        focal_length_px = self.setup.parameters.focal_length_px
        if focal_length_px is None:
            raise ConfigurationError("an angular rate needs control.focal_length_px: give the focal length in pixels")
        if not abs(angular_rate_rad_s) <= FASTEST_TURN_RAD_S:
            raise ConfigurationError(
                f"the angular rate is {angular_rate_rad_s} rad/s: give at most {FASTEST_TURN_RAD_S:g} rad/s"
            )
        for motion in self._motions.values():
            motion.forget()
        self._motion_camera = None
        self._motion_px = abs(angular_rate_rad_s) * focal_length_px / REFERENCE_RATE_HZ
        return self._motion_px

    def _flow_px(self, look: Look, frame: Frame, setting: ExposureSetting) -> float:
        """The speed from optical flow; the last one if flow takes over from another camera or from angular rates.

        Flow then has no recent frame. It is not measured across frames with an angular rate either: it saturates if
        they are far apart.
        """
        motion = self._motions[look.camera]
        speed_px = motion.measure(look.image, frame.pixels.shape[1], setting.level, frame.device_time_ns)
        if speed_px is None:
            speed_px = 0.0 if self._motion_camera == look.camera else self._motion_px
        self._motion_camera, self._motion_px = look.camera, speed_px
        return speed_px


def _in_words(target: Target, ev_stops: float, level: float) -> str:
    """The reason for a target, and what became of it."""
    wanted = target.level + ev_stops
    reason = f"{target.reason}; EV {ev_stops:+g}" if ev_stops else target.reason
    return reason if level == wanted else f"{reason}; held at the {'brightest' if wanted > level else 'darkest'} limit"
