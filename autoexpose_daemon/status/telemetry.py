"""What the daemon measures about itself while it runs: counts, rates and durations."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.keys import ONE_GROUP
from autoexpose_daemon.status.counters import Counts, ImuTally, LightTally, RequestTally, TrackingTally
from drivers.camera import PtpState
from drivers.rig.events import Command, Written
from drivers.triggers import RigRecord
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, FrameSet
from imaging.python310 import StrEnum

GONE_NS = 5_000_000_000
"""A consumer that has been silent this long has left; consumers report once a second."""

MOST_LISTED = 32
MOST_KNOWN = 1024
"""How many consumers are listed, and how many remembered: anyone can send reports, under invented names."""


class DropReason(StrEnum):
    """Why a pair was not published; the names are fixed for log and metrics."""

    NOT_OPEN = "not_open"
    """There was no session."""
    BEHIND = "behind"
    """The publisher was still busy with earlier pairs when newer ones arrived."""
    REFUSED = "refused"
    """zenoh rejected it."""


@dataclass(slots=True)
class _Consumer:
    since_ns: int
    heard_ns: int
    tally: ConsumerTally
    takes_pairs: bool = False


class Consumers:
    """The consumers that report, for as long as they do. Any thread may add or read; times are from CLOCK_MONOTONIC.

    Neither a name nor zenoh shows who sent a report. So consumers whose count of pairs has grown come first, then those
    known longest; invented names that do not report again make room for others.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[str, _Consumer] = {}  # the one heard longest ago comes first

    def heard(self, name: str, tally: ConsumerTally, now_ns: int) -> bool:
        """Note a report; True if it first shows that this consumer takes pairs, and all consumers are listed."""
        with self._lock:
            self._forget(now_ns)
            consumer = self._known.pop(name, None)
            if consumer is None:
                self._make_room()
                consumer = _Consumer(now_ns, now_ns, tally)
            begins = not consumer.takes_pairs and tally.pairs > consumer.tally.pairs
            self._known[name] = consumer
            consumer.heard_ns, consumer.tally = now_ns, tally
            consumer.takes_pairs |= begins
            return begins and len(self._known) <= MOST_LISTED

    def listed(self, now_ns: int) -> Mapping[str, ConsumerTally]:
        """At most `MOST_LISTED` consumers that report, and their last reports."""
        with self._lock:
            self._forget(now_ns)
            order = sorted(self._known.items(), key=lambda item: (not item[1].takes_pairs, item[1].since_ns))
            return {name: consumer.tally for name, consumer in order[:MOST_LISTED]}

    def unlisted(self, now_ns: int) -> int:
        """How many more consumers report."""
        with self._lock:
            self._forget(now_ns)
            return max(0, len(self._known) - MOST_LISTED)

    def _forget(self, now_ns: int) -> None:
        while self._known and now_ns - self._known[first := next(iter(self._known))].heard_ns >= GONE_NS:
            del self._known[first]

    def _make_room(self) -> None:
        if len(self._known) == MOST_KNOWN:
            idle = (name for name, consumer in self._known.items() if not consumer.takes_pairs)
            del self._known[next(idle, next(iter(self._known)))]


@dataclass(slots=True)
class PublishTally:
    """Counts of one publisher: each pair offered was sent, was dropped for one reason, or is waiting."""

    offered: int = 0
    sent: int = 0
    dropped: Counter[DropReason] = field(default_factory=Counter)
    trouble: str = ""  # why there is no session, in words; empty if there is one
    consumers: Consumers = field(default_factory=Consumers)  # the consumers that report


_KEPT = 1 << 14  # four and a half minutes at 60 Hz
_PAUSE_S = 1.0
_PAUSE_PERIODS = 5.0
"""What has not come for longer than both has stopped."""

GONE = "gone"
"""In place of a camera's name: not open."""


class DurationSamples:
    """Durations in ms: count and sum of all of them, and the latest. One thread adds, others read."""

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
        """The latest durations, in no particular order."""
        return self._latest_ms[: self.count]

    def percentiles(self) -> dict[str, float | None]:
        """Median and 99th percentile of the latest durations, in ms; None before the first."""
        if not self.count:
            return {"p50": None, "p99": None}
        p50, p99 = np.percentile(self.latest_ms, [50, 99])
        return {"p50": round(float(p50), 3), "p99": round(float(p99), 3)}


