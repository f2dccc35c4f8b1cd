"""Acquisition in virtual time, and the device's threads on a real clock."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from queue import Queue

import numpy as np
import pytest

from fake_camera.device.acquisition import Acquisition, Exposure
from fake_camera.device.device import Device
from fake_camera.device.faults import JUMP_NS, Fault, FaultOrder
from fake_camera.device.features import Features
from fake_camera.device.line0 import Line0
from fake_camera.imaging import ExposedFrame, ImageSettings, Pixels
from tests.fake_camera.gige.gige_client import Ramp
from tests.meanwhile import wait_until

MS = 1_000_000
PATIENCE_S = 20.0
SOON_TRIGGERS = 30
NO_FAULTS: frozenset[str] = frozenset()


class Bench:
    """An acquisition at 16 ms per pulse, on a clock that the test sets."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.features = Features("S1", 720, 540, lambda: 0, lambda: self.now_ns)
        self.acquisition = Acquisition(self.features)
        for name in ("ExposureAuto", "GainAuto"):
            self.features.set(name, "Off")

    def await_line0(self, exposure_ms: float, overlap: str) -> None:
        self.features.set("TriggerMode", "On")
        self.features.set("TriggerOverlap", overlap)
        self.features.set("ExposureTime", exposure_ms * 1e3)
        self.acquisition.start(self.now_ns)

    def pulse(self, time_ms: float, number: int = 0, faults: frozenset[str] = NO_FAULTS) -> Exposure | None:
        self.now_ns = round(time_ms * MS)
        return self.acquisition.pulse(number, self.now_ns, faults, wired=True)

    def exposed(self, time_ms: float, number: int = 0, faults: frozenset[str] = NO_FAULTS) -> Exposure:
        exposure = self.pulse(time_ms, number, faults)
        assert exposure is not None
        return exposure

    def free_run_starts_ms(self, count: int) -> list[float]:
        starts = []
        for _ in range(count):
            start_ns = self.acquisition.free_run_start_ns(self.now_ns)
            assert start_ns is not None
            self.acquisition.free_run(start_ns)
            starts.append(start_ns / MS)
        return starts


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_each_pulse_makes_an_exposure_with_its_number_and_time(bench: Bench) -> None:
    bench.await_line0(5.0, "Off")
    exposures = [bench.exposed(16.0 * n, number=n + 7) for n in range(3)]
    assert [(e.frame_id, e.trigger, e.start_ns, e.ready_ns) for e in exposures] == [
        (1, 7, 0, 8 * MS),
        (2, 8, 16 * MS, 24 * MS),
        (3, 9, 32 * MS, 40 * MS),
    ]
    assert bench.acquisition.pulse(0, 48 * MS, NO_FAULTS, wired=False) is None


@pytest.mark.parametrize(
    ("overlap", "second_ms", "taken"),
    [
        ("Off", 4.9, False),  # in the exposure
        ("ReadOut", 4.9, False),
        ("Off", 5.1, False),  # in the readout
        ("ReadOut", 5.1, True),
        ("Off", 8.0, True),
        ("ReadOut", 8.0, True),
    ],
)
def test_a_trigger_in_exposure_or_readout_is_dropped(bench: Bench, overlap: str, second_ms: float, taken: bool) -> None:
    bench.await_line0(5.0, overlap)
    assert bench.pulse(0.0) is not None
    assert (bench.pulse(second_ms) is not None) == taken
    assert bench.acquisition.counters.dropped == (not taken)


def test_readouts_follow_each_other_as_long_as_the_region_is_high_and_no_third_image_waits(bench: Bench) -> None:
    bench.await_line0(0.1, "ReadOut")
    bench.exposed(0.0)
    assert bench.exposed(1.0).ready_ns == 0.1 * MS + 2 * 3 * MS
    assert bench.pulse(2.0) is None
    bench.exposed(3.2)
    bench.acquisition.stop()
    bench.features.set("Height", 180)
    bench.await_line0(5.0, "Off")
    assert bench.exposed(20.0).ready_ns == 26 * MS


def test_a_write_counts_from_its_own_time_on(bench: Bench) -> None:
    bench.await_line0(5.0, "ReadOut")
    first = bench.exposed(0.0)
    bench.now_ns = 2 * MS
    bench.features.set("ExposureTime", 1000.0)
    assert (first.settings.exposure_time_us, first.ready_ns) == (5000, 8 * MS)
    assert bench.exposed(16.0).settings.exposure_time_us == 1000
    bench.now_ns = 32 * MS + 1
    bench.features.set("ExposureTime", 2000.0)
    late = bench.acquisition.pulse(0, 32 * MS, NO_FAULTS, wired=True)  # whose thread comes after the write
    assert late is not None
    assert late.settings.exposure_time_us == 1000


