"""What the map policies share: a map of a predicted objective over absolute exposure level, fused over frames."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.balance import Balance
from autoexpose_daemon.control.policies.belief.forecast import Forecast
from autoexpose_daemon.control.policies.belief.foresight import FORGOTTEN_FRAMES, Foresight
from autoexpose_daemon.control.policies.belief.loop_delay import LoopDelay
from autoexpose_daemon.control.policies.metric_map.memory import CELL, TRUSTED_RISE, MetricMemory, Sighting
from autoexpose_daemon.control.policies.metric_map.search import (
    LONGEST_PROBE,
    Probes,
    dark_jump,
    plateau_centre,
    value_at,
    within_reason,
    worth_of_levels,
)
from autoexpose_daemon.control.policies.metric_map.served_before import Prospect, ServedBefore
from autoexpose_daemon.control.policies.metric_map.view import NO_CHANGE, MetricView
from autoexpose_daemon.control.policies.metric_map.votes import REMARKS, Votes
from autoexpose_daemon.control.policy import ExposurePolicy, Observation, Target
from autoexpose_daemon.control.registration import Registration
from calibration.response import ResponseFunction
from drivers.exposure import ExposureLimits
from drivers.frames import SIDES, Side

BIN = 0.25
"""Stops between the levels that are compared."""

HOLD_GAIN, HOLD_GAIN_FOLLOWING = 0.015, 0.005
"""Share by which the objective must promise to rise before the target is moved: with the camera still, and while the
light follows a ramp or a period, when holding only means lagging. In motion: `ExposureMap.HOLD_GAIN_MOVING`."""

MOVING_PX = 2.0
"""Flow (pixels per 1/60 s) from which the camera counts as moving; noise and flicker of a still one stay below."""

SLOW_PX = 8.0
"""Flow up to which slopes of brightness are attributed to the light, and led."""

FLOW_STOPS = 0.5
"""Flow across a greater change of light or exposure is an error of the flow: the motion known before still counts."""

AGE_PER_PX = 0.02
AGE_PER_STOP = 0.1
"""Stops by which sightings count as farther for each pixel of motion, and for each stop of light."""

LEAST_DENSITY = 0.01
DENSITY_DECAY = 0.98
"""Metric per unsaturated pixel that a good exposure recently had: at least this, and halved in half a second."""

BLIND_SHARE = 0.8
"""Saturated share above which a darker sighting, however far, says more about what lies between."""

LEAST_BLACK = 0.1
"""Black share from which a still camera looks at more exposure for what may be there: less is shadows."""

SAME_JUMP_STOPS = 0.5
"""Jumps out of the dark are rough: one in progress is not corrected by less."""

LONGEST_STEP = 0.4
"""Stops by which frames of a moving camera may come to differ in brightness from one to the next, as long as the last
target is worth `WORTH_KEEPING` of the best: odometry must find its points again."""

WORTH_KEEPING = 0.7

REST_FRAMES = 30
"""Frames with one exposure after which a camera at rest may look at less, see `Probes.least_at_rest`."""

LOOK = "looks at less exposure, once"

LEAST_FORETOLD = 1.0
"""Stops by which light ahead must differ from the forecast to count: smaller changes are followed well without it."""

_Worth = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


class ExposureMap(ExposurePolicy):
    """Goes where the map promises most, for both cameras of a pair; docs/fisher-map.md says why.

    A subclass says what an image is worth at other exposures. All targets are absolute levels, and the map is one of
    absolute levels, so frames in flight are never corrected twice.

    Attributes
    ----------
    HOLD_GAIN_MOVING
        Share by which the objective must promise to rise before the target is moved, while the camera moves.
    PROBES
        How it looks for what is clipped.
    """

    STATE: ClassVar[tuple[str, ...]] = (
        "registration", "forecast", "latency", "memory", "target", "ahead", "densities", "motion_px",
        "votes", "sides", "foresight", "served",
    )  # fmt: skip
    compensated = "targets"
    HOLD_GAIN_MOVING: ClassVar[float]
    PROBES: ClassVar[Probes]
    target: float | None
    ahead: float
    densities: list[float]
    motion_px: float
    sides: list[Side]

    def __init__(self, responses: Mapping[Side, ResponseFunction], balance: Balance) -> None:
        self.balance = balance
        self.registration = Registration(responses)
        self.forecast = Forecast()
        self.foresight = Foresight()
        self.served = ServedBefore()
        self.latency = LoopDelay()
        self.memory = MetricMemory()
        self.target = None
        self.ahead = 0.0
        self.densities = []
        self.motion_px = 0.0
        self.votes = Votes(responses)
        self.sides = []

    @property
    def light_belief(self) -> float | None:
        """How far light ahead is believed, 0 to 1."""
        return self.foresight.belief

    @property
    def uncounted(self) -> dict[Side, str]:
        """The cameras without a vote."""
        return {side: REMARKS[fault] for side, fault in self.votes.faults.items()}

    @abstractmethod
    def _views(self, observation: Observation) -> tuple[MetricView, ...]:
        """What each image says of its objective, the reference camera's first."""

    def decide(self, observation: Observation) -> Target:
        """The level that promises most, for the frame that will show this decision."""
        level = observation.setting.level
        self.latency.see(level, (past.setting.level for past in observation.past))
        self.votes.see(level, observation.limits.darkest.level, observation.looks)
        self.served.pass_frame()
        target = self._vote(observation)
        if target.reason != LOOK:  # after it, the last target is as good as it was
            self.target = observation.limits.clamp_level(target.level)
        remark = ("; steered" if self.STEERED and observation.steering is not None else "") + self.votes.remark()
        return replace(target, reason=target.reason + remark) if remark else target

    def _vote(self, observation: Observation) -> Target:
        """The target of the cameras that have a vote, the reference first."""
        looks = sorted(observation.looks, key=lambda look: SIDES.index(look.side))
        voting = [look for look, votes in zip(looks, self.votes.of(looks), strict=True) if votes]
        if not voting:
            return Target(self._held(observation), "held")
        if self.votes.awaits(self.sides):  # what the map holds of that camera is as good as before
            return Target(self._held(observation), "held: a camera's frame is lost")
        self._map_for([look.side for look in voting])
        if voting != observation.looks:
            observation = replace(observation, looks=voting)
        views = self._views(observation)
        change = self._remember(observation, views)
        if self.votes.undecided:
            return Target(self._held(observation), "held")
        return self._look_down(observation) or self._jump(observation) or self._best(observation, change)

    def _held(self, observation: Observation) -> float:
        return observation.setting.level if self.target is None else self.target

    def _map_for(self, sides: list[Side]) -> None:
        """Restrict the map to these cameras. What it holds of one that joins them is from before it had a vote."""
        kept = [self.sides.index(side) for side in sides if side in self.sides]
        if len(kept) < len(sides):
            self.memory.sightings.clear()
            self.densities = [LEAST_DENSITY] * len(sides)
        elif len(kept) < len(self.sides):
            self.memory.keep(kept)
            self.densities = [self.densities[camera] for camera in kept]
        self.sides = sides

    def _remember(self, observation: Observation, views: tuple[MetricView, ...]) -> float:
        """Take the frame into the map; returns by how much the light has risen since the last one, stops."""
        level = observation.setting.level
        level_change = level - self.registration.previous_level
        light = self.registration.change(observation.looks[0], level)
        change = light.stops if light else 0.0
        self.forecast.add(change)
        # What was seen before an unmeasured change either still fits, or is contradicted and dropped.
        measured = change if light and light.measured else 0.0
        steady = light and light.measured and max(abs(measured), abs(level_change)) < FLOW_STOPS
        if steady or not observation.by_flow:
            self.motion_px = observation.motion_px
        motion = max(self.motion_px - MOVING_PX, 0.0)
        self.memory.pass_frame(measured, AGE_PER_PX * motion + AGE_PER_STOP * abs(measured))
        if change > FLOW_STOPS and _blind(views):
            self.memory.sightings.clear()  # white now: how much the light has risen is unknown
        self.memory.add(Sighting(level, views))
        for camera, view in enumerate(views):
            density = float(view.curve[NO_CHANGE]) / _showing(view, still=self.motion_px < MOVING_PX)
            self.densities[camera] = max(DENSITY_DECAY * self.densities[camera], density, LEAST_DENSITY)
        return change

    def _look_down(self, observation: Observation) -> Target | None:
        """As far down as any probe goes, until a camera that is white shows something or loses its vote."""
        side = self.votes.glaring
        if side is None:
            return None
        return Target(observation.setting.level - LONGEST_PROBE, f"{side} camera is white: looks at less exposure")

    def _jump(self, observation: Observation) -> Target | None:
        """Jump out of the dark if nothing brighter has been seen yet; None while any camera sees something."""
        if self.memory.highest().level > observation.setting.level + 1.0:
            return None
        return self._jump_anyway(observation)

    def _jump_anyway(self, observation: Observation) -> Target | None:
        """Jump out of the dark, whatever has been seen; None while any camera sees something."""
        level, views = observation.setting.level, self.memory.sightings[-1].views
        jump = min(dark_jump(view.signal, look.response) for view, look in zip(views, observation.looks, strict=True))
        if jump == 0:
            return None
        target = level + jump
        if self.target is not None and abs(self.target - target) < SAME_JUMP_STOPS:
            target = self.target
        reason, limit = "too dark to predict: jumps", observation.limits.brightest.level
        if target > limit:  # beyond it, an EV compensation downward would be lost until a frame is no longer dark
            return Target(limit, f"{reason}; held: at upper limit")
        return Target(target, reason)

    def _best(self, observation: Observation, change: float) -> Target:
        level = observation.setting.level
        held = self._held(observation)
        levels = _bins(observation.limits)
        ahead = self.forecast.ahead(self.latency.frames, steady=self.motion_px < SLOW_PX)
        moving = self.motion_px >= MOVING_PX
        foretold = self._foretold(observation, ahead)
        if foretold is None:
            worth, value, metric = self._worth(levels + ahead, moving)
        else:
            rises, shares = foretold
            worth, value, metric = self._expected(levels, rises, shares, moving)
            ahead = float(shares @ rises)
        risen, self.ahead = change + ahead - self.ahead, ahead
        remembered = self._served_before(observation, levels, value)
        if remembered is not None:
            return Target(remembered, "served here before", value_at(remembered, levels, metric))
        best = float(value.max())
        if best <= 0:  # if it is dark now, whatever was brighter was all white, in light that is gone
            return self._jump_anyway(observation) or Target(held, "held: no gradient at any exposure")
        gain = HOLD_GAIN_FOLLOWING if ahead != 0 else self.HOLD_GAIN_MOVING if moving else HOLD_GAIN
        now = value_at(held, levels, value)
        if now * (1.0 + gain) >= best:
            look = None if moving else self._look_below(observation)
            return look or Target(held, "held: metric at its maximum", value_at(held, levels, metric))
        target = plateau_centre(levels, value)
        if moving and value_at(held, levels, worth) >= WORTH_KEEPING * worth.max():
            target = _step_towards(target, held, risen)
        if target + ahead < self.memory.lowest().level - 0.5:
            reason = "probes what is saturated"
        else:
            reason = f"metric {'rises' if target > level else 'falls'} with exposure"
        return Target(target, reason, value_at(target, levels, metric))

    def _look_below(self, observation: Observation) -> Target | None:
        """One frame of less exposure, after `REST_FRAMES` at rest, if much is saturated and nothing darker is known.

        Predictions downward know nothing of what is saturated, and the best may be there.
        """
        here = self.memory.sightings[-1]
        saturated = max(view.saturated_share for view in here.views)
        if saturated < self.PROBES.least_at_rest or self.memory.lowest().level < here.level - CELL:
            return None
        recent = [step.setting.level for step in observation.past][-REST_FRAMES:]
        target = here.level - self.PROBES.length_stops(saturated)
        at_rest = len(recent) == REST_FRAMES and max(recent) - min(recent) <= CELL
        return Target(target, LOOK) if at_rest and target >= observation.limits.darkest.level else None

    def _foretold(
        self, observation: Observation, forecast: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """`Foresight.rises` until a decision shows; None if no earlier drive foretells more than the forecast."""
        if observation.light_ahead is None:
            self.foresight.rest()
            self.served.rest(forget=self.foresight.untold_frames >= FORGOTTEN_FRAMES)
            return None
        changes, frames = self.forecast.changes, self.latency.frames
        rises, shares = self.foresight.rises(observation.light_ahead, changes, frames, forecast)
        return (rises, shares) if np.abs(rises - forecast).max() > LEAST_FORETOLD else None

    def _served_before(
        self, observation: Observation, levels: NDArray[np.float64], value: NDArray[np.float64]
    ) -> float | None:
        """`ServedBefore.target`, after `_foretold`; None without an earlier drive."""
        if observation.light_ahead is None:
            return None
        views = self.memory.sightings[-1].views
        saturated = sum(view.saturated_share for view in views) / len(views)
        black = sum(view.black_share for view in views) / len(views)
        prospect = Prospect(observation.setting.level, saturated, black, levels, value)
        return self.served.target(observation.light_ahead, self.foresight, self.latency.frames, prospect)

    def _expected(
        self, levels: NDArray[np.float64], rises: NDArray[np.float64], shares: NDArray[np.float64], moving: bool
    ) -> _Worth:
        """The expectation of `_worth` over rises of the light."""
        lowest, highest = levels[0] + rises.min(), levels[-1] + rises.max()
        known = np.linspace(lowest, highest, math.ceil((highest - lowest) / BIN) + 1)
        shifted = levels + rises[:, None]
        worth, value, metric = (shares @ np.interp(shifted, known, values) for values in self._worth(known, moving))
        return worth, value, metric

    def _worth(self, levels: NDArray[np.float64], moving: bool) -> _Worth:
        """(worth, value, metric of the left camera) over levels under the present light.

        Worth is the metric and what a probe may bring, as a share of each camera's own best, averaged: a lamp that one
        camera sees does not outvote the other. Value is what to maximise: the same, unless consumers steer.
        """
        metrics = self.memory.fuse(levels, moving)
        worth = self._shares_of_best(levels, metrics, moving)
        if self.memory.sightings[-1].is_steered:
            steered = self._shares_of_best(levels, self.memory.fuse(levels, moving, steered=True), moving)
            return worth, within_reason(worth, steered), metrics[0]
        return worth, worth, metrics[0]

    def _shares_of_best(
        self, levels: NDArray[np.float64], metrics: NDArray[np.float64], moving: bool
    ) -> NDArray[np.float64]:
        """The worth of each level, given what each camera's metric is there, shape (cameras, n)."""
        blind = _blind(self.memory.sightings[-1].views)
        frontier, known_again = self.memory.frontier(math.inf if moving or blind else TRUSTED_RISE)
        highest = self.memory.highest()
        saturated = [view.saturated_share for view in frontier.views]
        black = [0.0 if moving or view.black_share < LEAST_BLACK else view.black_share for view in highest.views]
        return worth_of_levels(
            levels,
            metrics,
            np.array([saturated, black, self.densities]),
            moving,
            self.PROBES,
            frontier=frontier.level,
            known_again=known_again,
            highest=highest.level,
        )


def _blind(views: tuple[MetricView, ...]) -> bool:
    """Whether a camera is nearly white."""
    return max(view.saturated_share for view in views) > BLIND_SHARE


def _showing(view: MetricView, *, still: bool) -> float:
    """Share of the picture that shows something, for what a pixel of good exposure carries; at least 0.1, 0.3 if still.

    In motion black pixels count as showing: what was black is then never looked for.
    """
    return max(1.0 - view.saturated_share - view.black_share, 0.3) if still else max(1.0 - view.saturated_share, 0.1)


def _step_towards(target: float, held: float, risen: float) -> float:
    """At most a step from `held` towards `target` (stops), on top of the rise of the light since."""
    low, high = sorted((held, held - risen))
    return min(max(target, low - LONGEST_STEP), high + LONGEST_STEP)


@lru_cache(maxsize=1)
def _bins(limits: ExposureLimits) -> NDArray[np.float64]:
    low, high = limits.darkest.level, limits.brightest.level
    return np.linspace(low, high, max(round((high - low) / BIN), 1) + 1)
