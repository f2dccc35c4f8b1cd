"""Both cameras triggered by the daemon, by software or by scheduled actions on a clock they share, in virtual time."""

from __future__ import annotations

import logging
from collections import Counter

import pytest

from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.messages.frames import Stamping
from autoexpose_daemon.runtime.stamp_watch import StampWatch
from drivers.triggers.host import PATIENCE_NS
from drivers.triggers.outcomes import LossReason
from imaging.frames import FrameSet
from tests.autoexpose_daemon.virtual import EXACT_NS, HELD_NS, HostRun, PtpRun, tuning
from tests.soak import ptp as virtual_ptp
from tests.soak import rig as virtual_rig
from tests.soak.camera import VirtualFrame
from tests.soak.clock import MS, SECOND
from tests.soak.ptp import ERROR_NS, Master

RATE_HZ = 60


class SoftwareRun(HostRun):
    """After its first second."""

    def __init__(self, rate_hz: float = RATE_HZ, phase_ms: float | None = None) -> None:
        self.pairs: list[FrameSet] = []
        super().__init__("software", rate_hz, phase_ms=phase_ms)
        self.left, self.right = self.rig.devices
        self.let_pass(2.0)

    def lost(self) -> Counter[str]:
        """Why slots made no pair, without start and end; each of the slots that passed is accounted for."""
        self.rig.control.close()
        tally = self.rig.control.record.tally
        assert tally.window_start_ns is not None and tally.window_end_ns is not None
        assert tally.triggers == round((tally.window_end_ns - tally.window_start_ns) * self.rate_hz / SECOND)
        assert tally.surplus_frames == 0
        lost = +tally.lost
        assert lost.pop(LossReason.STARTUP) < self.rate_hz
        del lost[LossReason.SHUTDOWN]
        return lost

    def _see_pair(self, step: ControlStep) -> None:
        self.pairs.append(step.pair)
        slots = {frame.pulse for frame in step.pair.frames.values() if isinstance(frame, VirtualFrame)}
        assert len(slots) == 1, f"a pair of the slots {slots}"


@pytest.fixture
def run() -> SoftwareRun:
    return SoftwareRun()


def test_a_quiet_host_gives_every_trigger_at_its_time(run: SoftwareRun) -> None:
    run.pairs.clear()
    run.let_pass(10.0)
    assert len(run.pairs) == 10 * RATE_HZ
    times_ns = [pair.reference.host_time_ns for pair in run.pairs]
    assert abs(times_ns[-1] - times_ns[0] - 599 * SECOND / RATE_HZ) < 2 * MS
    assert run.said == ["exposing"]
    assert run.rig.control.record.tally.lost.keys() == {LossReason.STARTUP}


@pytest.mark.parametrize("stopped_s", [0.1, 3.0, 60.0])
def test_a_stopped_process_gives_no_triggers_and_makes_up_for_none(run: SoftwareRun, stopped_s: float) -> None:
    run.rig.stop_process(round(stopped_s * SECOND))
    run.let_pass(stopped_s + 5.0)
    lost = run.lost()
    assert lost.keys() == {LossReason.NOT_GIVEN}
    assert lost[LossReason.NOT_GIVEN] == pytest.approx(stopped_s * RATE_HZ, abs=2)


def test_one_camera_that_is_not_triggered_in_time_is_the_reason(run: SoftwareRun) -> None:
    """Its nodes are busy with a slow write, which the other one's are not."""
    run.right.write_ns = 50 * MS
    run.rig.control.tune(tuning(1000.0, trigger={"mode": "software", "rate_hz": RATE_HZ}))
    run.let_pass(0.2)
    run.right.write_ns = 0
    run.let_pass(1.0)
    lost = run.lost()
    assert lost.keys() == {LossReason.NOT_GIVEN}
    assert 2 <= lost[LossReason.NOT_GIVEN] <= 4


def test_a_trigger_that_the_camera_ignores_is_another_reason(run: SoftwareRun) -> None:
    run.left.ignore = 3
    run.let_pass(1.0)
    assert run.lost() == {LossReason.TRIGGER_IGNORED: 3}


def test_a_lost_camera_is_triggered_by_software_when_it_is_back(run: SoftwareRun) -> None:
    run.left.vanish()
    run.let_pass(3.0)
    assert "left camera gone" in run.said[-1]
    run.left.present = True
    run.let_pass(5.0)
    assert run.said[-1] == "exposing"
    lost = run.lost()
    assert lost.keys() <= {LossReason.CAMERA_GONE, "left_missing"}
    assert lost[LossReason.CAMERA_GONE] > 2 * RATE_HZ


def test_exposures_are_as_near_as_the_clocks() -> None:
    run = PtpRun()
    run.begin()
    run.let_pass(60.0)
    assert len(run.apart_ns) == pytest.approx(60 * run.rate_hz, abs=1)
    assert max(run.apart_ns) < EXACT_NS
    assert run.said == []
    assert run.end() == {}
    skew_ms = run.rig.control.telemetry.skew_ms.percentiles()
    assert skew_ms["p99"] is not None and skew_ms["p99"] * MS < 2 * ERROR_NS + 5000