class RecorderCounts(Protocol):
    """What a recorder counts; a protocol, because the recorder is an optional extra."""

    @property
    def steps(self) -> int: ...  # noqa: D102
    @property
    def dropped(self) -> int: ...  # noqa: D102
    @property
    def failure(self) -> str | None: ...  # noqa: D102


@dataclass(slots=True)
class CameraTally:
    """What is known of the cameras; written by `RigHealth`, but for the account of their frames."""

    # model and serial of each camera that the daemon tried to open, or `GONE`
    names: dict[CameraName, str] = field(default_factory=dict)
    # arrival of each camera's newest whole frame (CLOCK_MONOTONIC)
    last_frame_ns: dict[CameraName, int] = field(default_factory=dict)
    # what each open camera says about its PTP clock, in `trigger.mode` ptp
    ptp: dict[CameraName, PtpState] = field(default_factory=dict)
    # how warm each open camera is inside (degrees Celsius), and how fast its link is, if it says so
    temperatures_c: dict[CameraName, float] = field(default_factory=dict)
    links_mbps: dict[CameraName, float] = field(default_factory=dict)
    # what is wrong with the cameras now, in words, by camera and kind
    troubles: dict[tuple[CameraName, str], str] = field(default_factory=dict)
    # why a camera's calibration does not fit, in words, for each such camera
    misfits: dict[CameraName, str] = field(default_factory=dict)
    # triggers whose frame arrived whole, and those whose frame did not
    frames: dict[CameraName, int] = field(default_factory=dict)
    frames_lost: dict[CameraName, int] = field(default_factory=dict)
    # error of its response (grey levels rms), for each camera with a verdict
    drift_grey: dict[CameraName, float] = field(default_factory=dict)

    @property
    def present(self) -> list[CameraName]:
        """The cameras that are open."""
        return [name for name, camera in self.names.items() if camera != GONE]


@dataclass(slots=True)
class GroupTally:
    """What is known of cameras that are exposed together; written by their `GroupControl`."""

    cameras: tuple[CameraName, ...] = ()
    policy: str = ""
    # the latest decision, and the flicker found in the light; None: none was found, or it is not looked for
    decision: Decision | None = None
    flicker_hz: float | None = None
    requests: RequestTally = field(default_factory=RequestTally)  # what was requested of control while it runs
    decision_ms: DurationSamples = field(default_factory=DurationSamples)


