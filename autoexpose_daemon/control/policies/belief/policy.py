"""Policy `belief`: what light the scene sends is remembered, and the exposures of the next frames are planned by it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.grounds import Grounds
from autoexpose_daemon.control.light_ahead import LightAhead
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, contrast
from autoexpose_daemon.control.metrics.information import blur_length_px, sharper
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.belief.cadence import Cadence
from autoexpose_daemon.control.policies.belief.optics import Optics
from autoexpose_daemon.control.policies.belief.plan import HORIZON, Prospects, values
from autoexpose_daemon.control.policies.belief.scene_belief import BIN, SceneBelief
from autoexpose_daemon.control.policies.fisher_map.balance import BlurPhotonBalance, bounded, fitted, times_of_levels
from autoexpose_daemon.control.policies.metric_map.forecast import Forecast
from autoexpose_daemon.control.policies.metric_map.foresight import Foresight
from autoexpose_daemon.control.policies.metric_map.loop_delay import LoopDelay
from autoexpose_daemon.control.policy import ExposurePolicy, Look, Objective, Observation, PolicySetup, Target
from autoexpose_daemon.control.registration import LightChange, Registration
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits, linear_gain
from drivers.frames import Side
from drivers.python310 import Self

Array = NDArray[np.float64]

SERVED_FRAMES = 120.0
"""Frames for which a camera at rest will have use of what a look reveals ..."""

PASSING_PX = 50.0
"""... and fewer for one that moves: half if the picture moves by 50/120 px per 1/60 s, one if by 50 px."""

LARGE_CHANGE = 0.5
"""Stops. Flow across a larger change is wrong; after a larger change of light that cannot be measured, nothing is
believed any more."""

STILL_PX, SLOW_PX = 1.0, 8.0
"""Pixels per 1/60 s: less is no motion, and from 8 on content causes slopes that look like ramps of the light."""

MOST_MOVED = 0.8
"""Of a cell from frame to frame: something always stays."""

VIEW_STOPS = 2.0
"""Where the levels that served on an earlier drive changed by so much more than the light did, which changed by less,
it was the view that changed, as at a window: that is planned for like a change of light."""

VOTE_S = 0.5
"""Time constant with which a camera that shows nothing new loses its vote."""

LEAST_CAMERA = 0.5
"""A camera's best counts as at least this share of the other's: one that sees hardly anything does not decide."""


class Belief(ExposurePolicy):
    """Remembers what light the scene sends, and plans exposures that make successive frames worth most to each other.

    What each camera's scene is like is a `SceneBelief`; it tells what frames of any exposure time and gain would be
    worth. A plan over the next frames weighs that against the changes of brightness on the way, and against what
    a look into white or black would reveal.
    """

    STATE: ClassVar[tuple[str, ...]] = (
        "registration", "forecast", "foresight", "cadence", "latency", "beliefs", "motion_px", "seen_ns",
    )  # fmt: skip
    OBJECTIVE: ClassVar[Objective] = "information"
    STEERED: ClassVar[bool] = True
    compensated = "targets"
    registration: Registration
    forecast: Forecast
    foresight: Foresight
    cadence: Cadence
    latency: LoopDelay
    beliefs: dict[Side, SceneBelief]
    motion_px: float
    seen_ns: int | None

    def __init__(
        self, responses: Mapping[Side, ResponseFunction], balance: Balance, noise: SensorNoise, native: bool
    ) -> None:
        self.balance = balance
        self._native = native
        self.registration = Registration(responses)
        self.forecast = Forecast()
        self.foresight = Foresight()
        self.cadence = Cadence()
        self.latency = LoopDelay()
        self.beliefs = {side: SceneBelief(Optics(response, noise)) for side, response in responses.items()}
        self.motion_px = 0.0
        self.seen_ns = None
        self._planned_for: tuple[float, Prospects, Array] | None = None

    @classmethod
    def build(cls, setup: PolicySetup) -> Self:
        """With its own balance, unless another is configured."""
        noise = SensorNoise(setup.parameters.full_well_e, setup.parameters.read_noise_e)
        return cls(setup.responses, setup.balance(BlurPhotonBalance(noise)), noise, setup.metric.native)

    def balance_for(self, look: Look) -> Balance:
        """Its own balance follows what is left of blur and noise in the shrunk image."""
        return fitted(self.balance, look)

    @property
    def light_belief(self) -> float | None:
        """How far light ahead is believed, 0 to 1."""
        return self.foresight.belief

    @property
    def uncounted(self) -> dict[Side, str]:
        """The cameras that show nothing, unless that is all of them."""
        found = {side: remark for side, belief in self.beliefs.items() if (remark := belief.remark())}
        return found if len(found) < len(self.beliefs) else {}

    @property
    def grounds(self) -> Grounds | None:
        """What the latest decision rests on."""
        if self._planned_for is None:
            return None
        level, prospects, promised = self._planned_for
        scenes = {side: scene for side, belief in self.beliefs.items() if (scene := belief.histogram()) is not None}
        return Grounds(scenes, level, prospects.levels.tolist(), prospects.worth[0].tolist(), promised.tolist())

    def decide(self, observation: Observation) -> Target:
        """The first level of the best plan, for the frame that will show this decision."""
        self.balance = bounded(self.balance, observation, self.forecast)
        self.latency.see(observation.setting.level, (past.setting.level for past in observation.past))
        self._see(observation)
        return self._planned(observation)

    def _see(self, observation: Observation) -> None:
        """Take in what the frames show."""
        seen = [(look, self._contrast(look)) for look in observation.looks]
        news = [(look, each) for look, each in seen if self.beliefs[look.side].is_news(each)]
        showing = [each for each in news if each[1].count[:, 1:-1].any()]
        light = self._light_change(*(showing or seen)[0], observation)
        seconds = 0.0 if self.seen_ns is None else (observation.device_time_ns - self.seen_ns) * 1e-9
        self.seen_ns = observation.device_time_ns
        self.forecast.add(light.stops, self.cadence.frames(seconds))
        if not light.measured and abs(light.stops) > LARGE_CHANGE:
            for belief in self.beliefs.values():
                belief.forget()
        for belief in self.beliefs.values():
            belief.pass_time(seconds, self._moved_cells(observation.looks[0], seconds), light.stops)
        for look, each in news:
            setting = look.setting or observation.setting
            self.beliefs[look.side].see(
                each, setting.level, linear_gain(setting.gain_db), look.averaged, look.relative_light
            )

    def _contrast(self, look: Look) -> Contrast:
        return contrast(look.unfiltered, self.beliefs[look.side].optics.bins, look.weights, self._native)

    def _light_change(self, look: Look, seen: Contrast, observation: Observation) -> LightChange:
        """By how much the light has changed; and is the motion that was measured to be believed?"""
        level_change = observation.setting.level - self.registration.previous_level
        light = self.registration.change(look, observation.setting.level) or LightChange(0.0, measured=False)
        if not light.measured:  # no less than that if the picture is white, no more if it is black
            white = seen.count[:, -1].sum() > seen.count[:, 0].sum()
            light = LightChange(max(light.stops, 0.0) if white else min(light.stops, 0.0), measured=False)
        calm = light.measured and max(abs(light.stops), abs(level_change)) < LARGE_CHANGE
        if calm or not observation.by_flow:
            self.motion_px = observation.motion_px
        return light

    def _moved_cells(self, look: Look, seconds: float) -> float:
        """By which share of a cell the picture has moved."""
        if self.motion_px < STILL_PX:
            return 0.0
        cell_px = look.image.shape[1] / CELLS
        return float(min(blur_length_px(self.motion_px, 1e6 * seconds, look.scale) / cell_px, MOST_MOVED))

    def _planned(self, observation: Observation) -> Target:
        levels, (paths, chances) = _levels(observation.limits), self._light_ahead(observation.light_ahead)
        shown = levels + paths[:, 1:, None]
        as_now = _reaching(levels, float(np.abs(paths).max()))
        worth, look = self._prospects(as_now, observation)
        worths = np.tensordot(chances, np.interp(shown, as_now, worth), 1)
        looks = chances @ np.interp(shown[:, 0], as_now, look)
        light = chances @ paths
        level, past = observation.setting.level, observation.past
        before = past[-1].setting.level if self.latency.frames > 1 and past else level
        before -= observation.ev_stops
        prospects = Prospects(levels, worths, light, before, looks)
        promised = values(prospects)
        self._planned_for = level, prospects, promised
        best = int(promised.argmax())
        steered = "" if observation.steering is None else "; steered"
        return Target(float(levels[best]), _reason(levels[best] - before, looks[best]) + steered)

    def _prospects(self, levels: Array, observation: Observation) -> tuple[Array, Array]:
        """What levels are worth in the present light, and for what they would reveal, both of shape (n,).

        Where consumers steer, what the favoured parts of the picture are worth, as far as the whole can afford it.
        """
        reachable = np.clip(levels, observation.limits.darkest.level, observation.limits.brightest.level)
        times_us = times_of_levels(self.balance, reachable, self.motion_px, observation)
        now_us, scale = observation.setting.exposure_time_us, observation.looks[0].scale
        sharp = np.sqrt(sharper(self.motion_px, now_us, times_us, scale))
        gains = np.exp2(reachable) / times_us
        beliefs = {side: belief for side, belief in self.beliefs.items() if belief.by_cell.any()}
        outlooks = [belief.outlook(levels, gains) for belief in beliefs.values()]
        votes = self._votes(beliefs.values())
        shares, best = _shares_of_best([outlook.expected() for outlook in outlooks], sharp, votes)
        worth = shares.sum(axis=0)
        now = int(worth.argmax())
        look = np.zeros(levels.size)
        for outlook, vote, share, one in zip(outlooks, votes, shares, best, strict=True):
            information = sharp * outlook.information()
            if_right = worth - share + vote * information / np.maximum(information.max(axis=1), one)[:, None]
            gained = if_right.max(axis=1) - if_right[:, now]
            look += (outlook.probability * gained) @ outlook.revealed
        served = SERVED_FRAMES / (1.0 + SERVED_FRAMES * min(self.motion_px / PASSING_PX, 1.0))
        if observation.steering is not None:
            favours = [observation.steering.weights(side, CELLS, CELLS).ravel() for side in beliefs]
            favoured = [outlook.expected(each) for outlook, each in zip(outlooks, favours, strict=True)]
            afforded = worth > (1.0 - STEERING_SHARE) * worth.max()
            worth = np.where(afforded, _shares_of_best(favoured, sharp, votes)[0].sum(axis=0), 0.0)
        return worth, served * look

    @staticmethod
    def _votes(beliefs: Collection[SceneBelief]) -> Array:
        """The say of each camera; they sum to 1. A belief that grows old loses it."""
        ages_s = np.array([belief.age_s for belief in beliefs])
        votes = np.exp((ages_s.min() - ages_s) / VOTE_S)
        return np.asarray(votes / votes.sum())

    def _light_ahead(self, told: LightAhead | None) -> tuple[Array, Array]:
        """Paths that the light may take, and their probabilities, which sum to 1.

        Stops by which it will have risen until the last frame under way, and each of those planned, shape
        (paths, HORIZON + 1): as its own pattern has it, and as an earlier drive saw it from each place where the rig
        may be.
        """
        steady, delay = self.motion_px < SLOW_PX, self.latency.frames
        frames = np.arange(delay - 1, delay + HORIZON)
        by_itself = np.array([[self.forecast.ahead(int(frame), steady=steady) for frame in frames]])
        if told is None:
            self.foresight.rest()
            return by_itself, np.ones(1)
        share = self.foresight.weigh(told, self.forecast.changes)
        here = self.foresight.here[:, None]
        risen, served = (
            stops.take(here + frames, mode="clip") - stops.take(here, mode="clip")
            for stops in (np.array(told.risen), -np.array(told.levels))
        )
        turned = (np.abs(risen) < VIEW_STOPS) & (np.abs(served - risen) > VIEW_STOPS)
        again = np.where(turned, served, risen)
        return np.concatenate([by_itself, again]), np.append(1.0 - share, share * self.foresight.places)


def _shares_of_best(expected: Sequence[Array], sharp: Array, votes: Array) -> tuple[Array, Array]:
    """What each camera expects of levels, (cameras, n), as shares of its best; and what counts as that, (cameras,).

    So a lamp that one camera sees does not outvote the other.
    """
    information = sharp * np.array(expected)
    best = information.max(axis=1)
    best = np.maximum(best, max(LEAST_CAMERA * best.max(), 1e-9))
    return votes[:, None] * information / best[:, None], best


def _reason(change: float, look: float) -> str:
    if look > 0.5:
        return f"looks at {'more' if change > 0 else 'less'} exposure"
    if abs(change) < BIN / 2:
        return "held: the best of the plan"
    return f"plan: {'more' if change > 0 else 'less'} exposure"


def _levels(limits: ExposureLimits) -> Array:
    low, high = limits.darkest.level, limits.brightest.level
    return np.linspace(low, high, max(round((high - low) / BIN), 1) + 1)


def _reaching(levels: Array, stops: float) -> Array:
    """The levels continued at both ends by at least so many stops."""
    step = float(levels[1] - levels[0]) or BIN  # both limits may be the same
    more = step * np.arange(1, np.ceil(stops / step) + 1)
    return np.concatenate([levels[0] - more[::-1], levels, levels[-1] + more])
