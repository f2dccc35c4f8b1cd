"""Action commands on the camera's own clock, in virtual time; and through the device's thread."""

from __future__ import annotations

import time
from queue import Queue

from fake_camera.device.actions import ActionOutcome, Actions
from fake_camera.device.device import Device
from fake_camera.device.faults import LATE_NS, Fault, FaultOrder
from fake_camera.imaging import ExposedFrame
from fake_camera.ptp.clock import Clock
from fake_camera.ptp.messages import PortIdentity
from fake_camera.ptp.slave import PortState, Slave
from tests.fake_camera.gige.gige_client import device

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
PATIENCE_S = 20.0
PTP_CLOCK = 0x0200_00FF_FE00_0001


def actions(drift_ppm: float = 0.0, *, set_by_master: bool = True) -> tuple[Actions, Clock]:
    clock = Clock(0, EPOCH, drift_ppm)
    ptp = Slave(clock, PortIdentity(1), lambda: True)
    ptp.set_by_master = set_by_master
    return Actions(clock, ptp), clock


def test_an_action_without_a_time_is_for_now_even_without_ptp() -> None:
    clock = Clock(0)
    assert Actions(clock, None).command(None, 0) is ActionOutcome.NOW
    assert Actions(clock, None).command(S, 0) is ActionOutcome.NO_REFERENCE_TIME
    assert actions(set_by_master=False)[0].command(EPOCH + S, 0) is ActionOutcome.NO_REFERENCE_TIME


def test_actions_are_due_by_the_cameras_clock_in_the_order_of_their_times() -> None:
    waiting, clock = actions(drift_ppm=100.0)
    for seconds in (20, 10):
        assert waiting.command(EPOCH + seconds * S, 0) is ActionOutcome.SCHEDULED
    due_ns = waiting.due_ns()
    assert due_ns is not None
    assert abs(due_ns - (10 * S - 1_000_000)) < 200  # its second is shorter by 100 us
    assert waiting.take(due_ns - 1) is None
    assert waiting.take(due_ns) == due_ns
    clock.set(EPOCH + 30 * S, due_ns)  # a jump past the other one
    assert waiting.take(due_ns) is not None
    assert waiting.due_ns() is None
    assert waiting.take(due_ns) is None


def waiting_for_actions(camera: Device) -> Queue[ExposedFrame]:
    frames: Queue[ExposedFrame] = Queue()
    camera.connect(frames.put)
    camera.features.set("TriggerMode", "On")
    camera.features.set("TriggerSource", "Action1")
    camera.execute("AcquisitionStart")
    assert camera.ptp is not None
    camera.ptp.set_by_master = True
    return frames


def test_a_device_exposes_at_once_and_at_the_time_given() -> None:
    with device(ptp_clock=PTP_CLOCK) as camera:
        frames = waiting_for_actions(camera)
        before_ns = camera.now_ns()
        assert camera.action(None) is ActionOutcome.NOW
        after_ns = camera.now_ns()
        assert before_ns <= frames.get(timeout=PATIENCE_S).device_time_ns <= after_ns
        at_ns = camera.now_ns() + S // 10
        assert camera.action(at_ns) is ActionOutcome.SCHEDULED
        frame = frames.get(timeout=PATIENCE_S)
        assert abs(frame.device_time_ns - at_ns) <= 2
        assert frame.trigger is None
        camera.features.set("TriggerSource", "Software")
        assert camera.action(None) is ActionOutcome.NOW
        camera.features.set("TriggerSource", "Action1")
        camera.action(camera.now_ns() + S // 10)
        assert frames.get(timeout=PATIENCE_S).frame_id == 3


def test_a_late_action_acts_after_its_time() -> None:
    with device(ptp_clock=PTP_CLOCK) as camera:
        frames = waiting_for_actions(camera)
        camera.faults.add(FaultOrder(Fault.LATE_ACTIONS, None, 1))
        at_ns = camera.now_ns() + S // 10
        assert camera.action(at_ns) is ActionOutcome.LATE
        assert abs(frames.get(timeout=PATIENCE_S).device_time_ns - at_ns - LATE_NS) <= 2


def test_a_restart_forgets_actions_and_the_time() -> None:
    with device(ptp_clock=PTP_CLOCK) as camera:
        waiting_for_actions(camera)
        assert camera.ptp is not None
        camera.features.set("PtpEnable", True)
        camera.ptp.poll(time.monotonic_ns())
        outcomes = [camera.action(camera.now_ns() + 1000 * S) for _ in range(11)]
        assert outcomes[-1] is ActionOutcome.OVERFLOW
        camera.execute("DeviceReset")
        assert camera.features.get("PtpEnable") is False
        assert camera.ptp.state is PortState.Disabled
        assert camera.action(camera.now_ns() + 1000 * S) is ActionOutcome.NO_REFERENCE_TIME
        camera.ptp.set_by_master = True
        assert camera.action(camera.now_ns() + 1000 * S) is ActionOutcome.SCHEDULED
