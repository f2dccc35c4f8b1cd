"""Policy `belief`: what light the scene sends is remembered, and the exposures of the next frames are planned by it."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.control.metrics import extension as _native
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, SensorNoise, contrast
from autoexpose_daemon.control.picture.motion import PER_US, blur_length_px
from autoexpose_daemon.control.picture.steering import STEERING_SHARE
from autoexpose_daemon.control.policies.belief.balance import BlurPhotonBalance, bounded, fitted, times_of_levels
from autoexpose_daemon.control.policies.belief.forecast import Cadence, Forecast, Foresight, LoopDelay
from autoexpose_daemon.control.policies.belief.scene_belief import (
    BIN,
    HYPOTHESES,
    SILENT_S,
    Optics,
    Outlook,
    SceneBelief,
    shows,
)
from autoexpose_daemon.control.policy import ExposurePolicy, Look, Objective, Observation, Target
from autoexpose_daemon.control.registration import LightChange, LightRegistration
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Built
from imaging.exposure import ExposureLimits, linear_gain
from imaging.frames import CameraName

Array = NDArray[np.float64]

BRIGHTNESS_LOSS = 0.7
"""A frame is worth exp(-0.7) to the one before it, by which it is found or aligned, if its image is a stop brighter or
darker than that."""

LOST_BELOW, LOST_COST = 0.1, 2.0
"""A frame worth less than this to the one before it is lost to consumers, and costs as much as so many of the best are
worth: what it would have shown is bridged by a guess. A look by eight stops loses two frames, one by two stops none."""

HORIZON = 8
"""Frames that a plan looks ahead: fewer do not move in time, from 16 on plans jitter."""


@dataclass(frozen=True, slots=True, eq=False)
class Prospects:
    """What the next frames can be."""

    levels: Array  # exposure levels, stops, shape (n,), ascending, all the same `step` apart
    step: float  # of the levels, stops
    # how many of them at either end cannot be taken: what they are worth now, others are worth in other light
    beyond: int
    # what each level would be worth in the present light, and what for what it reveals, shape (n,)
    worth: Array
    look: Array
    # stops by which the light will have risen from now until the frame before those planned, and each of them, on the
    # paths that it may take, shape (paths, frames + 1)
    light: Array
    chances: Array  # of the paths, shape (paths,); they sum to 1
    before: float  # level of the frame before those planned, which is under way

    def values(self) -> tuple[Array, Array]:
        """What the levels that can be taken promise for the first frame, if the best follows; and of that, for looks.

        The sum over frames of what each is worth, times what the change of its image's brightness leaves of that, less
        what it costs if that is next to nothing.
        """
        values, looks = np.empty((2, self.levels.size - 2 * self.beyond))
        _native.plan_frames(
            self.worth, self.look, self.light, self.chances, self.levels[self.beyond], self.step, self.before,
            BRIGHTNESS_LOSS, LOST_BELOW, LOST_COST, values, looks,
        )  # fmt: skip
        return values, looks


SERVED_FRAMES = 120.0
"""Frames for which a camera at rest will have use of what a look reveals ..."""

PASSING_PX = 50.0
"""... and fewer for one that moves: half if the picture moves by 50/120 px per 1/60 s, one if by 50 px."""

HOPE = 1.5
"""What is hidden may hold more than what is beside it: looks are valued as if it were worth so many times as much."""

LARGE_CHANGE = 0.5
"""Stops. If the light changes by more and that cannot be measured, all that was believed is dropped."""

LOST_AFTER = 1.5
"""A camera that was silent for so many times as long as the other has lost a frame: it does not say how the light has
changed since the latest."""

STILL_PX, SLOW_PX = 1.0, 8.0
"""Pixels per 1/60 s: less is no motion, and from 8 on content causes slopes that look like ramps of the light, now and
on an earlier drive."""

MOST_MOVED = 0.8
"""Of a cell from frame to frame: something always stays."""

LEAST_CAMERA = 0.5
"""A camera's best counts as at least this share of the other's: one that sees hardly anything does not decide."""


class Belief(ExposurePolicy):
    """Remembers what light the scene sends, and plans exposures that make successive frames worth most to each other.

    What each camera's scene is like is a `SceneBelief`; it tells what frames of any exposure time and gain would be
    worth. A plan over the next frames weighs that against the changes of brightness on the way, and against what
    a look into white or black would reveal.
    """

    OBJECTIVE: ClassVar[Objective] = "information"
    STEERED: ClassVar[bool] = True
    FILTERED: ClassVar[bool] = False
    compensated = "targets"
    registrations: dict[CameraName, LightRegistration]
    forecast: Forecast
    foresight: Foresight
    cadence: Cadence
    latency: LoopDelay
    beliefs: dict[CameraName, SceneBelief]
    seen_ns: dict[CameraName, int]
    _planned_for: Built[tuple[float, Prospects, Array] | None] = None

    def __init__(self, setup: ControlSetup) -> None:
        noise = SensorNoise(setup.parameters.full_well_e, setup.parameters.read_noise_e)
        self.balance = setup.balance(BlurPhotonBalance(noise))
        self.registrations = {camera: LightRegistration({camera: each}) for camera, each in setup.responses.items()}
        self.forecast = Forecast()
        self.foresight = Foresight()
        self.cadence = Cadence()
        self.latency = LoopDelay()
        self.beliefs = {camera: SceneBelief(Optics(each, noise)) for camera, each in setup.responses.items()}
        self.seen_ns = {}

    def balance_for(self, look: Look) -> Balance:
        """Its own balance follows what is left of blur and noise in the shrunk image."""
        return fitted(self.balance, look)

    @property
    def light_belief(self) -> float | None:
        """How far light ahead is believed, 0 to 1."""
        return self.foresight.belief

    @property
    def uncounted(self) -> dict[CameraName, str]:
        """The cameras that show nothing, unless that is all of them."""
        found = {camera: reason for camera, belief in self.beliefs.items() if (reason := belief.why_uncounted())}
        return found if len(found) < len(self.beliefs) else {}

    @property
    def grounds(self) -> Grounds | None:
        """What the latest decision rests on."""
        if self._planned_for is None:
            return None
        level, prospects, promised = self._planned_for
        scenes = {camera: scene for camera, belief in self.beliefs.items() if (scene := belief.histogram()) is not None}
        taken = slice(prospects.beyond, prospects.beyond + promised.size)
        return Grounds(
            scenes, level, prospects.levels[taken].tolist(), prospects.worth[taken].tolist(), promised.tolist()
        )

    def decide(self, observation: Observation) -> Target:
        """The first level of the best plan, for the frame that will show this decision."""
        self.balance = bounded(self.balance, observation, self.forecast)
        self.latency.see(observation.setting.level, (past.setting.level for past in observation.past))
        self._see(observation)
        return self._planned(observation)

    def _see(self, observation: Observation) -> None:
        """Take in what the frames show."""
        seen = [
            (look, contrast(look.unfiltered, self.beliefs[look.camera].optics.bins, look.weights))
            for look in observation.looks
        ]
        news = [(look, each) for look, each in seen if self.beliefs[look.camera].is_news(each)]
        since_s = self._since_before_s(observation.looks)
        seconds = min(since_s.values())
        showing = [(look, each) for look, each in news if shows(each.count)] or seen[:1]
        unbroken = min(showing, key=lambda one: since_s[one[0].camera] > LOST_AFTER * seconds)
        light = self._light_change(*unbroken, observation)
        self.forecast.add(light.stops, self.cadence.frames(seconds))
        if not light.measured and abs(light.stops) > LARGE_CHANGE:
            for belief in self.beliefs.values():
                belief.forget()
        for belief in self.beliefs.values():
            belief.pass_time(seconds, _moved_cells(observation, seconds), light.stops)
        for look, each in news:
            setting = look.setting or observation.setting
            self.beliefs[look.camera].see(
                each, setting.level, linear_gain(setting.gain_db), look.averaged, look.relative_light
            )

    def _since_before_s(self, looks: Sequence[Look]) -> dict[CameraName, float]:
        """The time since each camera's frame before, by its own clock; 0 for its first, and if the clock restarts."""
        now_ns = {look.camera: look.device_time_ns for look in looks}
        since_ns = {camera: time_ns - self.seen_ns.get(camera, time_ns) for camera, time_ns in now_ns.items()}
        self.seen_ns |= now_ns
        return {camera: max(interval_ns, 0) * 1e-9 for camera, interval_ns in since_ns.items()}

    def _light_change(self, look: Look, seen: Contrast, observation: Observation) -> LightChange:
        """By how much the light has changed for a camera."""
        levels = {each.camera: (each.setting or observation.setting).level for each in observation.looks}
        light = self.registrations[look.camera].change(look, levels[look.camera]) or LightChange(0.0, measured=False)
        for other in observation.looks:
            if other is not look:
                self.registrations[other.camera].remember(other, levels[other.camera])
        if not light.measured:  # no less than that if the picture is white, no more if it is black
            white = seen.count[:, -1].sum() > seen.count[:, 0].sum()
            return LightChange(max(light.stops, 0.0) if white else min(light.stops, 0.0), measured=False)
        return light

    def _planned(self, observation: Observation) -> Target:
        light, chances = self._light_ahead(observation)
        levels, step, beyond = _levels(observation.limits, float(np.abs(light).max()))
        worth, look = self._prospects(levels, observation)
        level, past = observation.setting.level, observation.past
        before = past[-1].setting.level if self.latency.frames > 1 and past else level
        before -= observation.ev_stops
        prospects = Prospects(levels, step, beyond, worth, look, light, chances, before)
        values, looks = prospects.values()
        self._planned_for = level, prospects, values
        best = int(values.argmax())
        wanted = min(float(levels[beyond + best]), observation.limits.brightest.level)
        reason = _reason(wanted - before, looks[best], _limit(wanted, observation.limits))
        reason += "" if observation.inputs.steering is None else "; steered"
        faults = "".join(f"; {camera} camera {fault}" for camera, fault in self.uncounted.items())
        return Target(wanted, reason + faults)

    def _prospects(self, levels: Array, observation: Observation) -> tuple[Array, Array]:
        """What levels are worth in the present light, and for what they would reveal, both of shape (n,).

        Where consumers steer, what the favoured parts of the picture are worth, as far as the whole can afford it.
        """
        reachable = levels.clip(observation.limits.darkest.level, observation.limits.brightest.level)
        times_us = times_of_levels(self.balance, reachable, observation)
        now_us, scale = observation.setting.exposure_time_us, observation.looks[0].scale
        gains, sharp = np.empty((2, levels.size))
        _native.split_levels(reachable, times_us, observation.motion_px * PER_US / scale, now_us, gains, sharp)
        steering = observation.inputs.steering
        beliefs = {name: belief for name, belief in self.beliefs.items() if belief.by_cell.any()}
        information, favoured, revealed = np.empty((3, len(beliefs), HYPOTHESES, levels.size))
        probability = np.empty((len(beliefs), HYPOTHESES))
        for camera, (name, belief) in enumerate(beliefs.items()):
            favours = None if steering is None else steering.weights(name, CELLS, CELLS)
            outlook = Outlook(probability[camera], information[camera], favoured[camera], revealed[camera])
            belief.look_out(levels, gains, favours, outlook)
        served = SERVED_FRAMES / (1.0 + SERVED_FRAMES * min(observation.motion_px / PASSING_PX, 1.0))
        worth, look = np.empty((2, levels.size))
        _native.weigh_levels(
            information, None if steering is None else favoured, revealed, probability, self._votes(beliefs.values()),
            sharp, HOPE, LEAST_CAMERA, STEERING_SHARE, served, worth, look,
        )  # fmt: skip
        return worth, look

    @staticmethod
    def _votes(beliefs: Collection[SceneBelief]) -> Array:
        """The say of each camera; they sum to 1. A belief that grows old loses it."""
        youngest_s = min(belief.age_s for belief in beliefs)
        votes = np.array([math.exp((youngest_s - belief.age_s) / SILENT_S) for belief in beliefs])
        return np.asarray(votes / votes.sum())

    def _light_ahead(self, observation: Observation) -> tuple[Array, Array]:
        """Paths that the light may take, and their probabilities, which sum to 1.

        Stops by which it will have risen until the last frame under way, and each of those planned, shape
        (paths, HORIZON + 1): as its own pattern has it, and as an earlier drive saw it from each place where the rig
        may be.
        """
        steady, delay = observation.motion_px < SLOW_PX, self.latency.frames
        told = observation.inputs.light_ahead if steady else None
        frames = range(delay - 1, delay + HORIZON)
        by_itself = np.array([self.forecast.path(frames, steady=steady)])
        if told is None:
            self.foresight.rest()
            return by_itself, np.ones(1)
        share = self.foresight.weigh(told, self.forecast.changes)
        risen, here = np.array(told.risen), self.foresight.here[:, None]
        rises = risen.take(here + np.array(frames), mode="clip") - risen.take(here, mode="clip")
        return np.concatenate([by_itself, rises]), np.append(1.0 - share, share * self.foresight.places)


