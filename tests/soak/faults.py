"""Faults, one a virtual minute: what they do, and what the daemon may show of each."""

from __future__ import annotations

import heapq
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from drivers.genicam.timeline import SURE_FRAMES
from drivers.triggers.rate import JUDGED_FRAMES
from tests.soak.camera import BUFFERS, LIMITS, Device
from tests.soak.clock import MS, SECOND, Actor
from tests.soak.rig import LONGEST_REST_NS, RATE_HZ, VirtualRig
from tests.soak.wire import Wire

STUCK_FRAMES = 180
"""After three seconds a camera that sends nothing while the other one does is reopened."""

NO_PAIRS = "frames form no"
"""Stereo pairs, or whole sets: also said for a moment when frames come again, between the first one and its partner."""

WRONG_RATE = "frames a second where"
SURELY_JUDGED = 3 * JUDGED_FRAMES + 5
"""Two whole windows, wherever the first of them begins."""

FIRST_PAIRS = {"pairs_without_decision": (0, 2)}
"""Of the first pairs after a silence one frame was decided on before its partner came."""

OVERTAKEN = FIRST_PAIRS | {"late_writes": (0, 10), "mismatched_pairs": (0, 3)}
"""A dead camera takes its time until it is known to be, and what is asked for meanwhile does not reach it."""

BEHIND = {"late_writes": (0, 2), "mismatched_pairs": (0, 8)}
"""Of control that was behind: the grid of triggers, by which it chose when to write, was old."""


@dataclass
class Expected:
    """What a fault shows, beside the losses that the wire knows of.

    Attributes
    ----------
    duration_ns
        How long its cause lasts.
    says
        What the state says meanwhile, for certain, or a part of it; None: it may go unnoticed.
    may_say
        What the state may say.
    counts
        Counters with the least and the most that the fault adds to them.
    """

    duration_ns: int
    says: str | None = None
    may_say: tuple[str, ...] = ()
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

    def several_devices(self) -> list[Device]:
        """Two cameras, or more, or all."""
        devices = self.rig.devices
        return self.numbers.sample(devices, self.numbers.randint(2, len(devices)))

    def duration_ns(self, shortest_s: float, longest_s: float) -> int:
        """A length of time, short ones as likely as long ones."""
        return round(math.exp(self.numbers.uniform(math.log(shortest_s), math.log(longest_s))) * SECOND)

    def _turn(self) -> None:
        _, _, what = heapq.heappop(self._plans)
        what()
        self.actor.plan(self._plans[0][0] if self._plans else math.inf)


def no_frames(device: Device) -> tuple[str, ...]:
    return f"no frames from the {device.camera} camera", NO_PAIRS


def periods_ns(periods: int) -> int:
    return round(periods / RATE_HZ * SECOND)


def frames_in(duration_ns: int) -> int:
    return round(duration_ns / SECOND * RATE_HZ) + 2


def camera_lost(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.01, 10.0)
    device.vanish()
    script.after(duration_ns, lambda: setattr(device, "present", True))
    gone = f"{device.camera} camera gone"
    counts = OVERTAKEN | {"reconnects": (1, 1)}
    return Expected(duration_ns, gone if duration_ns > 2 * SECOND else None, (gone, *no_frames(device)), counts)


def cameras_lost(script: Script) -> Expected:
    duration_ns, devices = script.duration_ns(0.01, 10.0), script.several_devices()
    for number, device in enumerate(devices):
        device.vanish()
        back_ns = script.numbers.randint(1, duration_ns) if number else duration_ns
        script.after(back_ns, partial(setattr, device, "present", True))
    counts = {what: (0, most * len(devices)) for what, (_, most) in OVERTAKEN.items()}
    counts |= {"reconnects": (len(devices), len(devices))}
    return Expected(duration_ns, None, ("camera gone", "no triggers", "no frames from the", NO_PAIRS), counts)


def trigger_stops(script: Script) -> Expected:
    pause_s = script.duration_ns(0.05, 12.0) / SECOND
    script.wire.stop_periods = max(round(pause_s * RATE_HZ), 2) + script.numbers.uniform(-0.45, 0.45)
    counts = FIRST_PAIRS | {
        "late_writes": (0, 2),
        "mismatched_pairs": (0, 2),
        "unexplained_mismatches": (0, 1),
    }  # it goes on in a phase that nobody expects
    # The first frame of a camera when it goes on may be lost on the wire: for a period, it alone is silent.
    may_say = ("no triggers", "no frames from the", NO_PAIRS)
    return Expected(round(pause_s * SECOND), "no triggers" if pause_s > 1.5 else None, may_say, counts)


def trigger_halved(script: Script) -> Expected:
    script.wire.halved = script.numbers.randint(1, 200)
    says = WRONG_RATE if script.wire.halved > SURELY_JUDGED else None
    return Expected(periods_ns(2 * script.wire.halved), says, (WRONG_RATE,))


def trigger_doubled(script: Script) -> Expected:
    script.wire.doubled = pulses = script.numbers.randint(1, 300)
    says = WRONG_RATE if pulses > SURELY_JUDGED else None
    surplus = len(script.rig.devices) * pulses
    return Expected(periods_ns(pulses), says, (WRONG_RATE,), {"surplus_frames": (surplus, surplus)})


