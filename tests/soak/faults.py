"""Faults, one a virtual minute: what they do, and what the daemon may show of each."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from tests.soak.camera import LIMITS, Device
from tests.soak.clock import MS, SECOND, Actor
from tests.soak.rig import RATE_HZ, VirtualRig
from tests.soak.wire import Wire


@dataclass
class Expected:
    """What a fault shows, beside the losses that the wire knows of.

    Attributes
    ----------
    duration_ns
        How long its cause lasts.
    degraded
        What the state says meanwhile, for certain; None: it may go unnoticed.
    perhaps
        What the state may say.
    counts
        Counters with the least and the most that the fault adds to them.
    """

    duration_ns: int
    degraded: str | None = None
    perhaps: tuple[str, ...] = ()
    counts: dict[str, tuple[int, int]] = field(default_factory=dict)


class Script:
    """What is to happen when."""

    def __init__(self, rig: VirtualRig, wire: Wire, numbers: random.Random) -> None:
        self.rig, self.wire, self.numbers = rig, wire, numbers
        self.actor = Actor(self._turn)
        self._plans: list[tuple[int, int, Callable[[], None]]] = []
        self._order = 0

    def after(self, delay_ns: int, what: Callable[[], None]) -> None:
        """Do something later."""
        self._order += 1
        heapq.heappush(self._plans, (self.rig.clock.now_ns + delay_ns, self._order, what))
        self.actor.plan(self._plans[0][0])

    def device(self) -> Device:
        """One of the cameras."""
        return self.numbers.choice(self.rig.devices)

    def duration_ns(self, shortest_s: float, longest_s: float) -> int:
        """A length of time, short ones as likely as long ones."""
        return round(math.exp(self.numbers.uniform(math.log(shortest_s), math.log(longest_s))) * SECOND)

    def _turn(self) -> None:
        _, _, what = heapq.heappop(self._plans)
        what()
        self.actor.plan(self._plans[0][0] if self._plans else math.inf)


def camera_lost(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.01, 10.0)
    device.vanish()
    script.after(duration_ns, lambda: setattr(device, "present", True))
    says = f"{device.side} camera gone"
    return Expected(
        duration_ns,
        degraded=says if duration_ns > SECOND else None,
        perhaps=(says, f"no frames of the {device.side} camera"),
        counts={"reconnects": (1, 1)},
    )


def both_cameras_lost(script: Script) -> Expected:
    duration_ns = script.duration_ns(0.01, 10.0)
    for device in script.rig.devices:
        device.vanish()
        script.after(
            script.numbers.randint(1, duration_ns) if device.side == "left" else duration_ns,
            lambda device=device: setattr(device, "present", True),
        )
    return Expected(
        duration_ns, perhaps=("left camera gone", "right camera gone", "no triggers", "no frames of the left camera",
                              "no frames of the right camera"), counts={"reconnects": (2, 2)}
    )  # fmt: skip


def trigger_stops(script: Script) -> Expected:
    periods = script.duration_ns(0.05, 12.0) / SECOND * RATE_HZ
    phase = script.numbers.uniform(-0.45, 0.45)
    script.wire.stop_periods = max(round(periods), 2) + phase
    duration_ns = round(script.wire.stop_periods / RATE_HZ * SECOND)
    return Expected(
        duration_ns, degraded="no triggers" if duration_ns > 1.5 * SECOND else None, perhaps=("no triggers",)
    )  # fmt: skip


def trigger_halved(script: Script) -> Expected:
    script.wire.halved = script.numbers.randint(1, 200)
    return Expected(script.wire.halved * 2 * SECOND // int(RATE_HZ))


def trigger_doubled(script: Script) -> Expected:
    script.wire.doubled = pulses = script.numbers.randint(1, 300)
    return Expected(pulses * SECOND // int(RATE_HZ), counts={"surplus": (2 * pulses, 2 * pulses)})


def frames_lost(script: Script) -> Expected:
    device = script.device()
    device.lose = frames = script.numbers.randint(1, 300)
    return Expected(frames * SECOND // int(RATE_HZ), perhaps=(f"no frames of the {device.side} camera",))


def frames_of_both_lost(script: Script) -> Expected:
    frames = script.numbers.randint(1, 300)
    for device in script.rig.devices:
        device.lose = frames
    return Expected(frames * SECOND // int(RATE_HZ), perhaps=("no triggers",))


def frames_truncated(script: Script) -> Expected:
    device = script.device()
    device.truncate = frames = script.numbers.randint(1, 300)
    return Expected(frames * SECOND // int(RATE_HZ), perhaps=(f"no frames of the {device.side} camera",))


def triggers_ignored(script: Script) -> Expected:
    device = script.device()
    device.ignore = triggers = round(script.duration_ns(0.01, 14.0) / SECOND * RATE_HZ) + 1
    says = f"no frames of the {device.side} camera"
    return Expected(
        triggers * SECOND // int(RATE_HZ), degraded=says if triggers > 2 * RATE_HZ else None, perhaps=(says,)
    )  # fmt: skip


def frame_late(script: Script) -> Expected:
    script.device().delay_ns = script.numbers.randint(5, 240) * MS
    return Expected(SECOND // 4, counts={"stale": (0, 16), "undecided": (0, 16), "late": (0, 2), "mismatched": (0, 8)})


def writes_refused(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.refuses = True
    script.after(duration_ns, lambda: setattr(device, "refuses", False))
    most = round(duration_ns / SECOND * RATE_HZ) + 1
    return Expected(duration_ns, counts={"refused": (0, most), "late": (0, most), "mismatched": (0, most + 8)})


def writes_clipped(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.clips_us = script.numbers.uniform(500.0, 2000.0)
    script.after(duration_ns, lambda: setattr(device, "clips_us", LIMITS.max_time_us))
    # What was clipped stays so until the next change is written.
    return Expected(duration_ns + 3 * SECOND, counts={"mismatched": (0, round((duration_ns / SECOND + 3) * RATE_HZ))})


def writes_slow(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.write_ns = script.numbers.randint(6, 60) * MS
    script.after(duration_ns, lambda: setattr(device, "write_ns", 0))
    most = round(duration_ns / SECOND * RATE_HZ) + 1
    return Expected(duration_ns, counts={"late": (0, most), "mismatched": (0, most + 16)})


def clock_jumps(script: Script) -> Expected:
    device = script.device()
    device.clock_offset_ns += script.numbers.choice((-10, -1, 1, 10)) * SECOND + script.numbers.randint(0, SECOND)
    return Expected(SECOND)


def control_stalls(script: Script) -> Expected:
    duration_ns = script.duration_ns(0.02, 5.0)
    script.rig.stall_control(duration_ns)
    frames = round(duration_ns / SECOND * RATE_HZ)
    return Expected(
        duration_ns,
        perhaps=("no triggers", "frames make no stereo pairs"),
        counts={
            "stale": (max(frames - 24, 0) // 2, frames + 2),
            "undecided": (0, frames),
            "late": (0, 2),
            "mismatched": (0, 8),
        },
    )


def process_stops(script: Script) -> Expected:
    duration_ns = script.duration_ns(0.02, 5.0)
    script.rig.stop_process(duration_ns)
    frames = round(duration_ns / SECOND * RATE_HZ)
    return Expected(
        duration_ns,
        perhaps=("no triggers", "frames make no stereo pairs"),
        counts={"undecided": (0, frames), "stale": (0, 16), "late": (0, 2), "mismatched": (0, 8)},
    )


FAULTS: tuple[Callable[[Script], Expected], ...] = (
    camera_lost, both_cameras_lost, trigger_stops, trigger_halved, trigger_doubled, frames_lost, frames_of_both_lost,
    frames_truncated, triggers_ignored, frame_late, writes_refused, writes_clipped, writes_slow, clock_jumps,
    control_stalls, process_stops,
)  # fmt: skip