@dataclass(slots=True)
class Telemetry:
    """Counts and latest values, read by any thread. Each field, and each of the counts, is written by one party alone.

    `RigControl` writes, through the methods, what has no tally of its own.
    """

    period_s: float = 0.0  # time between two triggers
    # when the daemon began to open the cameras (CLOCK_MONOTONIC), with which all counts begin, and what ended it, in
    # words; None before that. By `Daemon`
    opened_ns: int | None = None
    failure: str | None = None
    counts: Counts = field(default_factory=Counts)  # each by whoever knows: see `Counts`
    cameras: CameraTally = field(default_factory=CameraTally)  # by `RigHealth`
    groups: dict[str, GroupTally] = field(default_factory=lambda: {ONE_GROUP: GroupTally()})
    # each by what counts there; None without it
    publishing: PublishTally | None = None
    recorder: RecorderCounts | None = None
    imu: ImuTally | None = None
    light_ahead: LightTally | None = None
    tracking: TrackingTally | None = None
    lost: dict[str, int] = field(default_factory=dict)  # triggers that made no pair, by reason
    last_pair_ns: int | None = None  # arrival of the newest complete pair (CLOCK_MONOTONIC)
    # the setting of the newest frame that control saw, and of the newest frame of each camera, without those that have
    # stopped sending while another goes on
    applied: ExposureSetting | None = None
    newest: dict[CameraName, ExposureSetting] = field(default_factory=dict)
    # see `DURATIONS`
    pairing_ms: DurationSamples = field(default_factory=DurationSamples)
    decision_ms: DurationSamples = field(default_factory=DurationSamples)
    held_ms: DurationSamples = field(default_factory=DurationSamples)
    write_ms: DurationSamples = field(default_factory=DurationSamples)
    frame_to_node_ms: DurationSamples = field(default_factory=DurationSamples)
    command_to_effect_ms: DurationSamples = field(default_factory=DurationSamples)
    skew_ms: DurationSamples = field(default_factory=DurationSamples)
    _recent_ns: deque[int] = field(default_factory=lambda: deque(maxlen=120))

    def failed(self, error: BaseException) -> None:
        """Note the error that ends the daemon."""
        self.failure = str(error) or type(error).__name__

    def account(self, record: RigRecord) -> None:
        """Note the present account of triggers and writes."""
        self.counts.pairs = record.tally.pairs
        self.counts.surplus_frames = record.tally.surplus_frames
        self.counts.late_writes = record.late_writes
        self.lost = dict(record.tally.lost)
        self.cameras.frames, self.cameras.frames_lost = dict(record.tally.frames), dict(record.tally.frames_lost)

    def written(self, write: Written, command: Command | None) -> None:
        """Note how long a write took, if a decision caused it; a camera is also written when it is opened."""
        if command is not None:
            self.held_ms.add_ns(write.started_ns - command.decided_ns)
            self.write_ms.add_ns(write.finished_ns - write.started_ns)
            self.frame_to_node_ms.add_ns(write.finished_ns - command.arrival_ns)

    def delivered(self, pair: FrameSet, record: RigRecord, skew_ns: int, complete: bool) -> None:
        """Note a pair that control saw; not `complete`: a camera is missing."""
        if record.mismatched(pair):
            self.counts.mismatched_pairs += 1
            self.counts.unexplained_mismatches += not record.explains_mismatch(pair)
        for camera, frame in pair.frames.items():
            if (effect_ns := record.history(camera).first_effect_ns(frame)) is not None:
                self.command_to_effect_ms.add_ns(effect_ns)
        if len(pair.frames) > 1:
            self.skew_ms.add_ns(skew_ns)
        self.applied = pair.reference.setting
        arrival_ns = max(frame.arrival_time_ns for frame in pair.frames.values())
        since_ns = arrival_ns - self._pause_ns
        going_on = {
            camera: it for camera, it in self.newest.items() if self.cameras.last_frame_ns.get(camera, 0) >= since_ns
        }
        self.newest = going_on | {camera: frame.setting for camera, frame in pair.frames.items()}
        if complete:
            start_ns = pair.reference.host_time_ns
            if self._recent_ns and start_ns - self._recent_ns[-1] > self._pause_ns:
                self._recent_ns.clear()  # the pause is no part of the present rate
            self._recent_ns.append(start_ns)
            self.last_pair_ns = arrival_ns

    @property
    def first_group(self) -> GroupTally:
        """The group of the first camera, which stands for the rig where one figure is to."""
        return next(iter(self.groups.values()))

    @property
    def decision(self) -> Decision | None:
        """The latest decision of the first group."""
        return self.first_group.decision

    @property
    def requests(self) -> RequestTally:
        """What was requested of the first group."""
        return self.first_group.requests

    def decided(self, decision: Decision, limits: ExposureLimits) -> None:
        """Note a decision made within limits."""
        if decision.level <= limits.darkest.level:
            self.counts.decisions_at_darkest_limit += 1
        elif decision.level >= limits.brightest.level:
            self.counts.decisions_at_brightest_limit += 1

    def rate_hz(self, now_ns: int) -> float:
        """Complete pairs per second over the last two seconds at 60 Hz; 0 if they have stopped."""
        times_ns = list(self._recent_ns)
        if len(times_ns) < 2 or times_ns[-1] <= times_ns[0] or now_ns - times_ns[-1] > self._pause_ns:
            return 0.0
        return (len(times_ns) - 1) * 1e9 / (times_ns[-1] - times_ns[0])

    @property
    def _pause_ns(self) -> float:
        return max(_PAUSE_S, _PAUSE_PERIODS * self.period_s) * 1e9

    def brief(self, now_ns: int) -> str:
        """Rate and exposure in a few words."""
        rate = f"{self.rate_hz(now_ns):.1f} pairs/s"
        return rate if self.applied is None else f"{rate}, {self.applied}"
