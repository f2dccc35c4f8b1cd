"""Both cameras triggered by scheduled actions on a clock that they share, in virtual time."""

from __future__ import annotations

from collections import Counter

import pytest

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.status.states import Health
from drivers.frames import StereoPair
from drivers.ptp.sync import PATIENCE_NS
from drivers.triggers.account import LossReason
from tests.autoexpose_daemon.virtual import START_US, tuning
from tests.soak import ptp as virtual_ptp
from tests.soak import rig as virtual_rig
from tests.soak.camera import VirtualFrame
from tests.soak.clock import MS, SECOND
from tests.soak.ptp import ERROR_NS, Master, PtpDevice
from tests.soak.rig import VirtualRig

EXACT_NS = 3 * ERROR_NS + 100
"""How far apart exposures are while both clocks are synchronised: each by its error, and its drift in half a second."""
HELD_NS = MS
"""And otherwise: by the host's readings of the clocks, once a second."""


class PtpRun:
    """A rig of two cameras with a PTP master, if there is one."""

    def __init__(self, rate_hz: float = 20.0, master_from_ns: int = 0) -> None:
        self.apart_ns: list[int] = []
        self.alone = 0
        self.said: list[str] = []
        self.rate_hz = rate_hz
        self.master = Master()
        self.rig = VirtualRig(
            7,
            self._see_pair,
            self._see_health,
            tuning(START_US, trigger={"mode": "ptp", "rate_hz": rate_hz}),
            new_device=PtpDevice,
        )
        left, right = self.rig.devices
        assert isinstance(left, PtpDevice) and isinstance(right, PtpDevice)
        self.left, self.right = left, right
        for unit in self.rig.units.values():
            assert isinstance(unit.device, PtpDevice)
            unit.device.on_frame = unit.plan_frames
            unit.device.master = self.master
        self.actors = [actor for device in (left, right) for actor in device.actors]

    def let_pass(self, seconds: float) -> None:
        self.rig.run(self.actors, self.rig.clock.now_ns + round(seconds * SECOND))

    def begin(self) -> None:
        """Until pairs have come for a second."""
        self.let_pass(10.0)
        assert len(self.apart_ns) >= self.rate_hz
        assert self.said == ["exposing"]
        self.apart_ns.clear()
        self.said.clear()

    def end(self, most_surplus: int = 0) -> Counter[LossReason]:
        """Why slots made no pair, apart from start and end.

        When a clock is set, actions that wait for their time act at another: these frames are surplus.
        """
        self.rig.control.close()
        tally = self.rig.control.record.tally
        assert tally.surplus_frames <= most_surplus
        lost = +tally.lost
        del lost[LossReason.STARTUP], lost[LossReason.SHUTDOWN]
        return lost

    def _see_pair(self, pair: StereoPair, _decision: Decision | None) -> None:
        times_ns = [frame.pulse for frame in pair.frames.values() if isinstance(frame, VirtualFrame)]
        if len(times_ns) == 1:
            self.alone += 1
            return
        self.apart_ns.append(abs(times_ns[0] - times_ns[1]))
        assert self.apart_ns[-1] < SECOND / self.rate_hz / 2, "a pair of two instants"

    def _see_health(self, _now_ns: int, health: Health) -> None:
        self.said.append(str(health))


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
    sentence = "left camera: its clock found no PTP master within 10 s (PtpStatus Listening): start one, and check"
    assert sentence in run.said[-1]
    run.master.on_air = True
    run.let_pass(10.0)
    assert run.said[-1] == "exposing"
    assert max(run.apart_ns) < EXACT_NS
    assert run.end() == {}


@pytest.mark.parametrize("side", ["left", "right", "both"])
def test_a_clock_that_is_no_longer_synchronised_is_named_and_its_frames_still_pair(side: str) -> None:
    """For so long that the clocks drift apart by more than half a period."""
    run = PtpRun()
    run.begin()
    deaf = [device for device in (run.left, run.right) if side in (device.side, "both")]
    for device in deaf:
        device.hears = False
    run.let_pass(200.0)
    for device in deaf:
        named = f"{device.side} camera: its clock is no longer synchronised: check the PTP master"
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
    assert sum(run.end(most_surplus=4).values()) <= 8


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
    assert "right camera: its clock is 3.0 s off the other camera's: have both follow one PTP master" in run.said[-1]
    run.apart_ns.clear()
    run.let_pass(5.0)
    assert len(run.apart_ns) == pytest.approx(5 * run.rate_hz, abs=1)
    assert max(run.apart_ns) < HELD_NS


def test_a_lost_camera_is_triggered_again_when_it_is_back() -> None:
    run = PtpRun()
    run.begin()
    run.right.vanish()
    run.let_pass(5.0)
    assert "right camera gone" in run.said[-1]
    run.right.present = True
    run.let_pass(10.0)
    assert run.said[-1] == "exposing"
    assert run.alone > 0
    assert run.end().keys() <= {LossReason.CAMERA_GONE, LossReason.RIGHT_MISSING}


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


def test_ten_hours_with_a_master_that_comes_and_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each hour both cameras are without it for ten minutes; at a low rate, so that this takes seconds."""
    monkeypatch.setattr(virtual_ptp, "SERVO_NS", SECOND)
    monkeypatch.setattr(virtual_rig, "POLL_NS", SECOND)
    monkeypatch.setattr(virtual_rig, "BEAT_NS", SECOND)
    monkeypatch.setattr(virtual_rig, "LOOK_NS", SECOND)
    run = PtpRun(rate_hz=0.5)
    run.let_pass(20.0)
    for _ in range(10):
        run.master.on_air = False
        run.let_pass(600.0)
        assert "left camera: its clock is no longer synchronised" in run.said[-1]
        run.master.on_air = True
        run.let_pass(3000.0)
        assert run.said[-1] == "exposing"
    assert len(run.apart_ns) == pytest.approx(18_000, abs=20)
    further = [apart_ns for apart_ns in run.apart_ns if apart_ns >= HELD_NS]
    assert len(further) <= 10  # actions that waited while the master came back, and set the clocks
    assert sum(run.end(most_surplus=20).values()) <= 40
