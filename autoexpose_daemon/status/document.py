"""What a daemon says of itself to other processes, once a second: plain data, sent as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.status.counters import Count, Counts
from autoexpose_daemon.status.imu import ImuTally
from autoexpose_daemon.status.publishing import ConsumerTally
from autoexpose_daemon.status.states import Health, State
from calibration.response import ResponseFunction
from drivers.errors import ConfigurationError
from drivers.exposure import ExposureSetting
from drivers.frames import Side

VERSION = 1
"""Grows when a field changes its meaning; a field that is new does not change it."""

LARGEST_STATUS_BYTES = 1 << 20
"""Of a status: three times what the longest faults take."""

LARGEST_RESPONSE_BYTES = 1 << 16
"""Of a response function, whose 256 numbers take 6 KB."""

_Few = Field(max_length=100)
_Counts = Annotated[dict[str, Count], _Few]
_Seconds = Annotated[float, Field(ge=0, le=1e11)]
_Milliseconds = Annotated[float, Field(ge=-1e14, le=1e14)]  # below 0 where a clock jumped
_Hertz = Annotated[float, Field(ge=0, le=1e6)]


def _takes_time(setting: ExposureSetting) -> ExposureSetting:
    if not setting.is_physical:
        raise ValueError(f"{setting} is no exposure")
    return setting


@dataclass(frozen=True, slots=True)
class Durations:
    """How long something took: all of them counted and summed up, median and 99th percentile of the last minutes (ms).

    The percentiles are None before the first.
    """

    count: Count
    sum_ms: _Milliseconds
    p50_ms: _Milliseconds | None
    p99_ms: _Milliseconds | None


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
    unlisted_consumers
        How many there are besides.
    """

    offered: Count
    sent: Count
    dropped: _Counts
    trouble: str
    consumers: Annotated[dict[str, ConsumerTally], _Few]
    unlisted_consumers: Count = 0


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """The recorder: steps of control it was given since the process started, those it dropped, and what ended it."""

    steps: Count
    dropped: Count
    failure: str | None


@dataclass(frozen=True, slots=True)
class Fault:
    """A line of the log at WARNING or above: when (seconds since 1970), its level, its text without line breaks."""

    unix_time_s: _Seconds
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
    counts
        See `Counts`.
    lost
        Triggers that made no pair, by reason (docs/account.md).
    decision
        The newest; its `setting` is what was last asked for. None before the first.
    pairing_ms, decision_ms, held_ms, write_ms, frame_to_node_ms, command_to_effect_ms
        See `DURATIONS`. Those of writes are of each camera that a decision was written to; `command_to_effect_ms` is of
        each camera with chunk data.
    publishing, recorder
        None where frames are not published, or not recorded.
    faults
        The latest, oldest first.
    imu
        None where none is configured.
    """

    version: int
    rig: str
    policy: str
    unix_time_s: _Seconds
    uptime_s: _Seconds
    open_s: _Seconds
    ending: bool
    state: State
    reasons: Annotated[tuple[str, ...], _Few]
    cameras: dict[Side, CameraStatus]
    rate_hz: _Hertz
    counts: Counts
    lost: _Counts
    decision: Annotated[Decision, AfterValidator(lambda decision: _takes_time(decision.setting) and decision)] | None
    pairing_ms: Durations
    decision_ms: Durations
    held_ms: Durations
    write_ms: Durations
    frame_to_node_ms: Durations
    command_to_effect_ms: Durations
    publishing: PublishStatus | None
    recorder: RecorderStatus | None
    faults: Annotated[tuple[Fault, ...], _Few]
    imu: ImuTally | None = None

    @property
    def health(self) -> Health:
        """State and reasons."""
        return Health(self.state, self.reasons)

    def to_json(self) -> str:
        """As it is sent."""
        return json.dumps(asdict(self))  # a number that is none (NaN) as such: it must not hide the rest

    @classmethod
    def from_json(cls, text: str | bytes) -> Status | None:
        """What a daemon sent, or None when it is nothing of the kind, or of a version that means something else."""
        if len(text) > LARGEST_STATUS_BYTES:
            return None
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
    if len(text) > LARGEST_RESPONSE_BYTES:
        return None
    try:
        return ResponseFunction.from_document(json.loads(text), Path("response"))
    except (ConfigurationError, ValueError, TypeError, LookupError, RecursionError):
        return None
