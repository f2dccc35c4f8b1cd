"""The device's threads on a real clock, and action commands by its own clock."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from queue import Queue

import numpy as np
import pytest

from fake_camera.device.actions import ActionOutcome, Actions
from fake_camera.device.device import Device
from fake_camera.device.faults import JUMP_NS, LATE_NS, Fault, FaultOrder
from fake_camera.device.line0 import Line0
from fake_camera.imaging import ExposedFrame, ImageSettings, Pixels
from fake_camera.ptp.clock import Clock
from fake_camera.ptp.messages import PortIdentity
from fake_camera.ptp.slave import PortState, Slave
from tests.fake_camera.gige import gige_client
from tests.fake_camera.gige.gige_client import Ramp
from tests.meanwhile import wait_until

MS = 1_000_000
PATIENCE_S = 20.0
SOON_TRIGGERS = 30
NO_FAULTS: frozenset[str] = frozenset()


class FlatSource:
    """Images of one grey level; `hold` keeps the next one waiting, and each takes `takes_s`."""

    sensor_width = 720
    sensor_height = 540

    def __init__(self) -> None:
        self.hold = threading.Event()
        self.hold.set()
        self.takes_s = 0.0
        self.seeds: list[int] = []

    def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
        assert start_s >= 0
        self.hold.wait(PATIENCE_S)
        threading.Event().wait(self.takes_s)
        self.seeds.append(noise_seed)
        return np.full((settings.height, settings.width), 100, np.uint8)

    def lux(self, time_s: float) -> float:
        return time_s


class Client:
    """Collects the frames of a device."""

    def __init__(self, device: Device) -> None:
        self.frames: list[ExposedFrame] = []
        self._more = threading.Condition()
        device.connect(self._take)

    def _take(self, frame: ExposedFrame) -> None:
        with self._more:
            self.frames.append(frame)
            self._more.notify_all()

    def wait(self, condition: Callable[[list[ExposedFrame]], bool]) -> list[ExposedFrame]:
        with self._more:
            assert self._more.wait_for(lambda: condition(self.frames), timeout=PATIENCE_S), "no such frames came"
            return list(self.frames)


@pytest.fixture
def source() -> FlatSource:
    return FlatSource()


@pytest.fixture
def device(source: FlatSource) -> Iterator[Device]:
    with closing(Device(source, "S1", seed=3, line0=Line0(time.monotonic_ns(), 100.0))) as device:
        yield device


def trigger_by_line0(device: Device) -> None:
    device.features.set("ExposureAuto", "Off")
    device.features.set("ExposureTime", 500.0)
    device.features.set("TriggerMode", "On")
    device.execute("AcquisitionStart")


def soon(client: Client) -> int:
    """A trigger to come, late enough for a busy machine to order something for it."""
    return (client.wait(lambda frames: len(frames) >= 1)[-1].trigger or 0) + SOON_TRIGGERS


@pytest.mark.realtime
def test_sends_a_frame_for_each_pulse_after_its_readout(device: Device) -> None:
    client = Client(device)
    trigger_by_line0(device)
    frames = client.wait(lambda frames: len(frames) >= 10)
    assert [frame.frame_id for frame in frames] == list(range(1, len(frames) + 1))
    triggers = [frame.trigger for frame in frames]
    assert triggers == list(range(triggers[0] or 0, (triggers[0] or 0) + len(frames)))
    steps_ns = np.diff([frame.device_time_ns for frame in frames])
    assert np.all(np.abs(steps_ns - 10 * MS) < 2000)  # nominal times, a few ppm off
    assert frames[0].pixels.shape == (540, 720)


@pytest.mark.realtime
def test_a_camera_without_power_makes_no_exposures(device: Device) -> None:
    client = Client(device)
    device.execute("AcquisitionStart")  # free run
    client.wait(lambda frames: len(frames) >= 1)
    device.faults.add(FaultOrder(Fault.VANISH, count=None))
    made, pulses = device.counters.exposures, device.counters.pulses
    wait_until(lambda: device.counters.pulses >= pulses + 20)
    assert device.counters.exposures == made


@pytest.mark.realtime
def test_nothing_is_sent_after_the_stop(device: Device, source: FlatSource) -> None:
    client = Client(device)
    trigger_by_line0(device)
    client.wait(lambda frames: len(frames) >= 1)
    source.hold.clear()
    started = device.counters.exposures
    wait_until(lambda: device.counters.exposures >= started + 2)
    device.execute("AcquisitionStop")
    sent = len(client.frames)
    source.hold.set()
    device.execute("AcquisitionStart")
    frames = client.wait(lambda frames: len(frames) > sent)
    assert frames[sent].frame_id == 1
    assert len(set(source.seeds)) == len(source.seeds)  # the noise of two acquisitions differs, too


@pytest.mark.realtime
def test_a_slow_source_may_be_as_late_as_a_slow_trigger_allows(source: FlatSource) -> None:
    source.takes_s = 0.15  # at a fast trigger more than 0.1 s late would be too late
    with closing(Device(source, "S", line0=Line0(time.monotonic_ns(), 2.5))) as device:
        client = Client(device)
        trigger_by_line0(device)
        frames = client.wait(lambda frames: len(frames) >= 3)
    assert frames[-1].frame_id - len(frames) == device.counters.overruns


@pytest.mark.realtime
def test_a_frame_held_up_too_long_is_dropped_and_counted_while_its_id_is_used(
    device: Device, source: FlatSource
) -> None:
    client = Client(device)
    trigger_by_line0(device)
    client.wait(lambda frames: len(frames) >= 1)
    source.hold.clear()
    started = device.counters.exposures
    wait_until(lambda: device.counters.exposures >= started + 30)
    source.hold.set()
    frames = client.wait(lambda frames: frames[-1].frame_id > started + 30)
    ids = [frame.frame_id for frame in frames]
    assert device.counters.overruns > 0
    assert ids[-1] - len(ids) == device.counters.overruns
    triggers = [frame.trigger or 0 for frame in frames]
    assert np.array_equal(np.diff(triggers), np.diff(ids))  # no trigger was lost by it


@pytest.mark.realtime
def test_frozen_frames_are_taken_but_not_sent_and_delayed_ones_keep_their_order(device: Device) -> None:
    client = Client(device)
    trigger_by_line0(device)
    first = soon(client)
    device.faults.add(FaultOrder(Fault.FREEZE, after_trigger=first + 5, count=2))
    device.faults.add(FaultOrder(Fault.DELAY, after_trigger=first + 10, count=1))
    frames = client.wait(lambda frames: (frames[-1].trigger or 0) >= first + 15)
    by_trigger = {frame.trigger: frame.frame_id for frame in frames}
    assert by_trigger.keys().isdisjoint({first + 6, first + 7})
    assert by_trigger[first + 8] == by_trigger[first + 5] + 3
    ids = [frame.frame_id for frame in frames]
    assert ids == sorted(ids)


@pytest.mark.realtime
def test_faults_of_wire_sensor_and_clock(device: Device) -> None:
    client = Client(device)
    trigger_by_line0(device)
    first = soon(client)
    device.faults.add(FaultOrder(Fault.STOP_TRIGGERS, first + 3, 2))
    for fault, after in [(Fault.BLACK, 6), (Fault.WHITE, 7), (Fault.CLOCK_AHEAD, 9)]:
        device.faults.add(FaultOrder(fault, first + after))
    device.faults.add(FaultOrder(Fault.DOUBLE_TRIGGERS, first + 12, 3))
    frames = client.wait(lambda frames: (frames[-1].trigger or 0) >= first + 20)
    by_trigger = {frame.trigger - first: frame for frame in frames if frame.trigger is not None}
    assert by_trigger.keys() >= {1, 2, 3, 6, 7, 8}
    assert by_trigger.keys().isdisjoint({4, 5})
    assert (by_trigger[7].pixels.max(), by_trigger[8].pixels.min()) == (0, 255)
    assert sum(frame.trigger is None for frame in frames) == 3
    assert by_trigger[12].device_time_ns - by_trigger[8].device_time_ns > JUMP_NS


@pytest.mark.realtime
def test_a_camera_that_comes_back_is_in_its_power_on_state(device: Device) -> None:
    restarted = threading.Event()
    device.on_power_on(restarted.set)
    client = Client(device)
    trigger_by_line0(device)
    device.faults.add(FaultOrder(Fault.VANISH, after_trigger=soon(client), count=5))
    assert restarted.wait(PATIENCE_S)
    wait_until(lambda: not device.faults.vanished)
    assert device.features.get("TriggerMode") == "Off"
    assert device.features.get("ExposureAuto") == "Continuous"
    sent = len(client.frames)
    device.execute("AcquisitionStart")
    assert client.wait(lambda frames: len(frames) > sent)[sent].frame_id == 1


def test_the_clock_drifts_by_a_few_ppm_and_differs_between_cameras(source: FlatSource) -> None:
    devices = [Device(source, serial) for serial in ("S1", "S2")]
    first, second = (device.now_ns() for device in devices)
    assert abs(first - second) > MS
    devices[0].execute("TimestampLatch")
    latched = devices[0].features.get("TimestampLatchValue")
    assert isinstance(latched, int)
    assert first < latched < devices[0].now_ns()
    for device in devices:
        device.close()


def test_a_pulse_of_line3_that_is_far_from_now_makes_no_exposure() -> None:
    with closing(Device(Ramp(), "S1")) as device:
        device.features.set("TriggerMode", "On")
        device.features.set("TriggerSource", "Line3")
        device.execute("AcquisitionStart")
        for far_ns in (2**63 - 1, -(2**63), 0, time.monotonic_ns() + 10**12):
            device.line3_pulse(far_ns)
        assert (device.counters.missed, device.counters.exposures) == (4, 0)
        device.line3_pulse(time.monotonic_ns())
        assert device.counters.exposures == 1


@pytest.mark.parametrize("niceness", [0, 7])
def test_rendering_gives_way_as_far_as_it_is_told(niceness: int) -> None:
    """By default not at all: a client that spins, as Aravis' asynchronous USB mode does, would leave it no time."""
    rendered = Queue[int]()

    class Source(Ramp):
        def take(self, start_s: float, settings: ImageSettings, noise_seed: int) -> Pixels:
            rendered.put(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))
            return super().take(start_s, settings, noise_seed)

    with closing(Device(Source(), "S1", niceness=niceness)) as device:
        device.execute("AcquisitionStart")
        assert rendered.get(timeout=10) == min(os.getpriority(os.PRIO_PROCESS, 0) + niceness, 19)


S = 1_000_000_000
EPOCH = 1_700_000_000 * S
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
    with gige_client.device(ptp_clock=PTP_CLOCK) as camera:
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
    with gige_client.device(ptp_clock=PTP_CLOCK) as camera:
        frames = waiting_for_actions(camera)
        camera.faults.add(FaultOrder(Fault.LATE_ACTIONS, None, 1))
        at_ns = camera.now_ns() + S // 10
        assert camera.action(at_ns) is ActionOutcome.LATE
        assert abs(frames.get(timeout=PATIENCE_S).device_time_ns - at_ns - LATE_NS) <= 2


def test_a_restart_forgets_actions_and_the_time() -> None:
    with gige_client.device(ptp_clock=PTP_CLOCK) as camera:
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
