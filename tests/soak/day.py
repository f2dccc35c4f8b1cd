"""A day of the daemon in virtual time, or a part of it, with a fault every minute, and the books of it."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.states import Health, State
from drivers.frames import StereoPair
from tests.soak.clock import SECOND
from tests.soak.faults import FAULTS, Expected, Script
from tests.soak.rig import VirtualRig
from tests.soak.wire import Wire

MINUTE_NS = 60 * SECOND
RECOVERY_NS = 6 * SECOND
"""So long after the cause of a fault all is well again, at most: a camera is tried every two seconds."""

QUIET_NS = 5 * SECOND
"""Without a fault, at the beginning of each minute."""

LOSSES = ("startup", "shutdown", "left_missing", "right_missing", "both_missing", "incomplete", "trigger_ignored",
          "camera_gone", "stale")  # fmt: skip


@dataclass
class Minute:
    """What a minute brought, and what is wrong with it."""

    fault: str
    counts: Counter[str]
    recovered_ns: int
    wrong: list[str] = field(default_factory=list)


class Day:
    """A virtual rig and the books of it."""

    def __init__(self, seed: int) -> None:
        self.rig = VirtualRig(seed, self._see_pair, self._see_health)
        self._numbers = random.Random(seed)
        self.wire = Wire(self.rig, self.rig.clock.now_ns + 3 * SECOND + 1_234_567)
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

    def _minute(self, fault: int) -> Minute:
        self._healths.clear()
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
        self._mispaired.clear()
        return minute

    def _run_to(self, time_ns: int) -> None:
        """Up to the pulse next to a time, when all frames of the one before have been decided on."""
        self.rig.run(self._actors, time_ns)
        self.rig.run(self._actors, self.wire.actors[0].due_ns - 1)

    def _wrong_counts(self, counts: Counter[str], expected: Expected) -> Iterator[str]:
        triggers = self.wire.triggers - self._triggers
        self._triggers = self.wire.triggers
        accounted = counts["pairs"] + sum(counts[reason] for reason in LOSSES)
        if accounted != triggers:
            yield f"{triggers} triggers, {accounted} accounted for"
        lost = self.wire.lost()
        for name in (*LOSSES, "surplus", "undecided", "mismatched", "unexplained", "late", "refused", "reconnects"):
            least, most = expected.counts.get(name, (0, 0))
            if not least <= counts[name] - lost[name] <= most:
                yield f"{name}: {counts[name]} counted, {lost[name]} on the wire and {least} to {most} by the fault"

    def _wrong_health(self, expected: Expected, recovered_ns: int) -> Iterator[str]:
        said = {reason for _, health in self._healths for reason in health.reasons}
        if expected.degraded is not None and expected.degraded not in said:
            yield f"the state never said {expected.degraded!r}"
        for reason in sorted(said - {expected.degraded, *expected.perhaps}):
            yield f"the state said {reason!r}"
        if self._healths and self._healths[-1][1].state is not State.EXPOSING:
            yield f"still {self._healths[-1][1]}"
        if recovered_ns > RECOVERY_NS:
            yield f"all well only {recovered_ns / SECOND:.1f} s after the fault"

    def _counts(self) -> dict[str, int]:
        telemetry = self.rig.control.telemetry
        losses = {reason: telemetry.lost.get(reason, 0) for reason in LOSSES}
        return {
            **losses,
            "pairs": telemetry.pairs,
            "surplus": telemetry.surplus_frames,
            "undecided": telemetry.undecided_pairs,
            "mismatched": telemetry.mismatched_pairs,
            "unexplained": telemetry.unexplained_mismatches,
            "late": telemetry.late_writes,
            "refused": telemetry.refused_writes,
            "reconnects": telemetry.reconnects,
        }

    def _see_pair(self, pair: StereoPair, _decision: Decision | None) -> None:
        if pair.right is None:
            return
        left, right = pair.left.pulse, pair.right.pulse
        if left != right:
            self._mispaired.append(f"a pair of the pulses {left} and {right}")
        elif left >= 0:
            if left <= self._last_pulse:
                self._mispaired.append(f"pulse {left} after {self._last_pulse}")
            self._last_pulse = left

    def _see_health(self, now_ns: int, health: Health) -> None:
        self._healths.append((now_ns, health))
