"""The rows of docs/look-up/faults.md that show on the wire, each on its own rig, in real time through stock Aravis.

Each row says what the user reads and what is counted; nothing else may have been counted, but frames that a busy
machine loses, and all is well again at its end. The account is held against the trigger wire. What the daemon makes of
a fault is shown in virtual time as well, to the count: tests/autoexpose_daemon/runtime/test_faults.py.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.demo.fakes import read_pulses
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.status.counters import unusual_counts
from autoexpose_daemon.status.states import Expectation, judge
from calibration.response.file import ResponseFile
from drivers.triggers.outcomes import LossReason
from fake_camera.device.faults import Fault
from imaging.errors import ConfigurationError
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.stereo import ON_USB, START_CAMERA, Run, running_daemon, stereo_cameras
from tests.fakes import FakeCamera

pytestmark = pytest.mark.realtime

RATE_HZ = 60.0
SOON_TRIGGERS = 12
"""Until both cameras have got an order."""
NOISE = 10
BUSY_SHARE = 0.5
"""What a busy machine spoils: some frames, writes or pairs, and fewer of them than go well."""
BUSY = {
    *("pairs_without_decision", "late_writes", "mismatched_pairs"),
    *("left_missing", "right_missing", "both_missing", "incomplete", "stale"),
}


def settings(
    left: FakeCamera, right: FakeCamera, response: Path, exposure_time_us: float, policy: str = "fixed"
) -> dict[str, Any]:
    return {
        "cameras": {"left": {"serial": left.serial, "response": response}, "right": {"serial": right.serial}},
        "control": {"policy": policy, "start": {"exposure_time_us": exposure_time_us}},
    }


def response_file(truths: list[Path]) -> Path:
    return truths[0].with_name("left.response.yaml")


@pytest.fixture
def run() -> Iterator[Run]:
    with stereo_cameras("--still") as (left, right, truths):
        response = response_file(truths)
        ResponseFile(ResponseFunction.linear()).save(response)
        with running_daemon((left, right, truths), settings(left, right, response, 2000)) as running:
            running.wait_for_pairs(30)
            yield running


def ask(run: Run, exposure_time_us: float, policy: str = "fixed") -> None:
    """Have both cameras written."""
    wanted = settings(run.left, run.right, response_file(run.truths), exposure_time_us, policy)
    run.daemon.tune(Tuning(Config.model_validate(wanted))).result(5)


def order(run: Run, fault: Fault, count: int) -> None:
    """Order a fault of the trigger wire of both cameras, from the same pulse on."""
    after = read_pulses(run.truths)[-1].trigger + SOON_TRIGGERS
    for camera in (run.left, run.right):
        camera.inject(fault, after, count)


def state(run: Run) -> str:
    return str(judge(run.daemon.telemetry, Expectation(("left", "right"), 1 / RATE_HZ, True, 0), time.monotonic_ns()))


def wait_for_state(run: Run, *words: str) -> None:
    run.wait_until(lambda: all(word in state(run) for word in words), " ".join(words))


def counts(run: Run) -> Counter[str]:
    telemetry = run.daemon.telemetry
    lost = {str(reason): count for reason, count in telemetry.lost.items()}
    return Counter({counter.name: count for counter, count in unusual_counts(telemetry.counts)} | lost)


@contextlib.contextmanager
def only(run: Run, *counted: str) -> Iterator[Counter[str]]:
    """What is counted meanwhile; nothing but what is named, and all is well at the end."""
    before, new, pairs = counts(run), Counter[str](), run.daemon.telemetry.counts.pairs
    yield new
    wait_for_state(run, "exposing")
    run.wait_for_pairs(20)
    new.update(counts(run) - before)
    busy = NOISE + BUSY_SHARE * (run.daemon.telemetry.counts.pairs - pairs)
    disturbed = {name: n for name, n in new.items() if name not in counted and n > busy * (name in BUSY)}
    assert not disturbed, f"{disturbed} beside {counted}"


def skews(run: Run, since: int) -> float:
    """The largest time between the frames of a pair, in periods."""
    starts_ns = [[frame.host_time_ns for frame in pair.frames.values()] for pair, _ in run.seen[since:]]
    return max(abs(left - right) for left, right in (pair for pair in starts_ns if len(pair) == 2)) * 1e-9 * RATE_HZ


def test_trigger_stopped(run: Run) -> None:
    """That the triggers that were not there are none is for the account at the end to show."""
    with only(run, *BUSY):
        order(run, Fault.STOP_TRIGGERS, 110)
        wait_for_state(run, "degraded: no triggers")


def test_trigger_doubled(run: Run) -> None:
    since = len(run.seen)
    with only(run, "surplus_frames") as new:
        order(run, Fault.DOUBLE_TRIGGERS, 70)
        for camera in ("left", "right"):
            wait_for_state(run, f"{camera} camera: starts 120.0 frames a second where trigger.rate_hz is 60: check")
    assert 100 <= new["surplus_frames"] <= 140
    assert skews(run, since) < 0.1


def test_trigger_halved(run: Run) -> None:
    with only(run, "trigger_ignored") as new:
        order(run, Fault.HALVE_TRIGGERS, 200)
        wait_for_state(run, "right camera: starts 30.0 frames a second", "exposure and readout fit into one period")
    assert new["trigger_ignored"] == pytest.approx(100, abs=NOISE)


@pytest.mark.parametrize(
    ("fault", "reason"), [(Fault.IGNORE_TRIGGERS, "trigger_ignored"), (Fault.FREEZE, "left_missing")]
)
def test_frames_lost(run: Run, fault: Fault, reason: str) -> None:
    with only(run, reason) as new:
        run.left.inject(fault, count=3)
        run.wait_for_pairs(20)
    assert 3 <= new[reason] <= 3 + NOISE


def test_frames_late(run: Run) -> None:
    """They are whole if their partners have not been used alone."""
    with only(run):
        run.left.inject(Fault.DELAY, count=3)
        run.wait_for_pairs(20)


@pytest.mark.gige_only  # USB sends again by itself, below what a camera knows
def test_half_the_packets_lost(run: Run) -> None:
    with only(run, "incomplete", "left_missing") as new:
        run.left.inject(Fault.LOSE_HALF, count=1500)
        run.wait_for_pairs(30)
    assert new["incomplete"] + new["left_missing"] <= 30


@pytest.mark.gige_only  # USB has no addresses
def test_frames_from_another_address(run: Run) -> None:
    with only(run, "left_missing", "refused_packets") as new:
        run.left.inject(Fault.OTHER_ADDRESS, count=6000)  # two seconds of packets
        wait_for_state(run, "degraded: no frames from the left camera", "packets for its stream come from")
    assert 5000 <= new["refused_packets"] <= 6000


NO_METADATA = "frames_without_exposure_metadata"
SPOILT_FRAMES = {
    Fault.TRUNCATE: ("incomplete", "all its frames arrive incomplete: check its cable"),
    Fault.NO_CHUNKS: (  # USB sends whole payloads
        ("incomplete", "all its frames arrive incomplete") if ON_USB
        else (NO_METADATA, "its frames no longer say how they were taken")
    ),
    Fault.NAN_CHUNKS: (NO_METADATA, "its frames no longer say how they were taken"),
}  # fmt: skip
"""What is counted of them, and what is told."""


@pytest.mark.parametrize("fault", SPOILT_FRAMES)
def test_frames_spoilt(run: Run, fault: Fault) -> None:
    counted, told = SPOILT_FRAMES[fault]
    with only(run, counted, "incomplete") as new:
        run.left.inject(fault, count=40)
        wait_for_state(run, f"degraded: left camera: {told}")
    assert new[counted] == pytest.approx(40, abs=NOISE)


@pytest.mark.usb3_only  # of USB endpoints
def test_transfer_stalled(run: Run, caplog: pytest.LogCaptureFixture) -> None:
    """Aravis 0.8.26 never clears the halt, and needs half a processor not to: what a busy rig loses does not matter."""
    with only(run, "camera_gone", "trigger_ignored", "reconnects", *BUSY) as new:
        run.left.inject(Fault.STALL)
        wait_for_state(run, "degraded: no frames from the left camera")
        wait_for_state(run, "degraded: left camera gone")
        told = f"left camera: camera {run.left.serial} sends no frames while another one does; it is reopened"
        run.wait_until(lambda: told in caplog.text, told)
    assert new["reconnects"] == 1


@pytest.mark.parametrize(
    ("fault", "count", "asked_us", "told"),
    [
        (Fault.REFUSE_WRITES, 20, 1000, ("left camera: 1000 us, 0.0 dB was refused", "could not set ExposureTime")),
        (Fault.STICK, 40, 3000, ("node ExposureTime was set to 3000 us and reads back 2000 us",)),
    ],
)
def test_writes_refused(run: Run, fault: Fault, count: int, asked_us: float, told: tuple[str, ...]) -> None:
    with only(run, "refused_writes", "late_writes", "mismatched_pairs") as new:
        run.left.inject(fault, count=count)
        ask(run, asked_us)
        wait_for_state(run, "degraded: ", *told)
        wait_for_taken(run, asked_us)
    assert 1 <= new["refused_writes"] <= count


def test_node_clips(run: Run, caplog: pytest.LogCaptureFixture) -> None:
    with only(run, "adjusted_writes", "mismatched_pairs", "unexplained_mismatches") as new:
        run.left.inject(Fault.SHRINK, count=1)
        ask(run, 4000)
        run.wait_until(
            lambda: "left camera: 4000 us, 0.0 dB was asked for, the camera took 3800 us" in caplog.text, "it"
        )
        ask(run, 2000)
        wait_for_taken(run, 2000)
    assert new["adjusted_writes"] == 1


def test_exposure_frozen(run: Run) -> None:
    with only(run, "frames_off_setting", "mismatched_pairs", "unexplained_mismatches") as new:
        run.left.inject(Fault.FREEZE_EXPOSURE, count=90)
        ask(run, 500)
        wait_for_state(
            run,
            "degraded: left camera: its frames do not follow what is written: its nodes hold 500 us, 0.0 dB, "
            "frames are taken with 2000 us, 0.0 dB",
        )
        wait_for_taken(run, 500)
    assert new["frames_off_setting"] >= 20
    assert new["unexplained_mismatches"] >= 20


def wait_for_taken(run: Run, exposure_time_us: float) -> None:
    """Until both cameras' frames are taken with this exposure time."""

    def taken() -> bool:
        frames = run.seen[-1][0].frames
        return len(frames) == 2 and all(frame.setting.exposure_time_us == exposure_time_us for frame in frames.values())

    run.wait_until(taken, f"frames of {exposure_time_us:g} us")


