"""The trigger wire in virtual time. It knows what every trigger came to, whatever the daemon thinks."""

from __future__ import annotations

import math
from collections import Counter, defaultdict

from imaging.frames import CameraName
from tests.soak.clock import Actor
from tests.soak.rig import PERIOD_NS, VirtualRig

STANDS_STILL = 30
"""A pause of so many periods is no loss: nobody expects triggers then."""


class Wire:
    """Pulses at the rate expected, unless told otherwise, and the account of them.

    Attributes
    ----------
    triggers
        How many were expected so far: pulses, and those that were left out of a wire that did not stand still.
    extra
        How many pulses came between the expected ones.
    stop_periods
        Stand still for so many periods, once; a fraction moves the phase.
    halved, doubled
        How many of the next pulses are left out every other time, or get another one behind them.
    """

    def __init__(self, rig: VirtualRig, first_ns: int) -> None:
        self.triggers = 0
        self.extra = 0
        self.stop_periods = 0.0
        self.halved = self.doubled = 0
        self._rig = rig
        self._next_ns: float = first_ns
        self._left_out: set[int] = set()
        self.actors = [Actor(self._pulse, first_ns), Actor(self._extra_pulse)]

    def lost(self) -> Counter[str]:
        """Why triggers since the last call made no whole set, and how many frames each camera lost."""
        fates: dict[int, dict[CameraName, str]] = defaultdict(dict)
        for device in self._rig.devices:
            for number, fate in device.fates:
                if number >= 0:
                    fates[number][device.camera] = fate
            device.fates.clear()
        cameras = [device.camera for device in self._rig.devices]
        for number in self._left_out:
            fates[number] = dict.fromkeys(cameras, "ignored")
        self._left_out.clear()
        lost = Counter(_reason(of_trigger, len(cameras)) for of_trigger in fates.values())
        lost.update(f"lost of {camera}" for of_trigger in fates.values() for camera in of_trigger)
        return lost

    def _pulse(self) -> None:
        self._rig.pulse(self.triggers)
        self.triggers += 1
        now_ns, periods = self._next_ns, 1.0
        if self.doubled:
            self.doubled -= 1
            self.actors[1].plan(round(now_ns + PERIOD_NS / 2))
        if self.halved:
            self.halved -= 1
            periods = 2.0
        elif self.stop_periods:
            periods, self.stop_periods = self.stop_periods, 0.0
        left_out = round(periods) - 1
        if left_out < STANDS_STILL:
            self._left_out.update(range(self.triggers, self.triggers + left_out))
            self.triggers += left_out
        self._next_ns = now_ns + periods * PERIOD_NS
        self.actors[0].plan(round(self._next_ns))

    def _extra_pulse(self) -> None:
        self.extra += 1
        self._rig.pulse(-self.extra)
        self.actors[1].plan(math.inf)


def _reason(fates: dict[CameraName, str], cameras: int) -> str:
    for fate, reason in (("gone", "camera_gone"), ("incomplete", "incomplete"), ("ignored", "trigger_ignored")):
        if fate in fates.values():
            return reason
    if len(fates) == 1:
        return f"{next(iter(fates))}_missing"
    return "both_missing" if cameras == 2 else "several_missing"
