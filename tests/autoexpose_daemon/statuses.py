"""Statuses, made up."""

from __future__ import annotations

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.status.counters import Bounds, Counts, ImuTally, RequestTally, TrackingTally
from autoexpose_daemon.status.document import (
    VERSION,
    CameraStatus,
    DurationStatus,
    Fault,
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
