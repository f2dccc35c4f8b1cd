"""What the daemon knows about itself: counts, rates and latencies, for the terminal, the log and the summary."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.imu import ImuTally
from autoexpose_daemon.status.publishing import PublishTally
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.frames import Side, StereoPair
from drivers.triggers.account import LossReason

_KEPT = 1 << 14  # four and a half minutes at 60 Hz: percentiles of the recent past in bounded memory
_PAUSE_NS = 1_000_000_000

GONE = "gone"
"""In `Telemetry.cameras`: not open, and tried again."""


class Durations:
    """Durations in ms: all of them counted and summed up, the latest of them kept. One thread adds, others read."""

    def __init__(self) -> None:
        self.count = 0
        self.sum_ms = 0.0
        self._latest_ms = np.empty(_KEPT, np.float32)

    def add_ns(self, duration_ns: int) -> None:
        """Add one duration in ns."""
        duration_ms = duration_ns * 1e-6
        self._latest_ms[self.count % _KEPT] = duration_ms
        self.sum_ms += duration_ms
        self.count += 1

    @property
    def latest_ms(self) -> NDArray[np.float32]:
        """The latest of them, in no order."""
        return self._latest_ms[: self.count]

    def percentiles(self) -> dict[str, float | None]:
        """Median and 99th percentile of the latest, in ms; None before the first."""
        if not self.count:
            return {"p50": None, "p99": None}
        p50, p99 = np.percentile(self.latest_ms, [50, 99])
        return {"p50": round(float(p50), 3), "p99": round(float(p99), 3)}


class RecorderCounts(Protocol):
    """What a recorder tells of itself; itself it is an extra."""

    steps: int
    dropped: int
    failure: str | None


@dataclass(slots=True)
class Telemetry:
    """Counters and latest values. Written by the control thread, read by any other.

    Attributes
    ----------
    opened_ns
        When the cameras began to be opened (CLOCK_MONOTONIC): all counts are since then.
    failure
        What ends the daemon, in words; None: nothing has.
    cameras
        For each side that was tried, model and serial, or `GONE`.
    last_frame_ns, last_pair_ns
        When each camera's newest whole frame, and the newest complete pair, arrived (CLOCK_MONOTONIC).
    lost
        Triggers that made no pair, by reason.
    complaints
        What is wrong with the cameras at present, in words, by camera and kind.
    misfits
        For each side whose calibration does not fit, why, in words.
    applied, newest
        The setting of the newest frame that control saw, and of each camera's newest.
    pairing_ms, decision_ms, held_ms, write_ms, frame_to_node_ms, command_to_effect_ms
        See `DURATIONS`.
    publishing, recorder
        What became of the frames on their way out, and to disk; None when there is no such way.
    imu
        What becomes of the samples of the IMU; None where none is configured.
    """

    opened_ns: int | None = None
    failure: str | None = None
    counts: Counts = field(default_factory=Counts)
    lost: dict[LossReason, int] = field(default_factory=dict)
    cameras: dict[Side, str] = field(default_factory=dict)
    last_frame_ns: dict[Side, int] = field(default_factory=dict)
    last_pair_ns: int | None = None
    complaints: dict[tuple[Side, str], str] = field(default_factory=dict)
    misfits: dict[Side, str] = field(default_factory=dict)
    applied: ExposureSetting | None = None
    newest: dict[Side, ExposureSetting] = field(default_factory=dict)
    decision: Decision | None = None
    drift_grey: dict[Side, float] = field(default_factory=dict)
    pairing_ms: Durations = field(default_factory=Durations)
    decision_ms: Durations = field(default_factory=Durations)
    held_ms: Durations = field(default_factory=Durations)
    write_ms: Durations = field(default_factory=Durations)
    frame_to_node_ms: Durations = field(default_factory=Durations)
    command_to_effect_ms: Durations = field(default_factory=Durations)
    publishing: PublishTally | None = None
    recorder: RecorderCounts | None = None
    imu: ImuTally | None = None
    _recent_ns: deque[int] = field(default_factory=lambda: deque(maxlen=120))

    @property
    def present(self) -> list[Side]:
        """The cameras that are open."""
        return [side for side, camera in self.cameras.items() if camera != GONE]

    def failed(self, error: BaseException) -> None:
        """Note what ends the daemon."""
        self.failure = str(error) or type(error).__name__

    def delivered(self, pair: StereoPair, complete: bool) -> None:
        """Note what control saw: a `complete` pair, or what one camera of two gave."""
        self.applied = pair.reference.setting
        self.newest.update({side: frame.setting for side, frame in pair.frames.items()})
        if complete:
            self._recent_ns.append(pair.reference.host_time_ns)
            self.last_pair_ns = max(frame.arrival_time_ns for frame in pair.frames.values())

    def decided(self, decision: Decision, limits: ExposureLimits) -> None:
        """Note a decision made within limits."""
        self.decision = decision
        if decision.level <= limits.darkest.level:
            self.counts.decisions_at_darkest_limit += 1
        elif decision.level >= limits.brightest.level:
            self.counts.decisions_at_brightest_limit += 1

    def rate_hz(self, now_ns: int) -> float:
        """Complete pairs per second over the last of them; 0 when none came for a second."""
        times_ns = list(self._recent_ns)
        if len(times_ns) < 2 or times_ns[-1] <= times_ns[0] or now_ns - times_ns[-1] > _PAUSE_NS:
            return 0.0
        return (len(times_ns) - 1) * 1e9 / (times_ns[-1] - times_ns[0])

    def brief(self, now_ns: int) -> str:
        """Rate and exposure, in a few words."""
        rate = f"{self.rate_hz(now_ns):.1f} pairs/s"
        return rate if self.applied is None else f"{rate}, {self.applied}"
