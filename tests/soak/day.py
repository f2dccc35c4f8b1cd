"""A day of the daemon in virtual time, or a part of it, with a fault every minute, and the books of it."""

from __future__ import annotations

import logging
import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.status.counters import counters
from autoexpose_daemon.status.states import Health, State
from drivers.triggers.outcomes import LossReason, missing
from tests.soak.camera import VirtualFrame
from tests.soak.clock import SECOND
from tests.soak.faults import FAULTS, Expected, Script
from tests.soak.rig import VirtualRig, configuration
from tests.soak.wire import Wire

MINUTE_NS = 60 * SECOND
RECOVERY_NS = 6 * SECOND
"""So long after the cause of a fault all is well again, at most: a camera is tried every two seconds."""

QUIET_NS = 5 * SECOND
"""Without a fault, at the beginning of each minute."""

LOG_LINES = 40
"""A line an event, never one a frame: more than so many in a minute are too many."""


@dataclass
class Minute:
    """What a minute brought, and what is wrong with it."""

    fault: str
    counts: Counter[str]
    recovered_ns: int
    wrong: list[str] = field(default_factory=list)


class LogCounter(logging.Handler):
    """Counts lines of the log."""

    def __init__(self) -> None:
        super().__init__(logging.INFO)
        self.lines = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.lines += 1


class Day:
    """A virtual rig and the books of it."""

    def __init__(self, seed: int, log: LogCounter, cameras: int = 2) -> None:
        self._log = log
        config = configuration(cameras)
        self.rig = VirtualRig(seed, self._see_pair, self._see_health, config=config)
        self._cameras = tuple(config.cameras)
        self._losses = (*LossReason, *map(missing, self._cameras))
        self._numbers = random.Random(seed)
        self.wire = Wire(self.rig, self.rig.clock.now_ns + 4 * SECOND)
        self._script = Script(self.rig, self.wire, self._numbers)
        self._actors = [*self.wire.actors, self._script.actor]
        self._bag: list[int] = []
        self._last_pulse = -1
        self._mispaired: list[str] = []
        self._healths: list[tuple[int, Health]] = []
        self._begin_ns = self.rig.clock.now_ns + 10 * SECOND
        self._run_to(self._begin_ns)
        self._before, self._triggers, self._extra = self._counts(), self.wire.triggers, self.wire.extra
        self.wire.lost()

    def minutes(self, count: int) -> Iterator[Minute]:
        """Live through so many minutes, with each fault once before any comes again."""
        for _ in range(count):
            if not self._bag:
                self._bag = self._numbers.sample(range(len(FAULTS)), len(FAULTS))
            yield self._minute(self._bag.pop())

    def close(self) -> str | None:
        """Have the daemon stop; what is then wrong with its account of the whole day, if anything."""
        self.rig.control.close()
        tally = self.rig.control.record.tally
        beside = tally.lost[LossReason.STARTUP] + tally.lost[LossReason.SHUTDOWN]  # a camera may take longer to open
        if tally.triggers - beside == self.wire.triggers and tally.lost[LossReason.SHUTDOWN] <= 1:
            return None
        return f"{self.wire.triggers} triggers in all; accounted for: {tally}"

    def _minute(self, fault: int) -> Minute:
        self._healths.clear()
        self._log.lines = 0
        self._run_to(self.rig.clock.now_ns + QUIET_NS + self._numbers.randrange(10 * SECOND))
        began_ns = self.rig.clock.now_ns
        expected = FAULTS[fault](self._script)
        self._begin_ns += MINUTE_NS
        self._run_to(self._begin_ns)
        after = self._counts()
        counts = Counter({name: count - self._before[name] for name, count in after.items()})
        self._before = after
        recovered_ns = self._healths[-1][0] - began_ns - expected.duration_ns if self._healths else 0
        minute = Minute(FAULTS[fault].__name__, counts, max(recovered_ns, 0))
        minute.wrong += self._wrong_counts(counts, expected)
        minute.wrong += self._wrong_health(expected, recovered_ns)
        minute.wrong += self._mispaired
        if self._log.lines > LOG_LINES:
            minute.wrong.append(f"{self._log.lines} lines in the log")
        self._mispaired.clear()
        return minute

    def _run_to(self, time_ns: int) -> None:
        """Up to the pulse next to a time, when all frames of the one before have been decided on."""
        self.rig.run(self._actors, time_ns)
        self.rig.run(self._actors, int(self.wire.actors[0].due_ns) - 1)

    def _wrong_counts(self, counts: Counter[str], expected: Expected) -> Iterator[str]:
        triggers = self.wire.triggers - self._triggers
        self._triggers = self.wire.triggers
        accounted = counts["pairs"] + sum(counts[reason] for reason in self._losses)
        if accounted != triggers:
            yield f"{triggers} triggers, {accounted} accounted for"
        for camera in self._cameras:
            frames = counts[f"frames of {camera}"] + counts[f"lost of {camera}"]
            if frames != triggers:
                yield f"{triggers} triggers, {frames} of the {camera} camera accounted for"
        lost = self.wire.lost()
        for name in counts.keys() - {"pairs", *(f"frames of {camera}" for camera in self._cameras)}:
            least, most = expected.counts.get(name, (0, 0))
            if name.startswith("lost of"):
                most = sum(expected.counts.get(reason, (0, 0))[1] for reason in ("stale", "incomplete"))
            if not least <= counts[name] - lost[name] <= most:
                yield f"{name}: {counts[name]} counted, {lost[name]} on the wire and {least} to {most} by the fault"

    def _wrong_health(self, expected: Expected, recovered_ns: int) -> Iterator[str]:
        said = {reason for _, health in self._healths for reason in health.reasons}
        if expected.says is not None and not any(expected.says in reason for reason in said):
            yield f"the state never said {expected.says!r}"
        for reason in sorted(said):
            if not any(part in reason for part in (expected.says, *expected.may_say) if part is not None):
                yield f"the state said {reason!r}"
        if self._healths and self._healths[-1][1].state is not State.EXPOSING:
            yield f"still {self._healths[-1][1]}"
        if recovered_ns > RECOVERY_NS:
            yield f"all well only {recovered_ns / SECOND:.1f} s after the fault"

    def _counts(self) -> dict[str, int]:
        telemetry = self.rig.control.telemetry
        losses = {str(reason): telemetry.lost.get(reason, 0) for reason in self._losses}
        counted = counters(telemetry.counts)
        anomalies = {counter.name: count for counter, count in counted if counter.unusual}
        frames = {f"frames of {camera}": telemetry.cameras.frames.get(camera, 0) for camera in self._cameras}
        frames |= {f"lost of {camera}": telemetry.cameras.frames_lost.get(camera, 0) for camera in self._cameras}
        return losses | anomalies | frames | {"pairs": telemetry.counts.pairs}

    def _see_pair(self, step: ControlStep) -> None:
        pair = step.pair
        pulses = {frame.pulse for frame in pair.frames.values() if isinstance(frame, VirtualFrame)}
        if len(pulses) > 1:
            self._mispaired.append(f"a set of the pulses {pulses}")
        elif len(pair.frames) == len(self._cameras) and (pulse := pulses.pop()) >= 0:
            if pulse <= self._last_pulse:
                self._mispaired.append(f"pulse {pulse} after {self._last_pulse}")
            self._last_pulse = pulse

    def _see_health(self, now_ns: int, health: Health) -> None:
        self._healths.append((now_ns, health))
