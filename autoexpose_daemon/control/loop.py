"""One step of the control loop: a stereo pair in, a decision out."""

from __future__ import annotations

from collections import deque

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.image import ImagePreparation
from autoexpose_daemon.control.metrics import ExtremeShares, GradientMetric, mean_signal
from autoexpose_daemon.control.motion import FarnebackMotion
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies import PolicySetup, build_policy
from autoexpose_daemon.control.policy import Observation, PastStep
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import StereoPair

REMEMBERED_STEPS = 32
"""Half a second at 60 Hz: the slowest camera reported takes 0.4 s from write to effect."""

_DEFAULT_PARAMETERS = ControlParameters()


class ControlLoop:
    """Decides once per stereo pair, on the left frame, for both cameras.

    Targets are absolute: the level of this frame, as its metadata tell it, plus a change. So frames that were on
    their way while a setting was being written are never corrected twice.

    Parameters
    ----------
    policy_id
        One of `POLICY_IDS`.
    response
        Response function of the left camera.
    limits
        Bounds and increments that both cameras can take.
    start
        The setting the cameras start with; the policy `fixed` stays there.
    parameters
        Tuning.

    Raises
    ------
    ConfigurationError
        For a policy that does not exist or is not built yet.
    """

    def __init__(
        self,
        policy_id: str,
        response: ResponseFunction,
        limits: ExposureLimits,
        start: ExposureSetting,
        parameters: ControlParameters = _DEFAULT_PARAMETERS,
    ) -> None:
        self._limits = limits
        self._response = response
        self._metric = GradientMetric(parameters.metric_delta, parameters.metric_lambda)
        self._policy = build_policy(policy_id, PolicySetup(response, self._metric, start, parameters))
        self._preparation = ImagePreparation()
        self._right_preparation = ImagePreparation()
        self._shares = ExtremeShares(response)
        self._motion = FarnebackMotion(response)
        self._past: deque[PastStep] = deque(maxlen=REMEMBERED_STEPS)

    def step(self, pair: StereoPair) -> Decision:
        """Look at a pair and decide on the next setting of both cameras.

        The left frame must have at least 90x68 pixels. Left and right may have been taken with different settings:
        everything refers to the left frame and its own setting.

        Raises
        ------
        ConfigurationError
            For a frame that is too small.
        """
        observation = self._observe(pair)
        target = self._policy.decide(observation)
        level = self._limits.clamp_level(target.level)
        wished_us = target.exposure_time_us
        if wished_us is None:
            wished_us = self._policy.balance.exposure_time_us(level, observation.motion_px, self._limits)
        setting = self._limits.realise(level, wished_us)
        self._past.append(PastStep(setting, observation.setting.level, observation.metric, target.predicted_metric))
        return Decision(
            setting=setting,
            level=level,
            reason=target.reason if level == target.level else _limited(target.reason, target.level > level),
            metric=observation.metric,
            saturated_share=observation.saturated_share,
            black_share=observation.black_share,
            motion_px=observation.motion_px,
        )

    def _observe(self, pair: StereoPair) -> Observation:
        left = pair.left
        image = self._preparation.prepare(left.grey8())
        saturated_share, black_share = self._shares.measure(image)
        return Observation(
            image=image,
            right_image=None if pair.right is None else self._right_preparation.prepare(pair.right.grey8()),
            setting=left.setting,
            device_time_ns=left.device_time_ns,
            metric=self._metric.measure(image),
            mean=mean_signal(image, self._response),
            saturated_share=saturated_share,
            black_share=black_share,
            motion_px=self._motion.measure(image, left.pixels.shape[1], left.setting.level, left.device_time_ns),
            limits=self._limits,
            realised=self._decision_realised_by(left.setting),
        )

    def _decision_realised_by(self, setting: ExposureSetting) -> PastStep | None:
        """The latest remembered step that decided on `setting`."""
        return next((past for past in reversed(self._past) if past.setting.agrees_with(setting)), None)


def _limited(reason: str, above: bool) -> str:
    return f"{reason}; held: at {'upper' if above else 'lower'} limit"
