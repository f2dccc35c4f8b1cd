"""What the first frames of a rig reveal about its triggers."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

from drivers.triggers.rate import mean_period_ns, wrong_rate
from imaging.frames import Side

PATIENCE_NS = 3_000_000_000
PATIENCE_PERIODS = 3
"""A camera that has waited longer than both has no trigger."""

JUDGED_FRAMES = 20
"""The latest of each camera: enough for a verdict that a lost frame or two does not change, and so few that a trigger
generator a little off its rate does not drift by `SKEW_TOLERANCE`."""

SKEW_TOLERANCE = 0.1
"""Part of a period by which left and right may start apart; on one trigger wire it is a few microseconds."""


class StartCheck:
    """Checks that triggers arrive, and that left and right start together.

    Times are CLOCK_MONOTONIC, in ns. Each finding is one sentence, given once.

    Parameters
    ----------
    sources
        For each side, the TriggerSource of its camera; a camera that runs freely has none and is not judged.
    rate_hz
        Rate of the triggers, as configured.
    by_host
        Whether the host gives them: then there is no wire to check.
    """

    def __init__(self, sources: Mapping[Side, str], rate_hz: float, by_host: bool = False) -> None:
        self._sources = sources
        self._by_host = by_host
        self._rate_hz = rate_hz
        self._patience_ns = max(PATIENCE_NS, round(PATIENCE_PERIODS * 1e9 / rate_hz))
        self._waits_since_ns: dict[Side, int] = {}
        self._triggered: set[Side] = set()
        self._times_ns: dict[Side, deque[int]] = {side: deque(maxlen=JUDGED_FRAMES) for side in sources}
        self._reported: set[str] = set()
        self._done = False

    def ready(self, side: Side, now_ns: int) -> None:
        """A camera waits for triggers from now on."""
        if side in self._sources and side not in self._triggered:
            self._waits_since_ns[side] = now_ns

    def gone(self, side: Side) -> None:
        """A camera is lost, or could not be opened: that it sends nothing is not for want of triggers."""
        self._waits_since_ns.pop(side, None)

    def frame(self, side: Side, time_ns: int | None) -> None:
        """A camera started an exposure, whatever became of its frame; None: at an unknown time."""
        if side not in self._sources:
            return
        self._waits_since_ns.pop(side, None)
        self._triggered.add(side)
        if time_ns is not None:
            self._times_ns[side].append(time_ns)

    def findings(self, now_ns: int) -> list[str]:
        """What is wrong, and what to check on the robot; each finding only once."""
        if self._done:
            return []
        self._done = all(len(times_ns) == JUDGED_FRAMES for times_ns in self._times_ns.values())
        new = [finding for finding in self._all(now_ns) if finding not in self._reported]
        self._reported.update(new)
        return new

    def _all(self, now_ns: int) -> Iterator[str]:
        yield from self._without_pulses(now_ns)
        judged = {side: times_ns for side, times_ns in self._times_ns.items() if len(times_ns) == JUDGED_FRAMES}
        if len(judged) == 2 and all(map(self._at_rate, judged.values())):  # at another rate the skew means nothing
            yield from self._skew(*judged.values())

    def _without_pulses(self, now_ns: int) -> Iterator[str]:
        waiting = self._waits_since_ns.items()
        silent = [side for side, since_ns in waiting if now_ns - since_ns > self._patience_ns]
        if silent and len(silent) == len(waiting) and not self._triggered:
            sources = " and ".join(sorted({self._sources[side] for side in silent}))
            waited = f"{self._patience_ns * 1e-9:.3g} s"
            yield (
                f"no trigger pulse on {sources} for {waited}: check that the trigger source runs, its "
                "wires and its voltage"
                if not self._by_host
                else f"no frame for {waited} although the cameras are triggered: check the network"
            )
            return
        if not any(len(times_ns) == JUDGED_FRAMES for times_ns in self._times_ns.values()):
            return  # the first pulse may just have come, and one camera's frame before the other's
        for side in silent:
            yield (
                f"the {side} camera gets no trigger pulse, the other one does: check the wire to its "
                f"{self._sources[side]}"
                if not self._by_host
                else f"no frame from the {side} camera although it is triggered: check its cable"
            )

    def _at_rate(self, times_ns: Iterable[int]) -> bool:
        period_ns = mean_period_ns([later - earlier for earlier, later in pairwise(times_ns)])
        return wrong_rate(period_ns, self._rate_hz) is None

    def _skew(self, left_ns: Iterable[int], right_ns: Iterable[int]) -> Iterator[str]:
        period_ns = 1e9 / self._rate_hz
        skews_ns = [abs(math.remainder(right - left, period_ns)) for left, right in zip(left_ns, right_ns, strict=True)]
        skew_ns = statistics.median(skews_ns)
        if skew_ns > SKEW_TOLERANCE * period_ns:
            apart = f"left and right start {skew_ns * 1e-6:.1f} ms apart: check that"
            yield (
                f"{apart} both share one trigger, and that neither has a TriggerDelay or triggers on another edge"
                if not self._by_host
                else f"{apart} neither has a TriggerDelay, and that this machine is not too busy to trigger in time"
            )