def test_pulses_before_the_start_and_after_the_stop_make_nothing(bench: Bench) -> None:
    bench.now_ns = 10 * MS
    bench.await_line0(1.0, "Off")
    assert bench.features.locked("Width")
    assert bench.acquisition.pulse(0, 9 * MS, NO_FAULTS, wired=True) is None
    bench.exposed(16.0)
    bench.acquisition.stop()
    assert not bench.features.locked("Width")
    assert bench.pulse(32.0) is None
    bench.acquisition.start(bench.now_ns)
    assert bench.exposed(48.0).frame_id == 1


def test_triggers_may_be_ignored_or_halved(bench: Bench) -> None:
    bench.await_line0(1.0, "Off")
    faults = [NO_FAULTS, *[frozenset({Fault.IGNORE_TRIGGERS})] * 2, NO_FAULTS, *[frozenset({Fault.HALVE_TRIGGERS})] * 3]
    exposures = [bench.pulse(16.0 * n, n, each) for n, each in enumerate(faults)]
    assert [e and (e.frame_id, e.trigger) for e in exposures] == [(1, 0), None, None, (2, 3), (3, 4), None, (4, 6)]
    assert bench.acquisition.counters.ignored == 3


def test_a_software_trigger_exposes_only_when_it_is_the_source_and_not_ignored(bench: Bench) -> None:
    bench.await_line0(1.0, "Off")
    assert bench.acquisition.software_trigger(16 * MS) is None
    bench.features.set("TriggerSource", "Software")
    bench.pulse(32.0, faults=frozenset({Fault.IGNORE_TRIGGERS}))
    assert bench.acquisition.software_trigger(33 * MS) is None
    assert bench.acquisition.counters.ignored == 1
    assert bench.pulse(48.0) is None
    exposure = bench.acquisition.software_trigger(49 * MS)
    assert exposure is not None
    assert (exposure.trigger, exposure.frame_id) == (None, 1)


def test_a_frozen_exposure_stays_whatever_is_written(bench: Bench) -> None:
    bench.await_line0(5.0, "ReadOut")
    bench.pulse(0.0)
    bench.features.set("ExposureTime", 1000.0)
    frozen, free = bench.exposed(16.0, faults=frozenset({Fault.FREEZE_EXPOSURE})), bench.exposed(32.0)
    assert frozen.settings.exposure_time_us == 5000
    assert free.settings.exposure_time_us == bench.features.get("ExposureTime") == 1000


def test_runs_free_at_the_frame_rate_or_as_fast_as_the_sensor_goes(bench: Bench) -> None:
    bench.features.set("AcquisitionFrameRate", 50.0)
    bench.acquisition.start(0)
    assert bench.free_run_starts_ms(3) == [0, 20, 40]
    bench.features.set("ExposureTime", 30_000.0)
    assert bench.free_run_starts_ms(3) == [60, 90, 120]
    bench.features.set("TriggerMode", "On")
    bench.now_ns = 500 * MS
    assert bench.acquisition.free_run_start_ns(500 * MS) is None
    bench.features.set("TriggerMode", "Off")
    bench.features.set("AcquisitionFrameRateEnable", False)
    bench.features.set("ExposureTime", 1000.0)
    assert bench.free_run_starts_ms(3) == [500, 503, 506]  # it does not make up for the time it was off


def test_a_single_frame_ends_the_acquisition(bench: Bench) -> None:
    bench.features.set("AcquisitionMode", "SingleFrame")
    bench.acquisition.start(0)
    bench.free_run_starts_ms(1)
    assert bench.acquisition.free_run_start_ns(bench.now_ns) is None
    assert not bench.features.locked("Width")


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
def test_runs_free_after_power_on(device: Device, source: FlatSource) -> None:
    client = Client(device)
    device.execute("AcquisitionStart")
    frames = client.wait(lambda frames: len(frames) >= 3)
    assert {frame.trigger for frame in frames} == {None}
    device.execute("AcquisitionStop")
    device.execute("AcquisitionStart")
    client.wait(lambda again: len(again) > len(frames) + 1)
    assert len(set(source.seeds)) == len(source.seeds)  # the noise of two acquisitions differs, too
    with pytest.raises(KeyError):
        device.execute("FileOpen")


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


@pytest.mark.realtime
def test_a_source_slower_than_the_trigger_loses_frames_but_not_all(device: Device, source: FlatSource) -> None:
    source.takes_s = 0.025  # a trigger comes every 0.01 s
    client = Client(device)
    trigger_by_line0(device)
    wait_until(lambda: device.counters.overruns > 0)
    sent = len(client.frames)
    client.wait(lambda frames: len(frames) >= sent + 10)


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
