"""A camera in virtual time: it knows when exposures begin, what they were taken with, and when frames arrive."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers.camera import CameraDescription, ClockReading, IncompleteFrame, PtpState
from drivers.genicam.timeline import FrameTimeline, LatchedClock
from drivers.rig.supervision import Slots
from imaging.errors import CameraLostError, CameraNotFoundError, NodeError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame
from tests.soak.clock import MS, Clock

LIMITS = ExposureLimits(20.0, 7500.0, 0.0, 30.0, 1.0, 0.1)
PIXELS = np.zeros((4, 4), np.uint8)
"""One array for all frames: they are metadata only, and black tells nothing of a response."""

BUFFERS = 16
READOUT_NS = 4 * MS
OPENING_NS = 400 * MS
SEARCH_NS = 1000 * MS
TIMEOUT_NS = 600 * MS
"""So long a command to a dead camera takes."""

_JITTERS = 4099  # a prime: the draws come round in ever other order


class Exposed(NamedTuple):
    """A frame on its way."""

    pulse: int
    arrival_ns: int
    frame_id: int
    device_ns: int
    setting: ExposureSetting
    whole: bool
    told: bool


@dataclass(frozen=True, slots=True, eq=False)
class VirtualFrame(Frame):
    """A frame that tells of which pulse it is."""

    pulse: int = 0


class Device:
    """The camera itself, which outlives the sessions in which it is open.

    Attributes
    ----------
    lose, truncate, untell, ignore
        How many of the next frames get lost, arrive with holes, or do not say how they were taken, and how many
        triggers are ignored.
    halted
        Nothing that is taken arrives, until the camera is opened again.
    delay_ns
        How late the next frame is; those after it wait behind it.
    refuses, clips_us, write_ns, frozen
        Why writes are refused (empty: they are not), the longest exposure time that is taken, how long a write takes
        (0: as usual), and whether exposures stay as they are whatever the nodes read.
    counter, stamp, latch
        What the camera makes of the number of a frame, of its time stamp, and of the time that it latches.
    fates
        What became of pulses that make no frame, until somebody takes note.
    slots
        Of the host, if that triggers it.
    period_ns
        Of the triggers, as configured.
    """

    slots: Slots | None = None
    period_ns: float | None = None

    def __init__(self, camera: CameraName, clock: Clock, seed: int) -> None:
        self.camera = camera
        self.clock = clock
        self.in_flight: deque[Exposed] = deque()
        self.present = True
        self.session = 0
        self.lose = self.truncate = self.untell = self.ignore = 0
        self.halted = False
        self.delay_ns = 0
        self.refuses = ""
        self.clips_us = LIMITS.max_time_us
        self.write_ns = 0
        self.frozen = False
        self.clock_offset_ns = 123_456_789_000
        self.counter: Callable[[int], int] = int
        self.stamp: Callable[[int], int] = int
        self.latch: Callable[[int], int] = int
        self.fates: list[tuple[int, str]] = []
        self._streams_from_ns: int | None = None
        self._frame_id = 0
        self._last_arrival_ns = 0
        self._setting = ExposureSetting(1000.0, 0.0)
        self._writes: deque[tuple[int, ExposureSetting]] = deque()
        numbers = random.Random(f"{seed} {camera}")
        self._jitters_ns = [round(numbers.uniform(0, 0.5 * MS)) for _ in range(_JITTERS)]
        self._durations_ns = [
            round((4.0 if numbers.random() < 0.01 else numbers.uniform(0.3, 0.9)) * MS) for _ in range(_JITTERS)
        ]
        self._writes_done = 0

    @property
    def written(self) -> ExposureSetting:
        """What was written last."""
        return self._writes[-1][1] if self._writes else self._setting

    def vanish(self) -> None:
        """Lose power: even when it is back at once, nobody controls it any more."""
        self.present = False
        self.session += 1
        self.forget_stream()

    def forget_stream(self) -> None:
        """Nothing that is on its way arrives, and pulses make no frames any more."""
        self._streams_from_ns = None
        self.fates += [(exposed.pulse, "gone") for exposed in self.in_flight]
        self.in_flight.clear()

    def stream(self) -> None:
        """From now on pulses make frames, which count from 1."""
        self._streams_from_ns = self.clock.now_ns
        self._frame_id = 0

    def pulse(self, number: int, now_ns: int) -> None:
        """A trigger pulse; negative numbers are of pulses between the expected ones."""
        if self._streams_from_ns is None or now_ns < self._streams_from_ns:
            self.fates.append((number, "gone"))
            return
        if self.ignore:
            self.ignore -= 1
            self.fates.append((number, "ignored"))
            return
        while self._writes and self._writes[0][0] <= now_ns:
            _, setting = self._writes.popleft()
            self._setting = self._setting if self.frozen else setting
        self._frame_id += 1
        if self.lose or self.halted or len(self.in_flight) >= BUFFERS:
            self.lose = max(self.lose - 1, 0)
            self.fates.append((number, "missing"))
            return
        jitter_ns = self._jitters_ns[number % _JITTERS]
        arrival_ns = now_ns + round(self._setting.exposure_time_us * 1e3) + READOUT_NS + jitter_ns + self.delay_ns
        self._last_arrival_ns = arrival_ns = max(arrival_ns, self._last_arrival_ns + 1)
        self.delay_ns = 0
        whole = not self.truncate
        if not whole:
            self.truncate -= 1
            self.fates.append((number, "incomplete"))
        told = not self.untell
        self.untell = max(self.untell - 1, 0)
        stamp_ns, counter = self.stamp(self.device_ns(now_ns) + jitter_ns // 100), self.counter(self._frame_id)
        self.in_flight.append(Exposed(number, arrival_ns, counter, stamp_ns, self._setting, whole, told))

    def device_ns(self, now_ns: int) -> int:
        """What its own clock shows."""
        return now_ns + self.clock_offset_ns

    def schedule(self, device_time_ns: int) -> None:
        """A pulse that the host gives for a time of its clock."""
        raise NodeError(f"camera {self.camera}: it takes no action commands")

    def ptp_state(self) -> PtpState | None:
        """What it says of its PTP clock, if it has one."""
        return None

    def software_trigger(self) -> None:
        """A pulse that the host gives, numbered by its slot, which both cameras share."""
        assert self.slots is not None
        now_ns = self.clock.now_ns
        self.pulse(round((now_ns - self.slots.first_ns) / self.slots.period_ns), now_ns)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Write both nodes, one after the other; returns what they hold then."""
        self._writes_done += 1
        duration_ns = self.write_ns or self._durations_ns[self._writes_done % _JITTERS]
        before = self._writes[-1][1] if self._writes else self._setting
        taken = ExposureSetting(min(setting.exposure_time_us, self.clips_us), setting.gain_db)
        started_ns = self.clock.now_ns
        self.clock.now_ns += duration_ns
        if self.refuses:
            raise NodeError(f"camera {self.camera}: {self.refuses}")
        self._writes.append((started_ns + duration_ns // 2, ExposureSetting(taken.exposure_time_us, before.gain_db)))
        self._writes.append((self.clock.now_ns, taken))
        return taken

    def open(self) -> VirtualCamera:
        """Search it, and open it if it is there."""
        self.clock.now_ns += OPENING_NS if self.present else SEARCH_NS
        if not self.present:
            raise CameraNotFoundError(f"no camera {self.camera}")
        self.forget_stream()
        self.halted = False
        self.session += 1
        return VirtualCamera(self)


class VirtualCamera:
    """A session of a device: see `drivers.camera.Camera`. It is lost when the device goes, or is reopened."""

    def __init__(self, device: Device) -> None:
        self.description = CameraDescription("ours", "virtual", device.camera)
        self.limits = LIMITS
        self._device = device
        self._session = device.session
        self._lost = False
        self._latched_ns = 0
        self._clock = LatchedClock(self, "Latch", "Value", 1_000_000_000, device.clock)  # type: ignore[arg-type]
        self._timeline = FrameTimeline(device.period_ns, self._clock.read())

    def start(self) -> None:
        self._reach()
        self._device.stream()

    def next_frame(self, timeout_s: float) -> Frame | IncompleteFrame | None:
        """What has arrived by now: whoever waits is called when a frame arrives, or when the time is over."""
        if self._lost:
            raise CameraLostError(f"camera {self._device.camera} does not answer any more")
        in_flight, now_ns = self._device.in_flight, self._device.clock.now_ns
        if not in_flight or in_flight[0].arrival_ns > now_ns:
            return None
        pulse, _, frame_id, device_ns, setting, whole, told = in_flight.popleft()
        placed = self._timeline.place(frame_id, device_ns, now_ns, round(1e3 * setting.exposure_time_us))
        if not whole or placed.host_time_ns is None:
            return placed.incomplete
        return VirtualFrame(
            PIXELS,
            8,
            placed.frame_id,
            placed.device_time_ns,
            placed.host_time_ns,
            now_ns,
            setting,
            "chunk" if told else "ledger",
            by_arrival=placed.by_arrival,
            clock_trouble=placed.clock_trouble,
            pulse=pulse,
        )

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self._reach()
        return self._device.write(setting)

    def trigger(self) -> None:
        """The command takes half a round trip there, and half a round trip back."""
        self._reach()
        self._device.clock.now_ns += MS // 10
        self._device.software_trigger()
        self._device.clock.now_ns += MS // 10

    def schedule(self, device_time_ns: int) -> None:
        """The command is sent; nobody waits for an answer."""
        self._reach()
        self._device.schedule(device_time_ns)

    def latch_clock(self) -> ClockReading | None:
        state, offset_ns = self._device.ptp_state(), self._clock.read()
        self._timeline.read(offset_ns)
        return None if state is None else ClockReading(offset_ns, state)

    def temperature_c(self) -> None:
        pass

    def refused_packets(self) -> None:
        pass

    def close(self) -> None:
        """Stop the stream; of a lost camera nothing is held."""
        self._lost = True
        if self._device.session == self._session:
            self._device.forget_stream()

    def execute(self, _command: str) -> None:
        """Latch the clock, somewhere within the round trip."""
        self._reach()
        self._device.clock.now_ns += MS // 20
        self._latched_ns = self._device.latch(self._device.device_ns(self._device.clock.now_ns))
        self._device.clock.now_ns += MS // 25

    def read(self, _node: str) -> int:
        return self._latched_ns

    def _reach(self) -> None:
        device = self._device
        if self._lost or not device.present or device.session != self._session:
            device.clock.now_ns += 0 if self._lost else TIMEOUT_NS
            self._lost = True
            raise CameraLostError(f"camera {device.camera} does not answer any more")
