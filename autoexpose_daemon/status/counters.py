"""What the daemon counts and measures, declared once: telemetry, status, metrics, page, terminal and log follow."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError

from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.messages.client import LAST_COUNT
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName
from imaging.python310 import StrEnum

Count = Annotated[int, Field(ge=0, le=LAST_COUNT)]
"""A count that may come from another process."""

Topic = Literal["triggers", "writes"]


@dataclass(frozen=True, slots=True)
class Counter:
    """One of the counters."""

    name: str  # its name in `Counts`, in the status and in metrics; begins or ends with what is counted
    topic: Topic  # the table of the page that shows it
    label: str  # its name in words, for terminal, page and log
    meaning: str  # what is counted, in a sentence
    # whether it should stay at 0. Terminal and log show it when it is not 0, and the page marks it
    unusual: bool = True


def _counter(topic: Topic, label: str, meaning: str, unusual: bool = True) -> Any:
    return field(default=0, metadata={"topic": topic, "label": label, "meaning": meaning, "unusual": unusual})


# fmt: off
# ruff: noqa: RUF009  (each call makes a field)
@dataclass(slots=True)
class Counts:
    """The counters, in the order in which they are shown; a daemon of a different version may lack some of them."""

    pairs: Count = _counter("triggers", "stereo pairs", "Triggers that made a whole set of frames.", unusual=False)
    pairs_without_decision: Count = _counter(
        "triggers", "pairs without a decision", "Pairs that control skipped for a newer one, or had used a frame of.")
    mismatched_pairs: Count = _counter(
        "triggers", "mismatched pairs", "Pairs whose frames were taken with different settings.")
    unexplained_mismatches: Count = _counter(
        "triggers", "unexplained mismatches", "Mismatched pairs that no late or adjusted write explains.")
    surplus_frames: Count = _counter(
        "triggers", "frames between triggers", "Frames that arrived between the expected triggers.")
    reconnects: Count = _counter("triggers", "reconnects", "Cameras that were lost and came back.")
    clock_jumps: Count = _counter("triggers", "jumps of a camera's clock", "Jumps of a camera's clock.")
    refused_packets: Count = _counter(
        "triggers", "refused packets", "Packets for a camera's stream that did not look like its own.")
    late_writes: Count = _counter("writes", "late writes", "Settings written too late for the exposure they were for.")
    refused_writes: Count = _counter("writes", "refused writes", "Settings that a camera refused.")
    adjusted_writes: Count = _counter(
        "writes", "adjusted writes", "Settings that a camera accepted with other values than those written.")
    frames_off_setting: Count = _counter(
        "writes", "frames off their setting", "Frames taken with a setting that was not written.")
    frames_without_exposure_metadata: Count = _counter(
        "writes", "frames without exposure metadata",
        "Frames that lacked exposure metadata although the camera had sent them before.")
    decisions_without_imu: Count = _counter(
        "writes", "decisions without the IMU", "Decisions by optical flow although an IMU is configured.")
    decisions_at_darkest_limit: Count = _counter(
        "writes", "decisions at the darkest limit", "Decisions held at the darkest setting allowed.", unusual=False)
    decisions_at_brightest_limit: Count = _counter(
        "writes", "decisions at the brightest limit", "Decisions held at the brightest setting allowed.", unusual=False)
# fmt: on


def counters(counts: Counts) -> Iterator[tuple[Counter, int]]:
    """Each of the counters, with its count."""
    for entry in fields(counts):
        yield Counter(entry.name, **entry.metadata), getattr(counts, entry.name)


def unusual_counts(counts: Counts) -> Iterator[tuple[Counter, int]]:
    """The counters that should be 0 and are not."""
    return ((counter, count) for counter, count in counters(counts) if counter.unusual and count)


@dataclass(frozen=True, slots=True)
class Duration:
    """One of the durations."""

    field: str  # its name in `Telemetry`, in `Status`, in the demo's summary and, without the unit, in metrics
    label: str  # its name in words, for terminal and page
    meaning: str  # what is measured, in a sentence


DURATIONS = (
    Duration("pairing_ms", "pairing", "From a pair in memory to the control step on it."),
    Duration("decision_ms", "decision", "One control step."),
    Duration("held_ms", "hold", "From a decision to the start of the safe write window."),
    Duration("write_ms", "write", "Writing exposure time and gain to a camera."),
    Duration("frame_to_node_ms", "frame to node", "From a pair in memory to the end of writing the decision on it."),
    Duration("command_to_effect_ms", "command to effect", "From a decision to the first exposure taken with it."),
    Duration("skew_ms", "skew", "Between the starts of a pair's two exposures, by the cameras' time stamps."),
)
"""In the order in which a frame goes through them; the first four follow without a gap, and add up to frame to node."""


@dataclass(slots=True)
class ImuTally:
    """Counts of one IMU, and what the latest decision used."""

    # messages with an angular rate, and messages without a credible one
    samples: Count = 0
    refused: Count = 0
    # the rate that the latest decision used; None: it used optical flow
    angular_rate_rad_s: Annotated[float, Field(ge=0, le=FASTEST_TURN_RAD_S)] | None = None
    trouble: str = ""  # why decisions use optical flow, or did less than a second ago, in words; empty if they do not


@dataclass(slots=True)
class LightTally:
    """Counts of messages, and how the latest decision used them."""

    # messages with a series of light, and messages without a credible one
    messages: Count = 0
    refused: Count = 0
    # how far the latest decision believed the series, 0 to 1; None: it had none, or the policy uses none
    belief: Annotated[float, Field(ge=0, le=1)] | None = None


class TrackingRefusal(StrEnum):
    """Why a report was ignored; the names are fixed for log and metrics."""

    DAMAGED = "damaged"
    """It is not a TrackedCells, or not a credible one."""
    TOO_OFTEN = "too_often"
    """More reports arrived between two frames than are looked at."""
    NO_CAMERA = "no_camera"
    """The rig has no such camera."""
    FUTURE = "future"
    """Its frame has not been taken yet."""
    STALE = "stale"
    """Its frame is too old."""
    UNKNOWN_FRAME = "unknown_frame"
    """No frame has its stamp."""
    PASSED_OVER = "passed_over"
    """Control had no time for its frame, or the camera's frame was missing."""
    TOO_MANY = "too_many_consumers"
    """Enough others already report."""