def test_without_a_master_nothing_is_triggered_and_one_sentence_says_why() -> None:
    run = PtpRun()
    run.master.on_air = False
    run.let_pass(PATIENCE_NS / SECOND + 3)
    assert run.apart_ns == [] and run.alone == 0
    assert run.rig.control.record.tally.lost.total() == 0, "what was never triggered is not lost"
    assert "left camera: its clock found no PTP master within 10 s (PtpStatus Listening)" in run.said[-1]
    run.master.on_air = True
    run.let_pass(10.0)
    assert run.said[-1] == "exposing"
    assert max(run.apart_ns) < EXACT_NS
    assert run.end() == {}


def test_a_camera_without_a_master_is_left_waiting_and_the_other_one_exposes() -> None:
    run = PtpRun()
    run.right.hears = False
    run.let_pass(60.0)
    assert "right camera: its clock found no PTP master within 10 s" in run.said[-1]
    assert run.alone > 40 * run.rate_hz
    assert run.right.session == 1, "it was reopened, which does not help"


@pytest.mark.parametrize("camera", ["left", "both"])
def test_a_clock_that_is_no_longer_synchronised_is_named_and_its_frames_still_pair(camera: str) -> None:
    """For so long that the clocks drift apart by more than half a period."""
    run = PtpRun()
    run.begin()
    deaf = [device for device in (run.left, run.right) if camera in (device.camera, "both")]
    for device in deaf:
        device.hears = False
    run.let_pass(200.0)
    for device in deaf:
        named = f"{device.camera} camera: its clock is no longer synchronised: check the PTP master"
        assert named in run.said[-1]
    assert len(run.apart_ns) == pytest.approx(200 * run.rate_hz, abs=2)
    assert max(run.apart_ns) < HELD_NS
    for device in deaf:
        device.hears = True
    run.let_pass(15.0)
    assert run.said[-1] == "exposing"
    run.apart_ns.clear()
    run.let_pass(5.0)
    assert max(run.apart_ns) < EXACT_NS
    assert sum(run.end(most_surplus=8).values()) <= 8


def test_a_master_that_is_set_costs_a_few_frames() -> None:
    run = PtpRun()
    run.begin()
    run.master.set_by(37 * SECOND)  # leap seconds, by mistake
    run.let_pass(20.0)
    assert run.said == [] or run.said[-1] == "exposing"
    run.apart_ns.clear()
    run.let_pass(5.0)
    assert max(run.apart_ns) < EXACT_NS
    assert sum(run.end(most_surplus=4).values()) <= 8


def test_two_masters_are_noticed() -> None:
    run = PtpRun()
    run.begin()
    other = Master()
    other.set_by(-3 * SECOND)
    run.right.master = other
    run.let_pass(20.0)
    assert "right camera: its clock is 3.0 s off that of the other cameras: have all follow one PTP" in run.said[-1]
    run.apart_ns.clear()
    run.let_pass(5.0)
    assert len(run.apart_ns) == pytest.approx(5 * run.rate_hz, abs=1)
    assert max(run.apart_ns) < HELD_NS


def test_a_lost_camera_is_triggered_by_actions_when_it_is_back() -> None:
    run = PtpRun(rate_hz=60.0)
    run.begin()
    run.right.vanish()
    run.let_pass(5.0)
    assert "right camera gone" in run.said[-1]
    run.right.present = True
    run.let_pass(10.0)
    assert run.said[-1] == "exposing"
    assert run.alone > 0
    assert run.end().keys() <= {LossReason.CAMERA_GONE, "right_missing"}


@pytest.mark.parametrize("stopped_s", [0.03, 4.0])
def test_a_stopped_process_sends_no_actions_and_makes_up_for_none(stopped_s: float) -> None:
    """A short stop costs nothing, since actions are sent ahead."""
    run = PtpRun()
    run.begin()
    run.rig.stop_process(round(stopped_s * SECOND))
    run.let_pass(stopped_s + 5.0)
    lost = run.end()
    if stopped_s < 0.04:
        assert lost == {}
    else:
        assert lost.keys() == {LossReason.NOT_GIVEN}
        assert lost[LossReason.NOT_GIVEN] == pytest.approx(stopped_s * run.rate_hz, abs=2)


def test_two_hours_with_a_master_that_comes_and_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a low rate, so that this takes seconds; tests/accept/test_ptp.py has a higher one."""
    monkeypatch.setattr(virtual_ptp, "SERVO_NS", 2 * SECOND)
    for name in ("POLL_NS", "BEAT_NS", "LOOK_NS"):
        monkeypatch.setattr(virtual_rig, name, 2 * SECOND)
    run = PtpRun(rate_hz=0.5)
    run.let_pass(30.0)
    run.hours_with_outages(2)


LIDAR_HZ = 10
PHASE_MS = 30.0
STAMPED_NS = 5_000
"""How far from the truth a virtual camera's stamp may be."""


