"""The supervisor of a camera and its pace, in virtual time; `test_rig` covers it with its threads."""

from __future__ import annotations

import itertools
import math
import queue
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Camera, RefusedPackets
from drivers.rig.events import (
    CameraGone,
    CameraReady,
    CameraSilent,
    FrameArrived,
    NotTriggered,
    PacketsRefused,
    RigEvent,
    TemperatureRead,
    Written,
)
from drivers.rig.supervision import LATE_PERIODS, Pacer, Slots, Supervisor
from imaging.errors import (
    AutoexposeError,
    CameraBusyError,
    CameraLostError,
    CameraNotFoundError,
    ConfigurationError,
    NodeError,
    UnsupportedCameraError,
)
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from tests.drivers.rig.test_rig import START, ScriptedCamera

RATES_HZ = st.floats(0.1, 1000.0)
PAUSES = st.lists(st.floats(0.001, 50.0), min_size=1, max_size=60)
"""Between two looks, in periods."""


@given(RATES_HZ, st.integers(0, 10**16), PAUSES)
def test_each_slot_is_used_once_and_in_time_or_counted_as_missed(
    rate_hz: float, first_ns: int, pauses: list[float]
) -> None:
    slots = Slots.at_once(rate_hz, first_ns)
    now_ns = first_ns + 123
    pacer = Pacer(slots, now_ns)
    next_slot = slots.first_from(now_ns)
    for pause in pauses:
        now_ns += round(pause * slots.period_ns)
        while pacer.due_ns <= now_ns:
            slot, missed = pacer.take(now_ns)
            next_slot += missed
            if slot is not None:
                assert slot == next_slot
                assert 0 <= now_ns - slots.time_ns(next_slot) <= slots.closes_ns + 2
                next_slot += 1
        assert slots.time_ns(next_slot) == pacer.due_ns > now_ns


def test_a_pause_makes_no_burst_and_no_slot_drifts() -> None:
    slots = Slots.at_once(60.0, 1_000)
    pacer = Pacer(slots, 0)
    assert pacer.take(1_000) == (0, 0)
    in_slot_600 = slots.time_ns(600) + 1_000_000
    assert pacer.take(in_slot_600) == (600, 599)
    assert pacer.take(in_slot_600) == (None, 0)
    after_slot_700 = slots.time_ns(700) + math.ceil(LATE_PERIODS * slots.period_ns) + 1
    assert pacer.take(after_slot_700) == (None, 100)
    assert slots.time_ns(60 * 3600 * 24 * 365) == 1_000 + 3600 * 24 * 365 * 1_000_000_000


def test_scheduled_triggers_are_sent_ahead_as_far_as_the_queue_of_the_camera_allows() -> None:
    epoch_ns = 1_700_000_000_000_000_000
    for ahead, lead_ms in ((1, 15.0), (2, 31.667), (3, 48.333), (10, 50.0)):
        slots = Slots.ahead(60.0, 1_000, epoch_ns, ahead)
        assert -slots.opens_ns == pytest.approx(lead_ms * 1e6, abs=1e3)
        assert slots.device_time_ns(60) == epoch_ns + 1_000_000_000
    pacer = Pacer(slots, 1_000)
    assert pacer.due_ns >= 1_000
    sent = []
    while (slot := pacer.take(200_000_000)[0]) is not None:  # after a pause: those that are still to come
        sent.append(slot)
    assert sent == [13, 14]
    assert all(2_000_000 <= slots.time_ns(slot) - 200_000_000 <= 50_000_000 for slot in sent)


SECOND_NS = 1_000_000_000
SILENCE_S = 0.2


class InstantCamera(ScriptedCamera):
    """Answers at once; `latches` counts how often its clock was read, `looks` how often its temperature was."""

    latches = 0
    looks = 0
    warm_c: float | None = None
    refuses_latches = False
    refused: RefusedPackets | None = None

    def refused_packets(self) -> RefusedPackets | None:
        return self.refused

    def next_frame(self, timeout_s: float) -> Frame | None:
        return super().next_frame(0.0)

    def trigger(self) -> None:
        self._check()

    def temperature_c(self) -> float | None:
        self.looks += 1
        return self.warm_c

    def latch_clock(self) -> None:
        super().latch_clock()
        self.latches += 1
        if self.refuses_latches:
            raise NodeError("camera S: TimestampLatch is locked")


