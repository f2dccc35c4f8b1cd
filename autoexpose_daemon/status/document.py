"""The status that a daemon sends to other processes once a second: plain data, as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Annotated

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError

from autoexpose_daemon.control.decision import Decision, Grounds
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.keys import ONE_GROUP
from autoexpose_daemon.status.counters import Count, Counts, ImuTally, LightTally, RequestTally, TrackingTally
from autoexpose_daemon.status.states import Health, State
from drivers.camera import PtpState
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName
from imaging.geometry import CameraPose

LARGEST_GROUNDS_BYTES = 1 << 18
"""Four times what those of eight cameras take."""

_GROUNDS: TypeAdapter[Grounds | None] = TypeAdapter(Grounds | None)


def grounds_to_json(grounds: Grounds | None) -> bytes:
    """The message; there are none if the policy has no belief."""
    return _GROUNDS.dump_json(grounds)


def grounds_from_json(data: bytes) -> Grounds | None:
    """What is in a message; None, too, if that is damaged."""
    try:
        grounds = _GROUNDS.validate_json(data) if len(data) <= LARGEST_GROUNDS_BYTES else None
    except ValidationError:
        return None
    return grounds if grounds is not None and grounds.is_whole else None


VERSION = 1
"""Changes when a field changes its meaning, not when a field is added."""

LARGEST_STATUS_BYTES = 1 << 20
"""Three times what the longest faults take."""

_Few = Field(max_length=100)
_Counts = Annotated[dict[str, Count], _Few]
_Seconds = Annotated[float, Field(ge=0, le=1e11)]
_Milliseconds = Annotated[float, Field(ge=-1e14, le=1e14)]  # below 0 if a clock jumped
_Hertz = Annotated[float, Field(ge=0, le=1e6)]


def _takes_time(setting: ExposureSetting) -> ExposureSetting:
    if not setting.is_physical:
        raise ValueError(f"{setting} is not an exposure")
    return setting


def _fits_a_node(ptp: PtpState) -> PtpState:
    if ptp.offset_ns is not None and abs(ptp.offset_ns) > 1 << 63:
        raise ValueError(f"{ptp.offset_ns} ns is not an integer of a camera")
    return ptp


@dataclass(frozen=True, slots=True)
class DurationStatus:
    """How long something took: count and sum of all durations, percentiles over the last minutes (ms).

    The percentiles are None before the first duration.
    """

    count: Count
    sum_ms: _Milliseconds
    p50_ms: _Milliseconds | None
    p99_ms: _Milliseconds | None


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """One camera of the rig."""

    camera: str | None  # model and serial; None while it is not open
    # the setting of its newest frame; None before the first, and if another camera alone sends frames
    applied: Annotated[ExposureSetting, AfterValidator(_takes_time)] | None
    drift_grey: float | None  # error of its response (grey levels rms); None without a verdict
    misfit: str | None  # why its calibration does not fit, in words; None if it fits
    # what it says about its PTP clock; None except in `trigger.mode` ptp
    ptp: Annotated[PtpState, AfterValidator(_fits_a_node)] | None = None
    # triggers whose frame arrived whole, and those whose frame did not
    frames: Count = 0
    lost: Count = 0
    # how warm it is inside (degrees Celsius), and how fast its link is; None: it does not say
    temperature_c: Annotated[float, Field(ge=-300, le=1e4)] | None = None
    link_mbps: Annotated[float, Field(ge=0, le=1e9)] | None = None
    pose: CameraPose | None = None  # by its geometry, in the left camera's axes; None: it is not known, or a left one
    # rectangles that count, x, y, width and height; none: all of it. None: weights or a mask say what does
    region: Annotated[tuple[tuple[int, int, int, int], ...], Field(max_length=256)] | None = ()


@dataclass(frozen=True, slots=True)
class PublishStatus:
    """What happened to the pairs on their way to other processes."""

    # pairs; `dropped` by reason
    offered: Count
    sent: Count
    dropped: _Counts
    trouble: str  # why there is no session, in words; empty if there is one
    # the consumers that report, each with its own counts since it started
    consumers: Annotated[dict[str, ConsumerTally], _Few]
    unlisted_consumers: Count = 0  # how many more consumers report


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """The recorder: control steps it was given since the process started, those it dropped, and what ended it."""

    steps: Count
    dropped: Count
    failure: str | None


_Decision = Annotated[Decision, AfterValidator(lambda decision: _takes_time(decision.setting) and decision)]


@dataclass(frozen=True, slots=True)
class GroupStatus:
    """Cameras that are exposed together."""

    cameras: Annotated[tuple[CameraName, ...], _Few]
    policy: str  # that decides
    decision: _Decision | None  # the newest one; its `setting` is the last one requested. None before the first
    flicker_hz: _Hertz | None  # as found in the light; None: none, or `control.flicker_hz` is a number
    requests: RequestTally  # what was requested of it while it runs
    decision_ms: DurationStatus  # how long its decisions take


@dataclass(frozen=True, slots=True)
class Fault:
    """A log line at WARNING or above: its time (seconds since 1970), its level, and its text without line breaks."""

    unix_time_s: _Seconds
    level: str
    message: str


@dataclass(frozen=True, slots=True)
class Status:
    """The condition of a daemon. Counts and durations begin when its cameras are opened, by a start or a reload.

    Writes count once per camera in durations; `command_to_effect_ms` covers the cameras with chunk data.
    """

    version: int
    rig: str
    policy: str  # that decides
    unix_time_s: _Seconds  # when this status was sent, by the wall clock of the daemon's machine
    # time since the process started, and since its cameras were opened
    uptime_s: _Seconds
    open_s: _Seconds
    ending: bool  # whether this is the last status before the daemon stops or reopens its cameras for a reload
    state: State
    reasons: Annotated[tuple[str, ...], _Few]  # why it is not better
    cameras: dict[CameraName, CameraStatus]  # every camera of the configuration
    rate_hz: _Hertz  # complete pairs per second, at present
    counts: Counts
    lost: _Counts  # triggers that made no pair, by reason (docs/understand/account.md)
    # the newest decision; its `setting` is the last one requested. None before the first
    decision: _Decision | None
    # see `DURATIONS`
    pairing_ms: DurationStatus
    decision_ms: DurationStatus
    held_ms: DurationStatus
    write_ms: DurationStatus
    frame_to_node_ms: DurationStatus
    command_to_effect_ms: DurationStatus
    publishing: PublishStatus | None  # None: frames are not published
    recorder: RecorderStatus | None  # None: they are not recorded
    faults: Annotated[tuple[Fault, ...], _Few]  # the latest ones, oldest first
    imu: ImuTally | None = None  # None: no IMU is configured
    light_ahead: LightTally | None = None  # how what `autoexpose repeat` foretold was used; None: nothing is published
    flicker_hz: _Hertz | None = None  # as found in the light; None: none, or `control.flicker_hz` is a number
    requests: RequestTally | None = None  # None: the daemon takes no requests
    tracking: TrackingTally | None = None  # how consumers' reports were used; None: nothing is published
    skew_ms: DurationStatus = DurationStatus(0, 0.0, None, None)
    # by name; what stands above of policy, decision, flicker and requests is of the first
    groups: Annotated[dict[str, GroupStatus], _Few] = field(default_factory=dict)

    @property
    def health(self) -> Health:
        """State and reasons."""
        return Health(self.state, self.reasons)

    @property
    def by_group(self) -> dict[str, GroupStatus]:
        """The groups by name; of a daemon that tells of none, one with all cameras."""
        if self.groups:
            return self.groups
        requests = self.requests or RequestTally()
        whole = GroupStatus(
            tuple(self.cameras), self.policy, self.decision, self.flicker_hz, requests, self.decision_ms
        )
        return {ONE_GROUP: whole}

    def setting_of(self, group: GroupStatus) -> ExposureSetting | None:
        """The setting of a group's newest frame: that of its first camera that has one."""
        seen = (self.cameras[camera].applied for camera in group.cameras if camera in self.cameras)
        return next((applied for applied in seen if applied is not None), None)

    def to_json(self) -> str:
        """The text that is sent."""
        return json.dumps(asdict(self))  # NaN is sent as NaN: it must not hide the rest

    @classmethod
    def from_json(cls, text: str | bytes) -> Status | None:
        """The status in a message; None if the message is damaged or from another version."""
        if len(text) > LARGEST_STATUS_BYTES:
            return None
        try:
            status = _ADAPTER.validate_json(text)
        except ValidationError:
            return None
        return status if status.version == VERSION else None


_ADAPTER = TypeAdapter(Status)
