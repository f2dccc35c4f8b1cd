"""The rows of docs/look-up/faults.md, and those that show at the cameras, in virtual time: reports and counts."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml

from autoexpose_daemon.runtime.rig_health import FIRST_PAUSE_NS
from autoexpose_daemon.status.counters import Counts
from calibration.response.file import ResponseFile
from drivers.genicam.timeline import FrameTimeline
from drivers.triggers.account import TriggerAccount
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.response import ResponseFunction
from tests import REPOSITORY
from tests.autoexpose_daemon.virtual import REASONS, VirtualRun
from tests.soak.camera import PIXELS, Device
from tests.soak.clock import MS, SECOND, Clock
from tests.soak.faults import SURELY_JUDGED
from tests.soak.rig import CONFIG, RATE_HZ

FIRST_PAIR = {"pairs_without_decision": 1}
"""Of the first pair after a silence: one frame of it was decided on before its partner came."""


@pytest.fixture
def run() -> VirtualRun:
    return VirtualRun()


def test_camera_lost_and_back(run: VirtualRun) -> None:
    """It starts with the exposure that the other one has by then."""
    run.left.vanish()
    run.wait_for_state("degraded: left camera gone: camera left does not answer any more; trying again")
    alone = len(run.pairs)
    run.let_pass(120)
    assert len(run.pairs) >= alone + 100
    assert {pair.reference_camera for pair in run.pairs[alone:]} == {"right"}
    run.ask(1000)
    run.left.present = True
    counted = run.counted()
    taken = {pair.frames["left"].setting.exposure_time_us for pair in run.pairs[alone:] if len(pair.frames) == 2}
    assert taken == {1000}
    assert counted.pop("camera_gone") > 120
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes"}  # while the dead camera was asked a last time


def test_both_cameras_gone_and_back_is_counted_by_the_clock(run: VirtualRun) -> None:
    for device in (run.left, run.right):
        device.vanish()
    run.let_pass(300)
    for device in (run.left, run.right):
        device.present = True
    counted = run.counted()
    assert counted.pop("camera_gone") > 300
    assert counted == {"reconnects": 2}


def test_a_camera_that_stays_away_is_named_and_the_other_one_continues(run: VirtualRun) -> None:
    run.left.vanish()
    run.wait_for_state("degraded: left camera gone: no camera left; trying again")
    alone = len(run.pairs)
    run.let_pass(60 * RATE_HZ)
    assert len(run.pairs) > alone + 59 * RATE_HZ
    assert run.telemetry.counts.reconnects == 0


def test_a_camera_that_is_not_counted_is_named_until_it_is(run: VirtualRun) -> None:
    loop = run.rig.control.first.active.loop
    loop.uncounted = {"right": "shows nothing, not counted"}  # type: ignore[union-attr, misc, assignment]
    run.wait_for_state("degraded: right camera: shows nothing, not counted")
    loop.uncounted = {}  # type: ignore[union-attr, misc, assignment]
    assert run.counted() == {}


def test_the_status_says_at_which_frequency_the_light_flickers(run: VirtualRun) -> None:
    for flicker_hz in (100.0, None):
        run.rig.control.first.active.loop.flicker_hz = flicker_hz  # type: ignore[union-attr, misc]
        run.let_pass(10)
        assert run.telemetry.first_group.flicker_hz == flicker_hz
    assert run.counted() == {}


def test_trigger_stopped(run: VirtualRun) -> None:
    """Absent triggers do not count."""
    run.wire.stop_periods = 110
    run.wait_for_state("degraded: no triggers")
    assert run.counted() == FIRST_PAIR


def test_a_short_pause_of_the_trigger_looks_like_ignored_triggers(run: VirtualRun) -> None:
    run.wire.stop_periods = 20
    run.let_pass(30)
    assert run.counted() == {"trigger_ignored": 19, **FIRST_PAIR}
    assert run.said == []


def test_trigger_doubled(run: VirtualRun) -> None:
    run.wire.doubled = 70
    for camera in ("left", "right"):
        run.wait_for_state(f"{camera} camera: starts 120.0 frames a second where trigger.rate_hz is 60: check")
    assert run.counted() == {"surplus_frames": 140}


def test_trigger_halved(run: VirtualRun) -> None:
    run.wire.halved = SURELY_JUDGED
    run.wait_for_state("right camera: starts 30.0 frames a second", "exposure and readout fit into one period")
    assert run.counted() == {"trigger_ignored": SURELY_JUDGED}


def test_a_trigger_at_another_rate_is_reported_at_the_start(caplog: pytest.LogCaptureFixture) -> None:
    run = VirtualRun(trigger={**CONFIG.trigger.model_dump(exclude_unset=True), "rate_hz": 50})
    run.let_pass(60)
    assert "left camera: starts 60.0 frames a second where trigger.rate_hz is 50" in caplog.text


def test_frames_lost(run: VirtualRun) -> None:
    run.left.lose, run.right.ignore = 3, 2
    run.let_pass(10)
    run.right.lose = 1
    run.let_pass(10)
    assert run.counted() == {"left_missing": 1, "trigger_ignored": 2, "right_missing": 1}


def test_frames_of_both_lost(run: VirtualRun) -> None:
    run.left.lose = run.right.lose = 3
    run.let_pass(10)
    assert run.counted() == {"both_missing": 3}


def test_frames_late(run: VirtualRun) -> None:
    """They make pairs if their partners have not been used alone."""
    run.left.delay_ns = 100 * MS
    run.let_pass(20)
    assert run.counted().keys() <= {"pairs_without_decision"}


@pytest.mark.parametrize("frames", [40, 400], ids=["for a while", "longer than silence may last"])
def test_frame_truncated(run: VirtualRun, frames: int) -> None:
    """The camera is not reopened."""
    run.left.truncate = frames
    run.wait_for_state("degraded: left camera: all its frames arrive incomplete: check its cable")
    assert run.counted() == {"incomplete": frames}


def test_transfer_stalled(run: VirtualRun) -> None:
    began_ns = run.rig.clock.now_ns
    run.left.halted = True
    run.wait_for_state("degraded: no frames from the left camera")
    run.wait_for_state("left camera gone: camera left sends no frames while another one does")
    assert run.rig.clock.now_ns - began_ns > FIRST_PAUSE_NS
    counted = run.counted()
    assert counted.pop("camera_gone") > FIRST_PAUSE_NS / SECOND * RATE_HZ
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes", *FIRST_PAIR}


def test_chunk_missing(run: VirtualRun) -> None:
    """As over GigE Vision, or with chunks that are not numbers; over USB3 Vision it looks like truncation."""
    run.left.untell = 40
    run.wait_for_state("degraded: left camera: its frames no longer say how they were taken")
    assert run.counted() == {"frames_without_exposure_metadata": 40}


@pytest.mark.parametrize(
    "why", ["could not set ExposureTime to 1000", "node ExposureTime was set to 1000 us and reads back 2000 us"]
)
def test_node_refuses_or_sticks(run: VirtualRun, why: str) -> None:
    run.left.refuses = why
    run.ask(1000)
    run.wait_for_state(f"degraded: left camera: 1000 us, 0.0 dB was refused: camera left: {why}")
    run.left.refuses = ""
    run.wait_for_taken(1000)
    counted = run.counted()
    assert counted.pop("refused_writes") >= 1
    assert counted.keys() <= {"late_writes", "mismatched_pairs"}


def test_node_clips(run: VirtualRun, caplog: pytest.LogCaptureFixture) -> None:
    run.left.clips_us = 3800
    run.ask(4000)
    run.let_pass(60)
    assert "left camera: 4000 us, 0.0 dB was asked for, the camera took 3800 us, 0.0 dB" in caplog.text
    run.ask(2000)
    run.wait_for_taken(2000)
    counted = run.counted()
    assert counted.pop("mismatched_pairs") > 50
    assert counted == {"adjusted_writes": 1}


def test_exposure_frozen(run: VirtualRun) -> None:
    run.left.frozen = True
    run.ask(500)
    run.wait_for_state("left camera: its frames do not follow", "nodes hold 500 us", "taken with 2000 us", "off and on")
    run.left.frozen = False
    run.ask(600)
    run.wait_for_taken(600)
    counted = run.counted()
    assert counted.pop("frames_off_setting") >= 20
    assert counted.pop("unexplained_mismatches") >= 20
    assert counted.keys() == {"mismatched_pairs"}


@pytest.mark.parametrize("jump_s", [10, -10])
def test_clock_jumps(run: VirtualRun, caplog: pytest.LogCaptureFixture, jump_s: int) -> None:
    run.left.clock_offset_ns += jump_s * SECOND
    run.let_pass(90)
    assert f"left camera: its clock jumped by {jump_s:+.1f} s; its frames keep their place" in caplog.text
    assert run.counted() == {"clock_jumps": 1}


def test_response_file_edited_while_running(run: VirtualRun, tmp_path: Path) -> None:
    file = tmp_path / "left.response.yaml"
    ResponseFile(ResponseFunction.linear()).save(file)
    cameras = {"left": {"serial": "left", "response": file}, "right": {"serial": "right"}}
    run.ask(2000, cameras=cameras)
    file.write_text("log2_exposure: [0, 1,")
    with pytest.raises(ConfigurationError, match=f"{re.escape(str(file))}: is not valid YAML"):
        run.ask(2000, cameras=cameras)
    file.unlink()
    with pytest.raises(ConfigurationError, match=f"{re.escape(str(file))}: cannot be read"):
        run.ask(2000, cameras=cameras)
    run.left.vanish()
    run.left.present = True
    run.wait_until(lambda: run.telemetry.counts.reconnects == 1, "the camera back")
    counted = run.counted()
    assert counted.pop("camera_gone") > 0
    assert counted.pop("reconnects") == 1
    assert counted.keys() <= {"late_writes", *FIRST_PAIR}


@pytest.mark.parametrize("forgotten", [False, True], ids=["usb3", "gige"])
def test_a_pause_of_5_s_heals(run: VirtualRun, forgotten: bool) -> None:
    """GigE Vision cameras drop their controller after 3 s; USB3 Vision cameras continue."""
    run.rig.stop_process(5 * SECOND)
    run.let_pass(3 * RATE_HZ)
    for device in (run.left, run.right) if forgotten else ():
        device.vanish()
        device.present = True
    run.let_pass(2 * RATE_HZ)
    run.wait_until(lambda: run.telemetry.counts.reconnects == 2 * forgotten, "the cameras")
    counted = run.counted()
    if forgotten:
        assert counted.pop("camera_gone") > 3 * RATE_HZ
        assert counted.pop("reconnects") == 2
    else:
        assert counted.pop("both_missing") > 4 * RATE_HZ
    assert counted.keys() <= {"both_missing", "late_writes", "stale", "pairs_without_decision"}


def same(value: int) -> int:
    return value


@dataclass(frozen=True)
class Lie:
    """What a camera makes of its numbers and times, and what the log says of that."""

    says: str
    counter: Callable[[int], int] = same
    stamp: Callable[[int], int] = same
    latch: Callable[[int], int] = same

    def device(self, camera: CameraName, clock: Clock, seed: int) -> Device:
        """The left camera tells it from the start; the right one is sound."""
        device = Device(camera, clock, seed)
        if camera == "left":
            self.tell(device)
        return device

    def tell(self, device: Device) -> None:
        device.counter, device.stamp, device.latch = self.counter, self.stamp, self.latch


LIES = {
    "zero_counter": Lie("frame counter went from", counter=lambda number: 0),
    "restart_counter": Lie("frame counter went from 100 to 1", counter=lambda number: (number - 1) % 100 + 1),
    "skip_counter": Lie("frame counter went from", counter=lambda number: number + 3 * (number // 10)),
    "double_counter": Lie("frame counter went from", counter=lambda number: 2 * number),
    "zero_stamps": Lie("its time stamps stand still", stamp=lambda ns: 0),
    "still_stamps": Lie("its time stamps stand still", stamp=lambda ns: 77 * SECOND),
    "microseconds": Lie("its time stamps went on by", stamp=lambda ns: ns // 1000),
    "picoseconds": Lie("its time stamps went on by", stamp=lambda ns: ns * 1000),
    "all_in_microseconds": Lie("its time stamps went on by", stamp=lambda ns: ns // 1000, latch=lambda ns: ns // 1000),
    "no clock at all": Lie("its time stamps stand still", stamp=lambda ns: 0, latch=lambda ns: 0),
    "wrap_stamps": Lie("32 bits and start again every 4.3 s", stamp=lambda ns: ns % 2**32, latch=lambda ns: ns % 2**32),
    "latch that is 0": Lie("its clock, as it is read", latch=lambda ns: 0),
    "latch of another clock": Lie("its clock, as it is read", latch=lambda ns: ns + 10**18),
}


def check_counts(run: VirtualRun) -> None:
    run.let_pass(300)
    counted = run.counted()
    counted.pop("clock_jumps", 0)  # when the lie begins
    assert counted == {}


def check(run: VirtualRun, lie: Lie, caplog: pytest.LogCaptureFixture) -> None:
    """Nothing is lost, nothing is degraded, and one line says why."""
    check_counts(run)
    assert run.said == []
    assert caplog.text.count(lie.says) == 1
    skews_ns = [
        abs(pair.frames["left"].host_time_ns - pair.frames["right"].host_time_ns)
        for pair in run.pairs[-100:]
        if len(pair.frames) == 2
    ]
    assert max(skews_ns) < 3 * MS


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_from_the_start(lie: Lie, caplog: pytest.LogCaptureFixture) -> None:
    check(VirtualRun(lie.device), lie, caplog)
    assert caplog.text.count("left camera: its ") <= 2
    assert "right camera: its " not in caplog.text
    assert "frames a second" not in caplog.text


@pytest.mark.parametrize("name", ["skip_counter", "zero_stamps", "still_stamps", "picoseconds", "wrap_stamps"])
def test_later(name: str, caplog: pytest.LogCaptureFixture) -> None:
    run, lie = VirtualRun(), LIES[name]
    lie.tell(run.left)
    check(run, lie, caplog)


@pytest.mark.parametrize("name", ["zero_counter", "microseconds", "latch that is 0"])
def test_of_both_cameras(name: str) -> None:
    run = VirtualRun()
    for device in (run.left, run.right):
        LIES[name].tell(device)
    check_counts(run)


def test_a_lost_frame_is_still_counted_beside_a_lie() -> None:
    for lie in ("zero_counter", "double_counter", "zero_stamps", "microseconds"):
        run = VirtualRun(LIES[lie].device)
        run.left.lose = 3
        run.let_pass(20)
        run.right.lose = 2
        run.let_pass(20)
        assert run.counted() == {"left_missing": 3, "right_missing": 2}, lie


def test_a_counter_that_starts_again_when_the_camera_is_back_is_no_lie(caplog: pytest.LogCaptureFixture) -> None:
    run = VirtualRun()
    run.left.vanish()
    run.let_pass(60)
    run.left.present = True
    assert run.counted()["reconnects"] == 1
    assert "camera: its " not in caplog.text


@pytest.mark.parametrize("name", ["zero_counter", "restart_counter", "skip_counter", "double_counter", "zero_stamps"])
def test_in_free_run_each_frame_that_arrives_is_one_trigger(name: str) -> None:
    """A single camera, whose triggers are numbered by its frames; one of them is lost."""
    lie, period_ns = LIES[name], SECOND / 60
    timeline = FrameTimeline(period_ns, 0)
    account = TriggerAccount(("left",), period_ns, SECOND, numbered_by="frame_id")
    account.ready("left", SECOND)
    for number in range(1, 301):
        start_ns = round(SECOND + MS + (number - 1) * period_ns)
        if number == 150:
            continue
        placed = timeline.place(lie.counter(number), lie.stamp(start_ns), start_ns + 9 * MS, 2 * MS)
        assert placed.host_time_ns is not None
        setting = ExposureSetting(2000.0, 0.0)
        taken = Frame(PIXELS, 8, placed.frame_id, start_ns, placed.host_time_ns, start_ns + 9 * MS, setting)
        account.frame("left", taken)
    assert account.tally.pairs == 299
    assert dict(account.tally.lost) == {"left_missing": 1}
    assert account.tally.surplus_frames == 0


PAGE = REPOSITORY / "docs/look-up/faults.md"
COLUMNS = ["fault", "what happens", "what the user sees", "counted"]
FAULTS = [
    *("camera lost", "camera back", "replaced by another serial", "camera cannot be driven"),
    *("trigger stopped", "trigger doubled", "trigger halved"),
    *("half the packets lost", "frame truncated", "chunk missing", "hostile packets"),
    *("node refuses a write", "node clips", "node sticks", "exposure frozen", "one camera's clock jumps"),
    *("images all black, all white", "NaN-making inputs"),
    *("response file missing", "response file wrong", "response file edited while running", "configuration garbage"),
    *("disk full while recording", "consumer stuck", "SIGSTOP for 5 s", "SIGKILL"),
]
COUNTS = {str(reason) for reason in REASONS} | {field.name for field in dataclasses.fields(Counts)}


def rows() -> list[dict[str, str]]:
    cells = [
        [cell.strip() for cell in line.strip("|").split(" | ")] for line in PAGE.read_text().splitlines() if "|" in line
    ]
    return [dict(zip(COLUMNS, row, strict=True)) for row in cells if row != COLUMNS and not row[0].startswith("---")]


ROWS = rows()
TESTS = yaml.safe_load((REPOSITORY / "tests/faults.yaml").read_text())


def test_every_fault_has_its_row_and_every_row_its_tests() -> None:
    assert set(FAULTS) <= {row["fault"].partition(":")[0] for row in ROWS}
    assert [re.sub(r"\[(.*?)\]\(.*?\)", r"\1", row["fault"]) for row in ROWS] == list(TESTS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row["fault"]))
def test_a_row_is_complete_and_names_counts_that_exist(row: dict[str, str]) -> None:
    assert all(row.values())
    assert set(re.findall(r"`(\w+)`", row["counted"])) <= COUNTS


@pytest.mark.parametrize("fault", TESTS)
def test_the_tests_of_a_fault_exist(fault: str) -> None:
    assert TESTS[fault]
    for path, _, name in (test.partition("::") for test in TESTS[fault]):
        assert re.search(rf"^def {name}\(", (REPOSITORY / path).read_text(), re.MULTILINE), f"{path}::{name}"