class Bench:
    """A supervisor that is served in virtual time; `camera` is what the opener opens, or the error it raises."""

    def __init__(self, camera: InstantCamera | AutoexposeError) -> None:
        self.camera = camera
        self.now_ns = 0
        self.attempts_ns: list[int] = []
        self.events: queue.SimpleQueue[RigEvent] = queue.SimpleQueue()
        self.supervisor = Supervisor("left", self._open, SILENCE_S, START, self.events, now_ns=lambda: self.now_ns)

    def run(self, seconds: float, take_frames: bool = True) -> list[RigEvent]:
        end_ns = self.now_ns + round(seconds * SECOND_NS)
        while self.now_ns < end_ns:
            if self.supervisor.serve_due_ns <= self.now_ns:
                self.supervisor.serve()
            if take_frames and self.supervisor.take_due_ns <= self.now_ns:
                self.supervisor.take_frame()
            self.now_ns += SECOND_NS // 100
        return [self.events.get_nowait() for _ in range(self.events.qsize())]

    def _open(self) -> Camera:
        self.attempts_ns.append(self.now_ns)
        if isinstance(self.camera, AutoexposeError):
            raise self.camera
        return self.camera


def pauses_s(attempts_ns: list[int]) -> list[float]:
    return [(later - earlier) / SECOND_NS for earlier, later in itertools.pairwise(attempts_ns)]


def test_a_camera_that_does_not_open_is_retried_less_and_less_often_however_much_is_written() -> None:
    bench = Bench(CameraNotFoundError("no camera S"))
    for _ in range(100):
        bench.supervisor.request(ExposureSetting(2000.0, 0.0), 0, 1)
        bench.run(0.1)
    assert pauses_s(bench.attempts_ns) == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0]


def test_a_camera_that_ran_for_long_is_soon_retried() -> None:
    camera = InstantCamera()
    bench = Bench(CameraNotFoundError("no camera S"))
    bench.run(10.0)
    bench.camera = camera
    bench.run(5.0)
    camera.lost, bench.camera = True, CameraNotFoundError("no camera S")
    bench.attempts_ns.clear()
    bench.run(2.0)
    assert pauses_s(bench.attempts_ns) == [0.2, 0.4, 0.8]
    assert camera.closed.wait(10.0)


def test_a_camera_that_is_opened_takes_the_newest_setting_once() -> None:
    camera = InstantCamera()
    bench = Bench(CameraNotFoundError("no camera S"))
    bench.run(0.5)
    bench.supervisor.request(ExposureSetting(2000.0, 0.0), 0, 1)
    bench.camera = camera
    bench.run(2.0)
    assert camera.written == [ExposureSetting(2000.0, 0.0)]


def test_a_clock_that_cannot_be_read_is_logged_but_not_every_second(caplog: pytest.LogCaptureFixture) -> None:
    camera = InstantCamera()
    camera.refuses_latches = True
    Bench(camera).run(5.0)
    (message,) = caplog.messages
    assert "left camera" in message and "TimestampLatch is locked" in message


def test_a_camera_that_is_reopened_is_closed_first_and_the_reason_is_reported() -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    bench.run(1.0)
    bench.supervisor.reopen("sends no frames while the other one does")
    bench.camera = InstantCamera()
    gone, *_, ready = (event for event in bench.run(1.0) if isinstance(event, CameraGone | CameraReady))
    assert camera.closed.is_set()
    assert isinstance(gone, CameraGone)
    assert str(gone.error).endswith("sends no frames while the other one does; it is reopened")
    assert isinstance(ready, CameraReady)


@pytest.mark.parametrize(
    ("error", "final"),
    [
        (ConfigurationError("camera S: features: Widht: the camera has no such feature"), True),
        (UnsupportedCameraError("camera S: it has no PixelFormat"), True),
        (NodeError("camera S: its ExposureMode is TriggerWidth and cannot be Timed"), True),
        (CameraBusyError("camera S: could not set Width to 8: busy"), False),
        (CameraLostError("camera S does not answer"), False),
        (CameraNotFoundError("no camera S"), False),
    ],
)
def test_a_returning_camera_is_tried_again_unless_the_fault_stays(error: AutoexposeError, final: bool) -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    bench.run(0.1)
    camera.lost, bench.camera = True, error
    assert isinstance(bench.run(0.05)[0], CameraGone)  # noticed at once
    gone = [event for event in bench.run(0.5) if isinstance(event, CameraGone)]
    assert (gone[-1].error, gone[-1].final) == (error, final)
    bench.camera = InstantCamera()
    assert any(isinstance(event, CameraReady) for event in bench.run(3.0)) != final
    if final:
        assert bench.supervisor.serve_due_ns == bench.supervisor.take_due_ns == math.inf


