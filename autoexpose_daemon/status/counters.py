"""What the daemon counts and measures, declared once: telemetry, status, metrics, page, terminal and log follow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal

from pydantic import Field

from autoexpose_daemon.messages.client import LAST_COUNT

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

    pairs: Count = _counter("triggers", "stereo pairs", "Triggers that made a stereo pair.", unusual=False)
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
