"""The cameras of a recorded drive, exposed as anyone asks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from evaluation.rejudge.exposing import Exposer, Light
from evaluation.rejudge.timeline import Timeline
from imaging.exposure import ExposureSetting
from imaging.frames import Side, StereoPair

FAR_STOPS = 1.0
"""A shot farther from the wanted level than this does not show what the wanted exposure would."""


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A pair as the cameras would have taken it.

    Attributes
    ----------
    pair
        With the wanted setting, at the time of the instant.
    shot
        The number of the recorded pair that shows it: that of the instant if several were fused.
    off_stops
        How far the shot's level is from the wanted one: above 0, it is darker.
    blur_ratio
        The shot's exposure time over the wanted one, at least 1: what is above is blur that cannot be removed.
    fused
        Whether it was made of several shots, of something that stands still.
    time_s
        When what it shows was there, seconds.
    """

    pair: StereoPair
    shot: int
    off_stops: float
    blur_ratio: float
    fused: bool
    time_s: float


class RecordedCameras:
    """Makes the pairs of one instant after the other.

    Parameters
    ----------
    timeline
        The whole drive.
    exposers
        Of the cameras.
    """

    def __init__(self, timeline: Timeline, exposers: Mapping[Side, Exposer]) -> None:
        self.timeline = timeline
        self.exposers = exposers
        self._number = 0
        self._pair_at: Callable[[int], StereoPair] | None = None
        self._fused: dict[Side, Light] = {}
        self._lights: dict[tuple[Side, int], Light] = {}

    def go_to(self, number: int, pair_at: Callable[[int], StereoPair]) -> None:
        """Make this the present instant; `pair_at` gives the recorded pairs near it."""
        self._number, self._pair_at = number, pair_at
        self._fused = {}
        near = self.timeline.near(number)
        self._lights = {key: light for key, light in self._lights.items() if key[1] in near}

    def take(self, setting: ExposureSetting) -> Made:
        """The pair of the present instant, taken with a setting."""
        timeline, number = self.timeline, self._number
        present = self._recorded(number)
        still = timeline.still[number]
        shot = number if still else timeline.nearest(number, setting.level)
        shots = timeline.around(number) if still else range(shot, shot + 1)
        frames = {}
        for side, frame in present.frames.items():
            light = self._light(side, shots, fused=still)
            pixels = self.exposers[side].expose(light, setting, frame.bit_depth, number)
            frames[side] = replace(frame, pixels=pixels, setting=setting)
        levels = [timeline.glimpses[one].level for one in shots]
        nearest = min(levels, key=lambda level: abs(level - setting.level))
        blur_ratio = timeline.glimpses[shot].setting.exposure_time_us / setting.exposure_time_us
        return Made(
            StereoPair(present.trigger, frames),
            shot,
            off_stops=setting.level - nearest,
            blur_ratio=1.0 if still else max(blur_ratio, 1.0),
            fused=still,
            time_s=timeline.glimpses[shot].time_s,
        )

    def _recorded(self, number: int) -> StereoPair:
        assert self._pair_at is not None, "go to an instant first"
        return self._pair_at(number)

    def _light(self, side: Side, shots: Sequence[int], *, fused: bool) -> Light:
        if fused:
            if side not in self._fused:
                self._fused[side] = self.exposers[side].fused([self._recorded(shot).frames[side] for shot in shots])
            return self._fused[side]
        key = side, shots[0]
        if key not in self._lights:
            self._lights[key] = self.exposers[side].light(self._recorded(shots[0]).frames[side])
        return self._lights[key]