@pytest.mark.parametrize("final", [True, False])
def test_a_camera_that_opens_but_does_not_start_is_tried_again_unless_the_fault_stays(final: bool) -> None:
    class Unstartable(InstantCamera):
        def start(self) -> None:
            raise NodeError("camera S: no AcquisitionStart") if final else CameraBusyError("camera S: busy")

    bench = Bench(Unstartable())
    gone = [event for event in bench.run(1.0) if isinstance(event, CameraGone)]
    assert {event.final for event in gone} == {final}
    assert (len(bench.attempts_ns) == 1) == final


def test_the_first_setting_is_one_that_the_camera_takes() -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    bench.supervisor.request(ExposureSetting(1e9, 99.0), 0, 1)
    bench.run(0.1)
    assert camera.written == [camera.limits.brightest]


def test_the_clock_and_refused_packets_are_read_once_a_second_and_at_a_silence() -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    events = bench.run(0.95)
    assert [type(event) for event in events] == [Written, CameraReady, CameraSilent]
    assert camera.latches == 1
    camera.expose()
    bench.run(0.1)
    assert camera.latches == 1
    bench.run(4.0)
    assert camera.latches == 5
    camera.refused = RefusedPackets(5, ("10.0.0.9:40000",), ("10.0.0.2",))
    reported = [event for event in bench.run(3.0) if isinstance(event, PacketsRefused)]
    assert reported == [PacketsRefused("left", camera.refused)] * 3
    bench.supervisor.pace(Slots.at_once(0.1, bench.now_ns + SECOND_NS))  # rarely triggered: read in between
    bench.run(10.0)
    assert camera.latches >= 13


def test_the_temperature_is_read_rarely() -> None:
    camera = InstantCamera()
    camera.warm_c = 46.0
    bench = Bench(camera)
    camera.expose()
    told = [event for event in bench.run(30.5) if isinstance(event, TemperatureRead)]
    assert told == [TemperatureRead("left", 46.0)] * camera.looks
    assert camera.looks in (3, 4)
    camera.warm_c = None
    assert not [event for event in bench.run(30.0) if isinstance(event, TemperatureRead)]


def test_a_camera_that_is_closed_while_its_pace_is_set_is_reopened_without_one() -> None:
    bench = Bench(InstantCamera())
    bench.run(0.1)
    supervisor = bench.supervisor
    closing = threading.Thread(target=supervisor.close)

    def meanwhile() -> int:
        closing.start()
        closing.join(0.2)  # it must wait for the pace
        return bench.now_ns

    supervisor._now_ns = meanwhile
    supervisor.pace(Slots.at_once(10.0, bench.now_ns))
    supervisor._now_ns = lambda: bench.now_ns
    closing.join()
    bench.now_ns += 60 * SECOND_NS
    assert not any(isinstance(event, NotTriggered) for event in bench.run(1.0))


def test_missed_slots_are_reported_before_the_next_trigger_whose_frame_may_come_at_once() -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    bench.run(0.1)
    bench.supervisor.pace(Slots.at_once(10.0, bench.now_ns))
    bench.run(0.5)
    before: list[int] = []
    camera.trigger = lambda: before.append(bench.events.qsize())  # type: ignore[method-assign]
    bench.now_ns += SECOND_NS
    (missed, *_) = [event for event in bench.run(0.02) if isinstance(event, NotTriggered)]
    assert missed.count >= 9
    assert before[0] >= 1


def test_no_frame_of_a_lost_camera_is_reported_after_its_loss() -> None:
    camera = InstantCamera()
    bench = Bench(camera)
    bench.run(0.1)
    camera.expose()
    assert any(isinstance(event, FrameArrived) for event in bench.run(0.1))
    camera.expose()
    camera.lost = True
    bench.supervisor.request(START, 0, 1)
    assert [type(event) for event in bench.run(0.05, take_frames=False)] == [CameraGone]
    camera.lost = False
    bench.supervisor.take_frame()
    assert bench.events.empty()
