"""Which exposure levels would have served, told by frames from before and after."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

import numpy as np

from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.metrics.information import InformationPrediction
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.metric_map.exposure_map import BIN, MOVING_PX
from autoexpose_daemon.control.policies.metric_map.memory import MetricMemory, Sighting, blended
from autoexpose_daemon.control.policies.metric_map.search import plateau_centre
from autoexpose_daemon.control.policies.metric_map.view import DELTAS, MetricView, Tones
from autoexpose_daemon.control.registration import Registration
from autoexpose_daemon.control.view import View
from calibration.response import ResponseFunction
from drivers.exposure import linear_gain
from drivers.frames import Frame, Side

REACH: Final = 30
"""Frames before and after one that tell which level would have served there."""

MOST_WAITING: Final = 120
"""While nothing shows how the light changes, moments wait for that, but no more than so many."""

AGE_PER_PX: Final = 0.03
"""Stops by which another frame's prediction counts as farther, for each pixel of motion in between."""

BLIND_SHARE: Final = 0.8
"""With this share of a frame's pixels black or saturated, changes of the light do not show."""


@dataclass(slots=True)
class Moment:
    """A frame, in hindsight.

    Attributes
    ----------
    risen
        By how much the light had risen since the first frame, stops.
    served
        The level that would have served, stops.
    """

    risen: float
    served: float


@dataclass(slots=True)
class _Seen:
    """What a frame says of other levels, and by how many stops sightings had aged when it was taken."""

    moment: Moment
    level: float
    view: MetricView
    aged: float


class Hindsight:
    """The light of one camera's drive, and the levels that would have served.

    Decisions do not tell: they come late where the light or the view changes fast, and know nothing of what is
    saturated until they have looked at it. Later frames do. So this is the map of `fisher-map` over absolute levels
    once more, with what was seen before and after.
    """

    def __init__(self, side: Side, response: ResponseFunction) -> None:
        defaults = ControlParameters()
        noise = SensorNoise(defaults.full_well_e, defaults.read_noise_e)
        self._side: Side = side
        self._view, self._tones = View(response), Tones(response)
        self._registration = Registration({side: response})
        self._prediction = InformationPrediction(response, noise, DELTAS)
        self._risen = self._aged = 0.0
        self._frames: deque[_Seen] = deque()
        self._waiting = 0  # frames at the end of `_frames` that wait for those after them
        self._blind: list[Moment] = []

    def see(self, frame: Frame, motion_px: float) -> list[Moment]:
        """Take the next frame, and the flow since the one before (pixels).

        Returns
        -------
            The moments of which no later frame says more, oldest first: as a rule, the one `REACH` frames before.
        """
        look = self._view.look(self._side, frame)
        light = self._registration.change(look, frame.setting.level)
        change = light.stops if light else 0.0
        gain, same = linear_gain(frame.setting.gain_db), np.ones(DELTAS.size)
        seen = contrast(look.unfiltered, self._prediction.bins)
        curve = self._prediction.curve(seen, look.averaged, gain, gain * same, same)
        view = MetricView(curve, *self._tones.measure(look))
        self._risen += change
        self._aged += AGE_PER_PX * max(motion_px - MOVING_PX, 0.0)
        moment = Moment(self._risen, frame.setting.level)
        self._frames.append(_Seen(moment, frame.setting.level, view, self._aged))
        self._waiting += 1
        self._see_blindly(moment, change, blind=view.saturated_share + view.black_share >= BLIND_SHARE)
        waits = MOST_WAITING if self._blind else REACH
        return [self._next() for _ in range(self._waiting - waits)]

    def rest(self) -> list[Moment]:
        """The moments of the last frames: none follows."""
        return [self._next() for _ in range(self._waiting)]

    def _see_blindly(self, moment: Moment, change: float, *, blind: bool) -> None:
        """What only shows now had changed when nothing was seen."""
        if blind:
            self._blind.append(moment)
            return
        for before in self._blind[1:]:
            before.risen += change
        self._blind = []

    def _next(self) -> Moment:
        """The first moment that waits, with the level that would have served."""
        here = self._frames[-self._waiting]
        memory = MetricMemory([Sighting(each.level, (each.view,), abs(each.aged - here.aged)) for each in self._frames])
        lowest, highest = memory.lowest().level + DELTAS[0], memory.highest().level + DELTAS[-1]
        levels = np.arange(lowest, highest + BIN, BIN)
        values, distances = memory.predictions(levels, moving=True)
        own = values[len(self._frames) - self._waiting]
        hidden = np.array([_hidden_share(here, each) for each in self._frames])
        worth = blended(np.minimum(values, own + hidden[:, None, None] * values), distances)[0]
        if worth.any():
            here.moment.served = plateau_centre(levels, worth)
        if self._blind and self._blind[0] is here.moment:
            self._blind.pop(0)
        self._waiting -= 1
        if len(self._frames) > REACH + self._waiting:
            self._frames.popleft()
        return here.moment


def _hidden_share(here: _Seen, other: _Seen) -> float:
    """How much of what another frame shows can be hidden here, at most: in what is saturated here, or black."""
    if other.level < here.level:
        hidden, shown = here.view.saturated_share, 1.0 - other.view.black_share
    else:
        hidden, shown = here.view.black_share, 1.0 - other.view.saturated_share
    return 1.0 if hidden >= shown else hidden / shown
