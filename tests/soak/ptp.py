"""Cameras with drifting clocks that obey a PTP master, in virtual time."""

from __future__ import annotations

import heapq
import math
import random
from bisect import bisect_right
from collections.abc import Callable

from drivers.camera import PtpState
from imaging.frames import CameraName
from tests.soak.camera import Device
from tests.soak.clock import SECOND, Actor, Clock

EPOCH_NS = 1_700_000_000 * SECOND
MASTER_PPM = 40.0
"""How much too fast the master's clock is, by the host's."""
DRIFTS_PPM: dict[CameraName, float] = {"left": 80.0, "right": -70.0}
SERVO_NS = SECOND // 2
ERROR_NS = 500
"""How well a slave keeps the time."""
FOUND_NS = 3 * SECOND
"""So long a camera listens before it follows a master."""


class Master:
    """A clock that is not the host's, on air or not. `set_by` sets it by so much."""

    def __init__(self) -> None:
        self.on_air = True
        self._offset_ns = EPOCH_NS

    def set_by(self, step_ns: int) -> None:
        self._offset_ns += step_ns

    def time_ns(self, now_ns: int) -> int:
        return self._offset_ns + now_ns + round(now_ns * MASTER_PPM * 1e-6)


class PtpDevice(Device):
    """A camera whose clock follows `master` while it `hears` it, and otherwise drifts; it takes action commands.

    `on_frame` is called when a frame is on its way.
    """

    def __init__(self, camera: CameraName, clock: Clock, seed: int) -> None:
        super().__init__(camera, clock, seed)
        self.master: Master | None = None
        self.hears = True
        self.on_frame: Callable[[], None] = lambda: None
        self._numbers = random.Random(f"ptp {seed} {camera}")
        self._lines = [(0, SECOND * self._numbers.randrange(1, 100), DRIFTS_PPM[camera])]
        self._offset_ns = 0
        self._heard_since_ns: int | None = None
        self._waiting: list[int] = []
        self.actors = [Actor(self._serve, clock.now_ns + self._numbers.randrange(SERVO_NS)), Actor(self._fire)]

    def device_ns(self, now_ns: int) -> int:
        """Also of a moment ago: a latch may lie behind the present turn."""
        line = self._lines[max(bisect_right(self._lines, (now_ns, math.inf)) - 1, 0)]
        host_ns, device_ns, ppm = line
        return device_ns + now_ns - host_ns + round((now_ns - host_ns) * ppm * 1e-6)

    def ptp_state(self) -> PtpState:
        if self._follows:
            return PtpState("Slave", self._offset_ns)
        return PtpState("Listening" if self._heard_since_ns is None else "Uncalibrated", 0)

    def schedule(self, device_time_ns: int) -> None:
        heapq.heappush(self._waiting, device_time_ns)
        self._plan()

    @property
    def _follows(self) -> bool:
        return self._heard_since_ns is not None and self.clock.now_ns - self._heard_since_ns >= FOUND_NS

    def _serve(self) -> None:
        """The servo: by its next turn the clock is some hundred nanoseconds off."""
        now_ns, master = self.clock.now_ns, self.master
        if master is None or not (master.on_air and self.hears):
            self._heard_since_ns = None
        elif self._heard_since_ns is None:
            self._heard_since_ns = now_ns
        if master is not None and self._follows:
            target_ns = master.time_ns(now_ns) + self._numbers.randint(-ERROR_NS, ERROR_NS)
            self._offset_ns = self.device_ns(now_ns) - master.time_ns(now_ns)
            self._set(now_ns, target_ns, MASTER_PPM)
        else:
            self._set(now_ns, self.device_ns(now_ns), DRIFTS_PPM[self.camera])
        self.actors[0].plan(now_ns + SERVO_NS)

    def _set(self, now_ns: int, device_ns: int, ppm: float) -> None:
        self._lines = [*self._lines[-4:], (now_ns, device_ns, ppm)]
        self._plan()

    def _plan(self) -> None:
        if not self._waiting:
            self.actors[1].plan(math.inf)
            return
        host_ns, device_ns, ppm = self._lines[-1]
        due_ns = host_ns + math.ceil((self._waiting[0] - device_ns) / (1 + ppm * 1e-6))
        self.actors[1].plan(max(due_ns, self.clock.now_ns))

    def _fire(self) -> None:
        heapq.heappop(self._waiting)
        self.pulse(self.clock.now_ns, self.clock.now_ns)  # numbered by the true time
        self.on_frame()
        self._plan()