@dataclass(slots=True)
class TrackingTally:
    """Counts of reports, and how the latest decision used them."""

    # reports that were taken, and those that were refused, by reason
    reports: Count = 0
    refused: Annotated[dict[str, Count], Field(max_length=100)] = field(
        default_factory=lambda: {str(reason): 0 for reason in TrackingRefusal}
    )
    # the consumers that steered the latest decision; empty: none did, or the policy cannot be steered
    by: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    # time from the frame that the newest report is about to the frame of the decision; None: nobody steered
    age_s: Annotated[float, Field(ge=0, le=1e6)] | None = None

    def __str__(self) -> str:
        """Who steers, in words, and what was refused."""
        used = "by nobody" if self.age_s is None else f"by {', '.join(self.by)}, age {self.age_s:.1f} s"
        refused = ", ".join(f"{count} {reason}" for reason, count in self.refused.items() if count)
        return f"{used}   reports: {self.reports}, refused: {refused or 'none'}"


LARGEST_ANSWER_BYTES = 1 << 16

_Text = Annotated[str, Field(max_length=1000)]


@dataclass(frozen=True, slots=True)
class Bounds:
    """The exposures that control may choose."""

    min_time_us: float
    max_time_us: float
    min_gain_db: float
    max_gain_db: float

    @classmethod
    def of(cls, limits: ExposureLimits) -> Bounds:
        """The bounds that limits set."""
        return cls(limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db)

    def __str__(self) -> str:
        return f"{self.min_time_us:g} to {self.max_time_us:g} us, {self.min_gain_db:g} to {self.max_gain_db:g} dB"


@dataclass(slots=True)
class RequestTally:
    """Which requests are in force, and how many there were."""

    locked: ExposureSetting | None = None  # the setting that is held; None: control decides
    ev_stops: float = 0.0  # added to what the policy decides
    # which of `policy`, `limits`, `region left` and `region right` are not as configured
    changed: Annotated[tuple[_Text, ...], Field(max_length=10)] = ()
    bounds: Bounds | None = None  # the exposures that control may choose; None before a camera is open
    # requests, since the cameras were opened
    taken: Count = 0
    refused: Count = 0
    latest: _Text = ""  # the latest request that was taken, and who asked; empty: none

    def __str__(self) -> str:
        """What is in force, in words; empty: all is as configured."""
        parts = [] if self.locked is None else [f"locked at {self.locked}"]
        parts += [f"EV {self.ev_stops:+g}"] if self.ev_stops else []
        parts += [f"{name} changed" for name in self.changed]
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class AnsweredShot:
    """The pair that was taken for a shot."""

    setting: ExposureSetting  # the setting that its frames report they were taken with
    trigger: Annotated[int, Field(ge=0, le=LAST_COUNT)]  # the daemon's number of the trigger
    frame_ids: dict[CameraName, Annotated[int, Field(ge=0, lt=1 << 64)]]  # the id of each camera's frame


@dataclass(frozen=True, slots=True)
class GroupAnswer:
    """The state of control of one group: the policy that decides, and what was requested."""

    policy: _Text
    requests: RequestTally


@dataclass(frozen=True, slots=True)
class Answer(GroupAnswer):
    """The state of control after a request, of the first group that was asked, and the pair of a shot."""

    shot: AnsweredShot | None = None
    groups: Annotated[dict[str, GroupAnswer], Field(max_length=100)] = field(default_factory=dict)  # that were asked

    def to_json(self) -> str:
        """The text that is sent."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: bytes) -> Answer | None:
        """The answer in a message; None if it is damaged."""
        if len(text) > LARGEST_ANSWER_BYTES:
            return None
        try:
            return _ADAPTER.validate_json(text)
        except ValidationError:
            return None


_ADAPTER = TypeAdapter(Answer)
