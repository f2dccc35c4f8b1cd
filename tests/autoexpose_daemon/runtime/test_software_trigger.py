"""Both cameras triggered by the daemon itself, in virtual time: every slot is a pair, or lost for a reason."""

from __future__ import annotations

from collections import Counter

import pytest

from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.status.states import Health
from drivers.triggers.outcomes import LossReason
from imaging.frames import StereoPair
from tests.autoexpose_daemon.virtual import START_US, tuning
from tests.soak.camera import VirtualFrame
from tests.soak.clock import MS, SECOND
from tests.soak.rig import VirtualRig

RATE_HZ = 60
SOFTWARE = {"mode": "software", "rate_hz": RATE_HZ}


class SoftwareRun:
    """A rig of two cameras that the host triggers, after its first second."""

    def __init__(self) -> None:
        self.pairs: list[StereoPair] = []
        self.said: list[str] = []
        self.rig = VirtualRig(7, self._see_pair, self._see_health, tuning(START_US, trigger=SOFTWARE))
        self.left, self.right = self.rig.devices
        self.let_pass(2.0)

    def let_pass(self, seconds: float) -> None:
        self.rig.run([], self.rig.clock.now_ns + round(seconds * SECOND))

    def lost(self) -> Counter[LossReason]:
        """Why slots made no pair, without start and end; each of the slots that passed is accounted for."""
        self.rig.control.close()
        tally = self.rig.control.record.tally
        assert tally.window_start_ns is not None and tally.window_end_ns is not None
        assert tally.triggers == round((tally.window_end_ns - tally.window_start_ns) * RATE_HZ / SECOND)
        assert tally.surplus_frames == 0
        lost = +tally.lost
        assert lost.pop(LossReason.STARTUP) < RATE_HZ
        del lost[LossReason.SHUTDOWN]
        return lost

    def _see_pair(self, step: ControlStep) -> None:
        pair = step.pair
        self.pairs.append(pair)
        slots = {frame.pulse for frame in pair.frames.values() if isinstance(frame, VirtualFrame)}
        assert len(slots) == 1, f"a pair of the slots {slots}"

    def _see_health(self, _now_ns: int, health: Health) -> None:
        self.said.append(str(health))


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
    run.pairs.clear()
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
    run.rig.control.tune(tuning(1000.0, trigger=SOFTWARE))
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


def test_a_lost_camera_is_triggered_again_when_it_is_back(run: SoftwareRun) -> None:
    run.left.vanish()
    run.let_pass(3.0)
    assert "left camera gone" in run.said[-1]
    run.left.present = True
    run.let_pass(5.0)
    assert run.said[-1] == "exposing"
    lost = run.lost()
    assert lost.keys() <= {LossReason.CAMERA_GONE, LossReason.LEFT_MISSING}
    assert lost[LossReason.CAMERA_GONE] > 2 * RATE_HZ