def off_phase_ns(times_ns: list[int]) -> list[int]:
    """How far from `PHASE_MS` after each tenth of a second; negative: before."""
    period_ns = SECOND // LIDAR_HZ
    return [(time_ns - round(PHASE_MS * MS) + period_ns // 2) % period_ns - period_ns // 2 for time_ns in times_ns]


def in_ptp_time(run: PtpRun) -> list[int]:
    """When the pairs since the last call were taken, truly, by the master's clock."""
    times_ns = [frame.pulse for pair in run.pairs if isinstance(frame := pair.frames["left"], VirtualFrame)]
    run.pairs.clear()
    return [run.master.time_ns(time_ns) for time_ns in times_ns]


def test_scheduled_exposures_keep_their_phase_within_the_second_of_ptp_time() -> None:
    run = PtpRun(LIDAR_HZ, PHASE_MS)
    run.begin()
    in_ptp_time(run)
    run.let_pass(60.0)
    off_ns = off_phase_ns(in_ptp_time(run))
    assert len(off_ns) == pytest.approx(600, abs=1)
    assert max(map(abs, off_ns)) < EXACT_NS


@pytest.mark.parametrize("set_by_ns", [37 * SECOND, 43 * MS, -49 * MS])
def test_they_come_back_to_their_phase_when_the_master_is_set(set_by_ns: int) -> None:
    """Smoothly: it costs no more than without a phase, and no pair is of two instants."""
    run = PtpRun(LIDAR_HZ, PHASE_MS)
    run.begin()
    run.master.set_by(set_by_ns)
    run.let_pass(10.0)
    run.apart_ns.clear()
    run.let_pass(60.0)
    assert max(run.apart_ns) < HELD_NS
    in_ptp_time(run)
    run.let_pass(60.0)
    assert max(map(abs, off_phase_ns(in_ptp_time(run)))) < 20_000
    assert sum(run.end(most_surplus=4).values()) <= 8


def test_they_come_back_to_their_phase_after_a_quarter_of_an_hour_without_a_master() -> None:
    run = PtpRun(LIDAR_HZ, PHASE_MS)
    run.begin()
    run.master.on_air = False
    run.let_pass(900.0)
    run.master.on_air = True
    run.let_pass(120.0)
    assert run.said[-1] == "exposing"
    in_ptp_time(run)
    run.let_pass(10.0)
    assert max(map(abs, off_phase_ns(in_ptp_time(run)))) < 20_000
    assert sum(run.end(most_surplus=15).values()) <= 15


def test_software_triggers_keep_their_phase_within_the_second_of_the_hosts_clock() -> None:
    run = SoftwareRun(LIDAR_HZ, PHASE_MS)

    def late_ns() -> list[int]:
        times_ns = [pair.reference.host_time_ns + run.rig.realtime_offset_ns for pair in run.pairs]
        run.pairs.clear()
        return off_phase_ns(times_ns)

    run.let_pass(10.0)
    assert max(map(abs, late_ns())) < MS
    run.rig.realtime_offset_ns += 13 * SECOND + 47 * MS  # somebody sets the clock
    run.let_pass(60.0)
    run.pairs.clear()
    run.let_pass(10.0)
    assert len(run.pairs) == 10 * LIDAR_HZ
    assert max(map(abs, late_ns())) < MS
    assert run.lost() == {}


def test_frames_tell_ptp_time_also_while_their_master_is_away() -> None:
    """As the host's clock goes on: it is off by 40 ppm of the time since, and of no camera's own."""
    run = PtpRun()
    run.begin()

    def errors_ns() -> list[int]:
        frames = [(frame, run.master.time_ns(frame.pulse)) for pair in run.pairs
                  if isinstance(frame := pair.reference, VirtualFrame)]  # fmt: skip
        run.pairs.clear()
        return [abs(frame.ptp_time_ns - true_ns) for frame, true_ns in frames if frame.ptp_time_ns is not None]

    run.pairs.clear()
    run.let_pass(10.0)
    assert all(pair.reference.ptp_time_ns == pair.reference.device_time_ns for pair in run.pairs)
    assert max(errors_ns()) < EXACT_NS + STAMPED_NS
    run.master.on_air = False
    run.let_pass(100.0)
    assert EXACT_NS + STAMPED_NS < max(errors_ns()) < 100 * SECOND * 40e-6 + HELD_NS


@pytest.mark.parametrize(
    ("utc_offset_s", "realtime_ahead_s", "words"),
    [(37, -37, []), (37, 0, ["-37", "UTC", "ptp_utc_offset_s: 0"]), (0, -37, ["+37", "TAI", "ptp_utc_offset_s: 37"]),
     (37, 500, ["-537", "by its clock"])],
)  # fmt: skip
def test_stamps_that_are_far_from_the_computers_clock_are_told_once(
    utc_offset_s: int, realtime_ahead_s: int, words: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    watch, ptp_ns = StampWatch(Stamping("middle", utc_offset_s)), 1_700_000_000 * SECOND
    with caplog.at_level(logging.INFO):
        for second in range(3):
            watch.look(ptp_ns + second * SECOND, ptp_ns + (second + realtime_ahead_s) * SECOND)
    (record,) = caplog.records
    assert record.levelno == (logging.WARNING if words else logging.INFO)
    assert all(word in record.message for word in words)
