"""Statuses, grounds of a decision, samples of an IMU and frames of `repeat`, made up."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from autoexpose_daemon.control.decision import Decision, Grounds, SceneHistogram
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.inputs import RegisteredView
from autoexpose_daemon.messages.types import IMU, TYPESTORE
from autoexpose_daemon.status.counters import Bounds, Counts, ImuTally, RequestTally, TrackingTally
from autoexpose_daemon.status.document import (
    VERSION,
    CameraStatus,
    DurationStatus,
    Fault,
    GroupStatus,
    PublishStatus,
    RecorderStatus,
    Status,
)
from autoexpose_daemon.status.states import State
from drivers.camera import PtpState
from imaging.exposure import ExposureSetting

SETTING = ExposureSetting(1000.0, 6.0)
DURATIONS = DurationStatus(100, 250.0, 2.0, 8.0)

EXPOSING = Status(
    version=VERSION,
    rig="rig",
    policy="belief",
    unix_time_s=1.7e9,
    uptime_s=7300.0,
    open_s=7200.0,
    ending=False,
    state=State.EXPOSING,
    reasons=(),
    cameras={
        "left": CameraStatus("FakeCam L1", SETTING, 0.5, None, PtpState("Slave", -1234)),
        "right": CameraStatus("FakeCam R2", SETTING, None, None),
    },
    rate_hz=60.0,
    counts=Counts(
        pairs=432_000,
        surplus_frames=1,
        pairs_without_decision=2,
        mismatched_pairs=4,
        unexplained_mismatches=1,
        late_writes=5,
        refused_writes=6,
        adjusted_writes=7,
        frames_off_setting=13,
        frames_without_exposure_metadata=14,
        clock_jumps=15,
        refused_packets=17,
        decisions_without_imu=16,
        decisions_at_brightest_limit=8,
        reconnects=9,
    ),
    lost={"left_missing": 3, "startup": 20},
    decision=Decision(ExposureSetting(1100.0, 6.0), 11.1, "held", 0.25, 0.01, 0.02, 1.5),
    pairing_ms=DURATIONS,
    decision_ms=DURATIONS,
    held_ms=DURATIONS,
    write_ms=DURATIONS,
    frame_to_node_ms=DURATIONS,
    command_to_effect_ms=DURATIONS,
    skew_ms=DURATIONS,
    publishing=PublishStatus(432_000, 431_990, {"behind": 10}, "", {"slam": ConsumerTally(400_000, 12, 8, 4, 0)}),
    recorder=RecorderStatus(1000, 11, None),
    faults=(Fault(1.7e9, "WARNING", "right camera: no frames; checking that it answers"),),
    imu=ImuTally(1_440_000, 17, 0.75),
    flicker_hz=100.0,
    requests=RequestTally(
        SETTING, -0.5, ("policy",), Bounds(20.0, 7500.0, 0.0, 30.0), 18, 19, "lock, asked by user@robot"
    ),
    tracking=TrackingTally(20, {"damaged": 21, "stale": 22}, ("slam",), 0.4),
)
"""All is well, and every number is different."""


def _group(*cameras: str, policy: str, time_us: float, metric: float, requests: RequestTally) -> GroupStatus:
    setting = ExposureSetting(time_us, 3.0)
    decision = Decision(setting, setting.level, f"seen by {policy}", metric, 0.03, 0.04, 1.5)
    return GroupStatus(cameras, policy, decision, None, requests, DURATIONS)


BOUNDS = Bounds(20.0, 7500.0, 0.0, 30.0)
GROUPED = replace(
    EXPOSING,
    cameras={
        "front_left": CameraStatus("FakeCam A", ExposureSetting(2000.0, 0.0), None, None, frames=900, lost=0),
        "front_right": CameraStatus("FakeCam B", ExposureSetting(2100.0, 0.0), None, None, frames=899, lost=1),
        "rear_left": CameraStatus("FakeCam C", None, None, None, frames=800, lost=100),
        "rear_right": CameraStatus("FakeCam D", ExposureSetting(300.0, 0.0), None, None, frames=890, lost=10),
    },
    lost={"rear_left_missing": 90, "several_missing": 10},
    groups={
        "front": _group(
            "front_left", "front_right", policy="belief", time_us=2200.0, metric=0.11,
            requests=RequestTally(bounds=BOUNDS, taken=1, latest="reset of group front, asked by ana"),
        ),
        "rear": _group(
            "rear_left", "rear_right", policy="neves2009", time_us=310.0, metric=0.22,
            requests=RequestTally(None, -1.0, (), BOUNDS, 2, 0, "EV -1 of group rear, asked by ana"),
        ),
    },
)  # fmt: skip
"""A rig of two pairs that are exposed apart."""


GROUNDS = Grounds(
    scenes={
        "left": SceneHistogram(
            start=-16.0,
            bin_stops=1.0,
            known=[0.0, 0.1, 0.3, 0.2, 0.0, 0.0, 0.0, 0.0],
            guessed=[0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.15, 0.05],
            contrast=[0.0, 0.1, 0.2, 0.3, 0.0, 0.2, 0.1, 0.1],
            black=-19.5,
            white=-12.0,
        )
    },
    level=12.0,
    levels=[6.0, 8.0, 10.0, 12.0, 14.0],
    worth=[0.3, 1.0, 0.6, 0.8, 0.2],
    value=[6.2, 7.3, 6.5, 7.1, 6.1],
)


_types = TYPESTORE.types
_header = _types["std_msgs/msg/Header"](_types["builtin_interfaces/msg/Time"](1_700_000_000, 5), "imu_link")
_upright = _types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
_vector = _types["geometry_msgs/msg/Vector3"]


def imu_message(velocity_rad_s: Sequence[float], unknown: bool = False) -> bytes:
    """The CDR bytes of a sample; `unknown`: marked as without angular velocity."""
    covariance, marked = np.zeros(9), np.array([-1.0, *[0.0] * 8])
    sample = _types[IMU](
        _header, _upright, covariance, _vector(*velocity_rad_s), marked if unknown else covariance,
        _vector(0.0, 0.0, 9.81), covariance,
    )  # fmt: skip
    return bytes(TYPESTORE.serialize_cdr(sample, IMU))


def registered_view(distance_m: float = 3.5, shift_px: float | None = 12.0) -> RegisteredView:
    """One of 40 matches, 30 of which agree."""
    random = np.random.default_rng(1)
    agreed = np.arange(40) < 30
    shifts_px = np.where(agreed, 12.0 + random.normal(0.0, 1.0, 40), random.uniform(-300.0, 300.0, 40))
    x_px, y_px = random.uniform((0.0, 0.0), (720.0, 540.0), (40, 2)).T.astype(np.float32)
    return RegisteredView(
        1_700_000_000_000_000_000, "left", distance_m, 40.0, 17, shift_px,
        x_px, y_px, shifts_px.astype(np.float32), agreed, 0.4, -0.1, "",
    )  # fmt: skip