@pytest.mark.parametrize(("fault", "jump"), [(Fault.CLOCK_AHEAD, r"\+10\.0 s"), (Fault.CLOCK_BACK, r"-\d+\.\d s")])
def test_clock_jumps(run: Run, caplog: pytest.LogCaptureFixture, fault: Fault, jump: str) -> None:
    """Back it goes no further than to 0, which is some seconds for a camera that has just been switched on."""
    since = len(run.seen)
    with only(run, "clock_jumps", "surplus_frames", "trigger_ignored") as new:
        run.left.inject(fault)
        logged = re.compile(f"left camera: its clock jumped by {jump}; its frames keep their place")
        run.wait_until(lambda: logged.search(caplog.text) is not None, jump)
    assert new["clock_jumps"] == 1
    assert new["surplus_frames"] + new["trigger_ignored"] <= 2 * NOISE  # a busy machine has no quick frame
    assert skews(run, since) < 0.5


@pytest.mark.parametrize("fault", [Fault.BLACK, Fault.WHITE])
def test_images_without_anything_in_them(run: Run, fault: Fault) -> None:
    ask(run, 2000, "belief")
    since = len(run.seen)
    with only(run):
        for camera in (run.left, run.right):
            camera.inject(fault, count=30)
        run.wait_for_pairs(40)
    decisions = [decision for _, decision in run.seen[since:]]
    shares = {decision.black_share if fault is Fault.BLACK else decision.saturated_share for decision in decisions}
    assert 1.0 in shares
    assert all(math.isfinite(value) for d in decisions for value in (d.level, d.metric or 0.0, d.motion_px))
    assert np.ptp([decision.level for decision in decisions]) < 20
    ask(run, 2000)


