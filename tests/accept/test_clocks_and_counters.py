"""Counters and clocks that lie, on the wire, in real time through stock Aravis: what arrives is not counted lost.

What the daemon makes of each lie, to the count: tests/autoexpose_daemon/runtime/test_faults.py.
"""

from __future__ import annotations

from collections import Counter

import pytest

from fake_camera.device.faults import Fault
from tests.autoexpose_daemon.stereo import ON_USB, Run, running_daemon, stereo_cameras

pytestmark = pytest.mark.realtime

RATE_HZ = 60.0
FOR_GOOD = 10**6
PAIRS = 240
BUSY_SHARE = 0.1
"""What a busy machine spoils."""

SAYS = {
    Fault.RESTART_COUNTER: "its frame counter went from",
    Fault.SKIP_COUNTER: "its frame counter went from",
    Fault.DOUBLE_COUNTER: "its frame counter went from",
    Fault.ZERO_COUNTER: "its frame counter went from 0 to 0",
    Fault.ZERO_STAMPS: "its time stamps stand still",
    Fault.MICROSECONDS: "its time stamps went on by",
    Fault.WRAP_STAMPS: "32 bits and start again every 4.3 s",
    Fault.NO_TICKS: "as GevTimestampTickFrequency reads 0",
}
ARAVIS_DROPS = {Fault.ZERO_COUNTER, Fault.RESTART_COUNTER}
"""Over GigE Vision frames whose number is at most 100 below that of the last one do not leave Aravis."""


def lost(run: Run) -> Counter[str]:
    counted = Counter({str(reason): count for reason, count in run.daemon.telemetry.lost.items()})
    return counted + Counter(surplus=run.daemon.telemetry.counts.surplus_frames)


def told(run: Run, fault: Fault, log: pytest.LogCaptureFixture) -> None:
    """While a lie is told, what arrives makes pairs, and one line names the lie."""
    run.wait_for_pairs(30)
    if fault is Fault.RESTART_COUNTER:
        run.left.inject(fault, count=1)
    before, began, pairs = lost(run), run.seen[-1][0].reference.host_time_ns, run.daemon.telemetry.counts.pairs
    run.wait_for_pairs(PAIRS)
    spoilt, passed_ns = lost(run) - before, run.seen[-1][0].reference.host_time_ns - began
    pairs = run.daemon.telemetry.counts.pairs - pairs
    did_not_come = round(passed_ns * 1e-9 * RATE_HZ) - pairs  # a busy fake drops frames
    print(f"{fault}: {pairs} pairs, {did_not_come} did not come, lost {dict(spoilt)}")
    assert spoilt.total() <= did_not_come + BUSY_SHARE * PAIRS
    assert log.text.count(SAYS[fault]) == 1
    assert "right camera: its " not in log.text


@pytest.mark.parametrize("fault", SAYS)
@pytest.mark.parametrize("mode", ["external", "free_run"])
def test_a_lie_from_the_start(fault: Fault, mode: str, caplog: pytest.LogCaptureFixture) -> None:
    if (ON_USB and fault is Fault.NO_TICKS) or (not ON_USB and fault in ARAVIS_DROPS):
        pytest.skip("not on this transport")
    with stereo_cameras("--still") as cameras:
        left = {"left": {"serial": cameras[0].serial}}
        settings = {"cameras": left, "trigger": {"mode": "free_run", "rate_hz": RATE_HZ}} if mode == "free_run" else {}
        if fault is not Fault.RESTART_COUNTER:
            cameras[0].inject(fault, count=FOR_GOOD)
        with running_daemon(cameras, settings, latched=False) as run:
            told(run, fault, caplog)


@pytest.mark.gige_only  # a USB3 Vision camera's numbers are nobody's business but ours
def test_frames_that_aravis_drops_for_their_numbers_are_named(caplog: pytest.LogCaptureFixture) -> None:
    with stereo_cameras("--still") as cameras, running_daemon(cameras, latched=False) as run:
        run.wait_for_pairs(30)
        run.left.inject(Fault.ZERO_COUNTER, count=200)
        told = f"camera {run.left.serial}: its frames arrive, but Aravis drops them, since their numbers"
        run.wait_until(lambda: told in caplog.text, told)
        run.wait_for_pairs(20)
    assert f"camera {cameras[1].serial}: its frames arrive" not in caplog.text