def frames_lost(script: Script) -> Expected:
    device = script.device()
    device.lose = frames = script.numbers.randint(1, STUCK_FRAMES)
    return Expected(periods_ns(frames), None, no_frames(device), FIRST_PAIRS)


def frames_of_several_lost(script: Script) -> Expected:
    devices = script.several_devices()
    frames = script.numbers.randint(1, 300 if len(devices) == len(script.rig.devices) else STUCK_FRAMES)
    for device in devices:
        device.lose = frames
    return Expected(periods_ns(frames), None, ("no triggers", "no frames from the", NO_PAIRS), FIRST_PAIRS)


def frames_truncated(script: Script) -> Expected:
    device = script.device()
    device.truncate = frames = script.numbers.randint(1, STUCK_FRAMES)
    return Expected(periods_ns(frames), None, (*no_frames(device), "all its frames arrive incomplete"))


def triggers_ignored(script: Script) -> Expected:
    device = script.device()
    device.ignore = triggers = round(script.duration_ns(0.01, 14.0) / SECOND * RATE_HZ) + 1
    says = f"no frames from the {device.camera} camera" if triggers > 2 * RATE_HZ else None
    may_say, counts = no_frames(device), FIRST_PAIRS
    if triggers > STUCK_FRAMES:  # it is reopened, and what it ignored before counts as lost by that
        may_say = (*may_say, f"{device.camera} camera gone")
        counts = OVERTAKEN | {"reconnects": (0, 2), "camera_gone": (0, triggers), "trigger_ignored": (-triggers, 0)}
    return Expected(periods_ns(triggers), says, may_say, counts)


def frame_late(script: Script) -> Expected:
    script.device().delay_ns = script.numbers.randint(5, 240) * MS
    return Expected(SECOND // 4, counts=BEHIND | {"stale": (0, 16), "pairs_without_decision": (0, 16)})


def writes_refused(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.refuses = "ExposureTime refused"
    script.after(duration_ns, lambda: setattr(device, "refuses", ""))
    most = frames_in(duration_ns)
    return Expected(
        duration_ns,
        may_say=("was refused",),
        counts={"refused_writes": (0, most), "late_writes": (0, most), "mismatched_pairs": (0, most + 8)},
    )


def writes_clipped(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.clips_us = script.numbers.uniform(500.0, 1500.0)
    script.after(duration_ns, lambda: setattr(device, "clips_us", LIMITS.max_time_us))
    duration_ns += LONGEST_REST_NS  # what was clipped stays so until something else is written
    most = frames_in(duration_ns)
    counts = {"adjusted_writes": (0, most), "mismatched_pairs": (0, most + 8)}
    return Expected(duration_ns, may_say=("the camera took",), counts=counts)


def writes_slow(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 5.0)
    device.write_ns = script.numbers.randint(6, 60) * MS
    script.after(duration_ns, lambda: setattr(device, "write_ns", 0))
    most = frames_in(duration_ns)
    return Expected(
        duration_ns,
        counts={"late_writes": (0, most), "mismatched_pairs": (0, most + 16), "frames_off_setting": (0, most)},
    )


def exposure_freezes(script: Script) -> Expected:
    device, duration_ns = script.device(), script.duration_ns(0.2, 8.0)
    device.frozen = True
    script.after(duration_ns, lambda: setattr(device, "frozen", False))
    duration_ns += LONGEST_REST_NS
    most = frames_in(duration_ns)
    counts = dict.fromkeys(("frames_off_setting", "mismatched_pairs", "unexplained_mismatches"), (0, most))
    return Expected(duration_ns, may_say=("do not follow what is written",), counts=counts)


def clock_jumps(script: Script) -> Expected:
    device = script.device()
    device.clock_offset_ns += script.numbers.choice((-10, -1, 1, 10)) * SECOND + script.numbers.randrange(SECOND // 2)
    return Expected(SECOND, counts={"clock_jumps": (1, 1), "incomplete": (0, SURE_FRAMES - 1)})


def control_stalls(script: Script) -> Expected:
    duration_ns = script.duration_ns(0.02, 5.0)
    script.rig.stall_control(duration_ns)
    frames = frames_in(duration_ns)
    counts = BEHIND | {"stale": (max(frames - 24, 0) // 2, frames), "pairs_without_decision": (0, frames)}
    return Expected(duration_ns, None, ("no triggers", NO_PAIRS), counts)


def process_stops(script: Script) -> Expected:
    duration_ns = script.duration_ns(0.02, 5.0)
    script.rig.stop_process(duration_ns)
    counts = BEHIND | {"stale": (0, BUFFERS), "pairs_without_decision": (0, BUFFERS)}
    return Expected(duration_ns, None, ("no triggers", NO_PAIRS), counts)


FAULTS: tuple[Callable[[Script], Expected], ...] = (
    camera_lost, cameras_lost, trigger_stops, trigger_halved, trigger_doubled, frames_lost, frames_of_several_lost,
    frames_truncated, triggers_ignored, frame_late, writes_refused, writes_clipped, writes_slow, exposure_freezes,
    clock_jumps, control_stalls, process_stops,
)  # fmt: skip
