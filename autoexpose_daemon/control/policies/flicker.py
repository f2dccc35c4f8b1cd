"""Whether the light flickers with the mains, and at which frequency, from the frames that are taken anyway."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.policy import Look
from autoexpose_daemon.control.registration import LightRegistration
from autoexpose_daemon.control.snapshot import Stateful
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName
from imaging.response import ResponseFunction

MAINS_FLICKER_HZ = (100.0, 120.0)
"""Lamps flash twice in each period of the mains, 50 or 60 Hz. No other frequency is looked for."""

FRAMES = 32
"""Per window: half a second at 60 Hz. Mains off by 0.2 % are then out of step by only a tenth of a period."""

LONGEST_GAP_NS = 250_000_000
"""Between frames: nobody knows what the light did in a longer gap, so a new window starts."""

LEAST_SWING = 0.03
"""Swing of the light from its mean to its peak, as frames show it: less is hidden by noise, and harmless."""

LEAST_SHARE = 0.7
"""Share of the light's variance that a frequency must explain: noise gives 1/15, sun and shadow twice a second up to
0.6. A step may give 0.8, but not in two windows in a row."""

LEAST_BEAT = 0.92
"""Share of a wave that must differ from ramps and bends. So beats of flicker and frame rate take at most 12 frames."""

LEAST_LEFT, CLEARLY_LEFT = 0.04, 0.5
"""Share of a flicker's swing that exposures must leave for it to be seen, and for its absence to be seen. If they
leave less than the first, not even a lamp that goes out between flashes, whose light swings by two thirds, reaches
`LEAST_SWING`."""


@dataclass(frozen=True, slots=True)
class LightSample:
    """The light during one exposure."""

    middle_ns: int  # the middle of the exposure, by the camera's clock
    exposure_s: float  # how long it was
    light: float  # stops of light, relative to the first of its window


@dataclass(frozen=True, slots=True)
class FlickerFit:
    """A flicker in a window: its share of the variance, its swing in frames, and how much of it exposures leave."""

    share: float
    swing: float
    left: float


class FlickerWatch(Stateful):
    """Finds the frequency at which the light flickers, once two windows of frames in a row agree.

    Frames of whole flicker periods do not show it. So what was found stands until two windows in a row show another
    frequency, or steady light in exposures short enough to show the flicker if it were there.
    """

    registration: LightRegistration
    flicker_hz: float | None = None  # flashes per second, one of `MAINS_FLICKER_HZ`; None: no flicker is known
    glimpses: list[LightSample]  # of the present window
    suspected: float | None = None  # what the window before said, as `_reading` does

    def __init__(self, responses: dict[CameraName, ResponseFunction]) -> None:
        self.registration = LightRegistration(responses)
        self.glimpses = []

    def see(self, look: Look, setting: ExposureSetting, device_time_ns: int) -> None:
        """Take in a frame, its setting, and when its exposure began by its camera's clock."""
        change = self.registration.change(look, setting.level)
        middle_ns = device_time_ns + round(setting.exposure_time_us * 500)
        last = self.glimpses[-1] if self.glimpses else None
        if change is None or last is None or not 0 < middle_ns - last.middle_ns <= LONGEST_GAP_NS:
            if self.glimpses:  # a gap, not an ordinary new window
                self.suspected = None
            self.glimpses = [LightSample(middle_ns, setting.exposure_time_us * 1e-6, 0.0)]
            return
        self.glimpses.append(LightSample(middle_ns, setting.exposure_time_us * 1e-6, last.light + change.stops))
        if len(self.glimpses) == FRAMES:
            reading = self._reading()
            if reading is not None and reading == self.suspected:
                self.flicker_hz = reading or None
            self.suspected, self.glimpses = reading, []

    def _reading(self) -> float | None:
        """What the window says: a frequency; 0: the flicker that was found is gone; None: nothing certain."""
        fits = {hz: fit for hz in MAINS_FLICKER_HZ if (fit := _fit(self.glimpses, hz))}
        for hz, fit in fits.items():
            others = max((other.share for rival, other in fits.items() if rival != hz), default=0.0)
            if fit.swing >= LEAST_SWING and fit.share >= max(LEAST_SHARE, 2 * others):
                return hz
        known = None if self.flicker_hz is None else fits.get(self.flicker_hz)
        if known and known.left >= CLEARLY_LEFT and known.swing < LEAST_SWING * known.left:
            return 0.0
        return None


def _fit(glimpses: list[LightSample], flicker_hz: float) -> FlickerFit | None:
    """The best sinusoid of a frequency at the true times of the frames, as far as exposures let it through.

    None if it would not show: its beat with the frame rate is too slow, or the exposures are whole periods.
    """
    times_s = np.array([each.middle_ns - glimpses[0].middle_ns for each in glimpses]) * 1e-9
    light = np.array([each.light for each in glimpses])
    # The mean of a sinusoid over an exposure; np.sinc has the pi in it.
    factors = np.sinc(flicker_hz * np.array([each.exposure_s for each in glimpses]))
    left = float(np.sqrt(np.mean(factors**2)))
    phases = 2 * np.pi * flicker_hz * times_s
    wave = np.stack([np.cos(phases), np.sin(phases)], axis=1)
    slow = np.vander(times_s / times_s[-1], 3)
    if left < LEAST_LEFT or np.sum(_without(slow, wave) ** 2) < LEAST_BEAT * len(glimpses):
        return None
    # Ramps are straight in stops, and a flicker is a sinusoid in light.
    seen = _without(slow, np.exp2(_without(slow, light)))
    fitted = seen - _without(_without(slow, wave * factors[:, None]), seen)
    variance = float(np.mean(seen**2))
    swing = float(np.sqrt(2 * np.mean(fitted**2)))
    return FlickerFit(swing**2 / (2 * variance) if variance > 0 else 0.0, swing, left)


def _without(basis: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the columns of `basis` do not explain of `values`, by least squares."""
    return np.asarray(values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0])