def _moved_cells(observation: Observation, seconds: float) -> float:
    """By which share of a cell the picture has moved."""
    if observation.motion_px < STILL_PX:
        return 0.0
    look = observation.looks[0]
    cell_px = look.image.shape[1] / CELLS
    return float(min(blur_length_px(observation.motion_px, 1e6 * seconds, look.scale) / cell_px, MOST_MOVED))


def _limit(level: float, limits: ExposureLimits) -> str:
    """The limit that a level is at, in a word; empty: none."""
    if level >= limits.brightest.level:
        return "brightest"
    return "darkest" if level <= limits.darkest.level else ""


def _reason(change: float, look: float, limit: str) -> str:
    if look > 0.5:
        return f"looks at {'more' if change > 0 else 'less'} exposure"
    if abs(change) < BIN / 2:
        return f"held at the {limit} limit" if limit else "held: the best of the plan"
    return f"plan: {'more' if change > 0 else 'less'} exposure"


@lru_cache(maxsize=1)
def _levels(limits: ExposureLimits, further: float) -> tuple[Array, float, int]:
    """Levels within the limits and so many stops further either way, their step, and how many are beyond each limit."""
    low, high = limits.darkest.level, limits.brightest.level
    steps = round((high - low) / BIN)
    step = (high - low) / steps if steps else BIN
    beyond = math.ceil(further / step) + (not steps)  # the limits may leave a single level, but that has no step
    return low + step * np.arange(-beyond, steps + beyond + 1, dtype=np.float64), step, beyond
