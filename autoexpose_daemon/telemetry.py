"""What the daemon knows about itself: counts, rates and latencies, for the terminal, the log and the summary."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.publish.tally import PublishTally
from drivers.account import LossReason
from drivers.exposure import ExposureSetting
from drivers.frames import Side, StereoPair

_KEPT = 1 << 14  # four and a half minutes at 60 Hz: percentiles of the recent past in bounded memory
_PAUSE_NS = 1_000_000_000

GONE = "gone"
"""In `Telemetry.cameras`: not open, and tried again."""


class Durations:
    """Durations in ms, the latest of them kept."""

    def __init__(self) -> None:
        self._values_ms: deque[float] = deque(maxlen=_KEPT)

    def add_ns(self, duration_ns: int) -> None:
        """Add one duration in ns."""
        self._values_ms.append(duration_ns * 1e-6)

    def percentiles(self) -> dict[str, float | None]:
        """Median and 99th percentile in ms; None before the first."""
        if not self._values_ms:
            return {"p50": None, "p99": None}
        p50, p99 = np.percentile(np.array(self._values_ms), [50, 99])
        return {"p50": round(float(p50), 3), "p99": round(float(p99), 3)}


@dataclass(slots=True)
class Telemetry:
    """Counters and latest values. Written by the control thread, read by any other.

    Attributes
    ----------
    cameras
        For each side that was tried, model and serial, or `GONE`.
    last_frame_ns, last_pair_ns
        When each camera's newest whole frame, and the newest complete pair, arrived (CLOCK_MONOTONIC).
    undecided_pairs
        Pairs that were passed on, but not decided on: a newer one was there before control got to them.
    clipped_writes
        Writes of which a camera took something else.
    astray_frames
        Frames that were taken with a setting that was not written; see `EffectWatch`.
    untold_frames
        Frames that did not say how they were taken, though the camera's frames did before.
    clock_jumps
        How often the clock of a camera jumped.
    complaints
        What is wrong with the cameras at present, in words, by camera and kind.
    misfits
        For each side whose calibration does not fit, why, in words.
    publishing
        What became of the frames on their way out; None when they are not to be published.
    """

    pairs: int = 0
    lost: dict[LossReason, int] = field(default_factory=dict)
    surplus_frames: int = 0
    undecided_pairs: int = 0
    mismatched_pairs: int = 0
    unexplained_mismatches: int = 0
    late_writes: int = 0
    refused_writes: int = 0
    clipped_writes: int = 0
    astray_frames: int = 0
    untold_frames: int = 0
    clock_jumps: int = 0
    reconnects: int = 0
    cameras: dict[Side, str] = field(default_factory=dict)
    last_frame_ns: dict[Side, int] = field(default_factory=dict)
    last_pair_ns: int | None = None
    complaints: dict[tuple[Side, str], str] = field(default_factory=dict)
    misfits: dict[Side, str] = field(default_factory=dict)
    applied: ExposureSetting | None = None
    decision: Decision | None = None
    drift_grey: dict[Side, float] = field(default_factory=dict)
    decision_ms: Durations = field(default_factory=Durations)
    write_ms: Durations = field(default_factory=Durations)
    frame_to_node_ms: Durations = field(default_factory=Durations)
    publishing: PublishTally | None = None
    _recent_ns: deque[int] = field(default_factory=lambda: deque(maxlen=120))

    def delivered(self, pair: StereoPair, complete: bool) -> None:
        """Note what control saw: a `complete` pair, or what one camera of two gave."""
        self.applied = pair.left.setting
        if complete:
            self._recent_ns.append(pair.left.host_time_ns)
            self.last_pair_ns = max(frame.arrival_time_ns for frame in pair.frames)

    @property
    def oddities(self) -> dict[str, int]:
        """What should not happen and did, in words, with its count."""
        counts = {
            "pairs without a decision": self.undecided_pairs,
            "mismatched pairs": self.mismatched_pairs,
            "mismatches without a late write": self.unexplained_mismatches,
            "late writes": self.late_writes,
            "refused writes": self.refused_writes,
            "clipped writes": self.clipped_writes,
            "frames not as written": self.astray_frames,
            "frames that did not say how they were taken": self.untold_frames,
            "jumps of a camera's clock": self.clock_jumps,
            "reconnects": self.reconnects,
            "surplus frames": self.surplus_frames,
        }
        return {name: count for name, count in counts.items() if count}

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

    def line(self, now_ns: int) -> str:
        """The state in one line."""
        lost = ", ".join(f"{count} {reason}" for reason, count in self.lost.items() if count) or "none"
        parts = [f"{self.rate_hz(now_ns):.1f} pairs/s", f"{self.pairs} pairs", f"lost: {lost}"]
        if self.applied is not None:
            parts.append(f"{self.applied} (E {self.applied.level:.2f})")
        if self.decision is not None:
            parts.append(f"metric {self.decision.metric:.4f}")
        parts += [f"{side} response off by {grey:.1f} grey" for side, grey in list(self.drift_grey.items())]
        parts += [f"{count} {name}" for name, count in self.oddities.items()]
        if self.publishing is not None:
            parts += [f"{title} {text}" for title, text in self.publishing.lines()]
        latency = self.frame_to_node_ms.percentiles()
        if latency["p99"] is not None:
            parts.append(f"frame to node {latency['p50']:.1f}/{latency['p99']:.1f} ms")
        return "; ".join(parts)
