"""What a daemon says of itself to other processes, once a second: plain data, sent as JSON."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, TypeAdapter, ValidationError

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.publish.tally import ConsumerTally
from autoexpose_daemon.states import Health, State
from calibration.response import ResponseFunction
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting
from drivers.frames import Side

VERSION = 1
"""Grows when a field changes its meaning; a field that is new does not change it."""


def _takes_time(setting: ExposureSetting) -> ExposureSetting:
    if not (0 < setting.exposure_time_us < math.inf and math.isfinite(setting.gain_db)):
        raise ValueError(f"{setting} is no exposure")
    return setting


@dataclass(frozen=True, slots=True)
class Durations:
    """How long something took: all of them counted and summed up, median and 99th percentile of the last minutes (ms).

    The percentiles are None before the first.
    """

    count: int
    sum_ms: float
    p50_ms: float | None
    p99_ms: float | None


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """One camera of the rig.

    Attributes
    ----------
    camera
        Model and serial; None: not open, and tried again.
    applied
        How its newest frame was taken; None before the first.
    drift_grey
        By how much its response misses (grey levels rms); None without a verdict.
    misfit
        Why its calibration does not fit, in words; None when nothing is wrong with it.
    """

    camera: str | None
    applied: Annotated[ExposureSetting, AfterValidator(_takes_time)] | None
    drift_grey: float | None
    misfit: str | None


@dataclass(frozen=True, slots=True)
class PublishStatus:
    """What became of the pairs on their way to other processes.

    Attributes
    ----------
    offered, sent, dropped
        Pairs; `dropped` by reason.
    trouble
        Why there is no session, in words; empty when there is one.
    consumers
        Those that are there, with their own counts since each of them started.
    """

    offered: int
    sent: int
    dropped: dict[str, int]
    trouble: str
    consumers: dict[str, ConsumerTally]


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """The recorder: steps of control it was given since the process started, those it dropped, and what ended it."""

    steps: int
    dropped: int
    failure: str | None


@dataclass(frozen=True, slots=True)
class Fault:
    """A line of the log at WARNING or above: when (seconds since 1970), its level, its text without line breaks."""

    unix_time_s: float
    level: str
    message: str


@dataclass(frozen=True, slots=True)
class Status:
    """How a daemon is. Counts and durations are since its cameras were opened, by a start or a reload.

    Attributes
    ----------
    rig, policy
        Name of the rig, and who decides.
    unix_time_s
        When this was said, by the wall clock of the daemon's machine.
    uptime_s, open_s
        Since the process started, and since its cameras were opened.
    ending
        Whether this is the last one: the daemon stops, or opens its cameras anew after a reload.
    state, reasons
        The state, and why it is no better.
    cameras
        Every camera of the configuration.
    rate_hz
        Complete pairs per second at present.
    pairs, lost
        Triggers that made a pair, and those that did not, by reason (docs/account.md).
    surplus_frames
        Frames that came between the triggers.
    undecided_pairs
        Pairs that control had no time for.
    mismatched_pairs, unexplained_mismatches
        Pairs taken with a setting that was not one and the same, and those of them without a late write to explain it.
    late_writes, refused_writes, clipped_writes
        Settings that missed their exposure, writes that a camera refused, and those of which it took something else.
    astray_frames, untold_frames
        Frames taken with a setting that was not written, and those that did not say how they were taken although the
        camera's frames did before.
    clock_jumps
        How often the clock of a camera jumped.
    clamped_decisions
        Decisions that the bounds held back, by the bound: `darkest` or `brightest`.
    reconnects
        Cameras that were lost and came back.
    decision
        The newest; its `setting` is what was last asked for. None before the first.
    pairing_ms, decision_ms, held_ms, write_ms, frame_to_node_ms, command_to_effect_ms
        See `DURATIONS`. Those of writes are of each camera that a decision was written to; `command_to_effect_ms` is of
        each camera with chunk data.
    publishing, recorder
        None where frames are not published, or not recorded.
    faults
        The latest, oldest first.
    """

    version: int
    rig: str
    policy: str
    unix_time_s: float
    uptime_s: float
    open_s: float
    ending: bool
    state: State
    reasons: tuple[str, ...]
    cameras: dict[Side, CameraStatus]
    rate_hz: float
    pairs: int
    lost: dict[str, int]
    surplus_frames: int
    undecided_pairs: int
    mismatched_pairs: int
    unexplained_mismatches: int
    late_writes: int
    refused_writes: int
    clipped_writes: int
    astray_frames: int
    untold_frames: int
    clock_jumps: int
    clamped_decisions: dict[str, int]
    reconnects: int
    decision: Annotated[Decision, AfterValidator(lambda decision: _takes_time(decision.setting) and decision)] | None
    pairing_ms: Durations
    decision_ms: Durations
    held_ms: Durations
    write_ms: Durations
    frame_to_node_ms: Durations
    command_to_effect_ms: Durations
    publishing: PublishStatus | None
    recorder: RecorderStatus | None
    faults: tuple[Fault, ...]

    @property
    def health(self) -> Health:
        """State and reasons."""
        return Health(self.state, self.reasons)

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

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self))  # a number that is none (NaN) as such: it must not hide the rest

    @classmethod
    def from_json(cls, text: str | bytes) -> Status | None:
        """What a daemon sent, or None when it is nothing of the kind, or of a version that means something else."""
        try:
            status = _ADAPTER.validate_json(text)
        except ValidationError:
            return None
        return status if status.version == VERSION else None


_ADAPTER = TypeAdapter(Status)


def response_to_json(response: ResponseFunction) -> str:
    """A camera's response function, as it is sent beside the status."""
    curve = response.log2_exposure.tolist()
    return json.dumps({"log2_exposure": curve, "black_level": response.black_level, "saturation": response.saturation})


def response_from_json(text: str | bytes) -> ResponseFunction | None:
    """What a daemon sent, or None when it is nothing of the kind."""
    try:
        return ResponseFunction.from_document(json.loads(text), Path("response"))
    except (ConfigurationError, ValueError, TypeError, LookupError, RecursionError):
        return None