def test_response_file_edited_while_running(run: Run) -> None:
    file = response_file(run.truths)
    whole = file.read_text()
    with only(run, "camera_gone", "trigger_ignored", "reconnects", "refused_writes") as new:
        file.write_text("log2_exposure: [0, 1,")
        with pytest.raises(ConfigurationError, match=f"{file}: is not valid YAML"):
            ask(run, 2000)
        file.unlink()
        with pytest.raises(ConfigurationError, match=f"{file}: cannot be read"):
            ask(run, 2000)
        run.left.inject(Fault.VANISH, count=40)
        wait_for_state(run, "degraded: left camera gone")
    assert new["reconnects"] == 1
    file.write_text(whole)
    ask(run, 2000)


def test_replaced_by_another_serial(run: Run) -> None:
    """The configured camera stays away."""
    run.left.kill()
    reconnects = run.daemon.telemetry.counts.reconnects
    truth = run.truths[0].with_name("other.jsonl")
    with START_CAMERA(line0=run.left.line0, options=["--truth", str(truth)]) as other:
        run.truths.append(truth)
        wait_for_state(
            run, f'degraded: left camera gone: no camera with serial "{run.left.serial}" answers; cameras that do: "'
        )
        wait_for_state(run, other.serial)
        alone = len(run.seen)
        run.wait_until(lambda: len(run.seen) > alone + 30, "the other camera's frames going on")
        assert run.daemon.telemetry.counts.reconnects == reconnects


@pytest.mark.gige_only  # over USB a killed camera's place is not taken by the next
def test_killed_and_back(run: Run) -> None:
    run.left.kill()
    run.wait_until(lambda: len(run.seen[-1][0].frames) < 2, "frames of the other camera alone")
    alone = len(run.seen)
    run.wait_until(lambda: len(run.seen) > alone + 60, "the other camera's frames going on")
    truth = run.truths[0].with_name("again.jsonl")
    with START_CAMERA(run.left.serial, line0=run.left.line0, options=["--truth", str(truth)]):
        run.truths.append(truth)
        run.wait_for_pairs(30)
        assert run.daemon.tally.lost[LossReason.CAMERA_GONE] > 0
        assert run.daemon.telemetry.counts.reconnects == 1
