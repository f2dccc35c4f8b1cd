"""What is recorded is replayed bit for bit, of former formats as well; another policy decides for itself."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.inputs import LightAhead
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.policies.belief.policy import Belief
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import parse, plain
from autoexpose_daemon.recording import recorder as recorder_module
from autoexpose_daemon.recording.file import LoopState, RecordingError, RecordingFile, Setup, Step, from_json, to_json
from autoexpose_daemon.recording.read import Recording, upgraded_light, upgraded_setup, upgraded_state
from autoexpose_daemon.recording.recorder import ContinuousRecorder, LastSecondsRecorder
from autoexpose_daemon.recording.replay import report_replay
from imaging.frames import CameraName, FrameSet
from imaging.geometry import SIDES
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting
from tests.autoexpose_daemon.recording.runs import (
    LIMITS,
    SHAPE,
    START,
    VirtualRun,
    as_in_fourteenth,
    copy,
    record,
    replayed,
)


@pytest.fixture(autouse=True)
def ten_snapshots_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many in one short run."""
    monkeypatch.setattr(recorder_module, "SNAPSHOT_S", 0.1)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_every_decision_but_the_first_is_replayed_bit_for_bit(tmp_path: Path, policy_id: str) -> None:
    run = VirtualRun(policy_id)
    steps = replayed(record(tmp_path / "run.mcap", run))
    assert [each.step.decision for each in steps] == list(run.decisions.values())
    assert steps[0].decision is None  # the first snapshot is of the state after it
    assert all(each.same for each in steps[1:])


INPUTS: dict[str, tuple[str, dict[str, Any]]] = {
    "belief by an IMU": ("angular_rate_rad_s", {"policy_id": "belief", "imu": True}),
    "begin2022 by an IMU": ("angular_rate_rad_s", {"policy_id": "begin2022", "imu": True}),
    "light of an earlier drive": ("light_ahead", {"policy_id": DEFAULT_POLICY, "driven_before": True}),
    "steered by a consumer": ("steering", {"policy_id": DEFAULT_POLICY, "tracked": True}),
    "not steered by a consumer": ("steering", {"policy_id": "neves2009", "tracked": True}),
}


@pytest.mark.parametrize("name", INPUTS)
def test_decisions_by_inputs_that_come_and_go_are_replayed_bit_for_bit(tmp_path: Path, name: str) -> None:
    field, run = INPUTS[name]
    path = record(tmp_path / "run.mcap", VirtualRun(**run))
    steps = replayed(path)
    for each in steps:
        assert (getattr(each.step.inputs, field) is not None) == (each.step.pair.trigger % 8 < 5)
        if each.step.inputs.angular_rate_rad_s is not None:
            assert each.step.decision.motion_px == each.step.inputs.angular_rate_rad_s * 800 / 60
    assert all(each.same for each in steps[1:])
    if run["policy_id"] != "neves2009":
        assert len([each for each in replayed(path, "neves2009") if each.decision]) == len(steps)


def test_decisions_by_vignetting_are_replayed_bit_for_bit_from_what_the_recording_holds(tmp_path: Path) -> None:
    height, width = SHAPE
    lenses: dict[CameraName, Vignetting] = {
        "left": Vignetting(width, height, (90.0, 60.5), (-0.7, 0.1)),
        "right": Vignetting(width, height, (89.5, 67.5), (), ((0.4, 0.8, 0.5), (0.7, 1.0, 0.6))),
    }
    run, plain = VirtualRun(DEFAULT_POLICY, vignettings=lenses), VirtualRun(DEFAULT_POLICY)
    path = record(tmp_path / "run.mcap", run)
    setups = [item for item in Recording(path) if isinstance(item, Setup)]
    assert setups[0].control.vignettings == lenses
    assert all(each.same for each in replayed(path)[1:])
    record(tmp_path / "plain.mcap", plain)
    assert run.decisions != plain.decisions


@pytest.mark.parametrize("policy_id", [DEFAULT_POLICY, "neves2009", "kim2018"])
def test_what_was_requested_is_replayed_bit_for_bit_and_named(tmp_path: Path, policy_id: str) -> None:
    path = record(tmp_path / "run.mcap", VirtualRun(policy_id, steered=True), 60)
    steps = replayed(path)
    assert {each.step.inputs.override.ev_stops for each in steps} == {0.0, -1.3}
    assert {each.step.inputs.override.unseen for each in steps} == {False, True}
    assert all(each.same for each in steps[1:])
    said: list[str] = []
    assert report_replay(path, None, said.append)
    assert [line for line in said if "made up" in line] == [
        f"trigger {number}: made up in step {number}" for number in range(100, 160, 10)
    ]


def test_a_recorder_drop_is_named_and_the_replay_goes_on_at_the_next_snapshot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk_goes_on, disk_waits = threading.Event(), threading.Event()
    write = RecordingFile.write

    def stall(file: RecordingFile, step: Step, *rest: object) -> None:
        if step.sequence == 30:
            disk_waits.set()
            assert disk_goes_on.wait(30)
        write(file, step, *rest)

    monkeypatch.setattr(RecordingFile, "write", stall)
    run, path = VirtualRun(), tmp_path / "run.mcap"
    with ContinuousRecorder(path, 20, PublishConfig()) as recorder:  # room for 40
        run.feed(recorder, 30)
        assert disk_waits.wait(30)
        run.feed(recorder, 52)
        assert recorder.dropped == 12
        disk_goes_on.set()
        while recorder._queue.qsize() > 5:
            threading.Event().wait(0.001)
        run.feed(recorder, 30)
    assert recorder.dropped == 12
    steps = replayed(path)
    assert len(steps) == 100
    (index,) = (index for index, each in enumerate(steps) if each.dropped)
    assert (index, steps[index].dropped, steps[index].undelivered) == (70, 12, 0)
    assert [each.decision is None for each in steps].count(True) == 2  # the first, and the one after the gap
    assert all(each.same for each in (*steps[1:70], *steps[71:]))

    said: list[str] = []
    assert report_replay(path, None, said.append)
    assert f"the recorder dropped 12 steps before trigger {steps[70].step.pair.trigger}; the replay goes on" in "".join(
        said
    )
    assert "12 dropped by the recorder, 0 triggers" in said[-3]
    assert said[-2] == "replayed: 98, of which 98 are bit for bit as recorded"


def test_drops_at_the_very_end_are_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk_goes_on = threading.Event()
    write = RecordingFile.write

    def stall(file: RecordingFile, *step: object) -> None:
        assert disk_goes_on.wait(30)
        write(file, *step)

    monkeypatch.setattr(RecordingFile, "write", stall)
    with ContinuousRecorder(tmp_path / "run.mcap", 5, PublishConfig()) as recorder:
        VirtualRun().feed(recorder, 20)
        disk_goes_on.set()
    recording = Recording(tmp_path / "run.mcap")
    list(recording)
    assert recording.dropped == recorder.dropped >= 9


def test_pairs_that_never_reached_control_are_told_from_drops(tmp_path: Path) -> None:
    run, path = VirtualRun(), tmp_path / "run.mcap"
    with ContinuousRecorder(path, 100, PublishConfig()) as recorder:
        run.feed(recorder, 20)
        run.trigger += 7
        run.feed(recorder, 20)
    steps = replayed(path)
    assert [(each.dropped, each.undelivered) for each in steps if each.undelivered] == [(0, 7)]
    assert all(each.same for each in steps[1:])


def test_control_that_begins_anew_is_replayed_anew(tmp_path: Path) -> None:
    run, path = VirtualRun(), tmp_path / "run.mcap"
    with ContinuousRecorder(path, 100, PublishConfig()) as recorder:
        run.feed(recorder, 20)
        run.loop = VirtualRun("begin2022").loop
        run.feed(recorder, 20)
    items = list(Recording(path))
    assert [item.control.policy_id for item in items if isinstance(item, Setup)] == ["belief", "begin2022"]
    steps = replayed(path)
    assert [index for index, each in enumerate(steps) if each.decision is None] == [0, 20]
    assert all(each.same for each in steps if each.decision is not None)


def test_another_policy_decides_on_all_the_frames(tmp_path: Path) -> None:
    run = VirtualRun("neves2009")
    path = record(tmp_path / "run.mcap", run)
    steps = replayed(path, "majer2018-full")
    alone = VirtualRun("majer2018-full").loop
    assert [each.decision for each in steps] == [alone.step(each.step.pair) for each in steps]
    said: list[str] = []
    assert report_replay(path, "majer2018-full", said.append)
    assert "majer2018-full on the same frames: " in said[-1]
    assert all(each.same for each in replayed(path, "neves2009")[1:])


def test_a_decision_that_differs_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "run.mcap", VirtualRun("neves2009"), 40)
    monkeypatch.setattr("autoexpose_daemon.control.policies.published.mean.INTEGRAL_GAIN", 0.61)
    monkeypatch.setattr("cv2.__version__", "9.9.9")
    said: list[str] = []
    assert not report_replay(path, None, said.append)
    assert any(line.startswith("first other decision at trigger 10") for line in said)
    assert said[-1].endswith("replayed with opencv 9.9.9") or "replayed with 9.9.9" in said[-1]


def test_the_last_seconds_are_those_before_the_request_however_many_steps_wait(tmp_path: Path) -> None:
    run = VirtualRun("neves2009")
    recorder = LastSecondsRecorder(tmp_path / "run.mcap", rate_hz=30, frames=PublishConfig(), last_s=1.0)
    run.feed(recorder, 20)  # as while the recorder's thread writes another file
    recorder.save()
    with recorder:
        pass
    assert replayed(tmp_path / "run-1.mcap")[-1].step.pair.trigger == run.trigger


def test_the_last_seconds_are_kept_and_begin_with_a_snapshot(tmp_path: Path) -> None:
    run = VirtualRun()
    recorder = LastSecondsRecorder(tmp_path / "run.mcap", rate_hz=30, frames=PublishConfig(), last_s=1.0)

    def unhurried(pair: FrameSet) -> FrameSet:
        """As cameras are: nothing is dropped because the recorder's thread had no turn."""
        while recorder._queue.qsize() > 20:
            threading.Event().wait(0.001)
        return pair

    with recorder:
        run.feed(recorder, 200, unhurried)
        recorder.save()
        while not (tmp_path / "run-1.mcap").exists():
            threading.Event().wait(0.001)
        run.feed(recorder, 10, unhurried)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-1.mcap", "run-2.mcap"]
    for path in tmp_path.iterdir():
        items = list(Recording(path))
        assert [type(item) for item in items[:3]] == [Setup, Step, LoopState]
        steps = replayed(path)
        assert len(steps) <= 1.1 * 30 + 1
        assert all(each.same for each in steps[1:])
    assert replayed(tmp_path / "run-2.mcap")[-1].step.pair.trigger == 309


def test_a_recording_by_a_policy_that_is_no_longer_here_is_shown_and_can_be_replayed_by_another(tmp_path: Path) -> None:
    run, said = VirtualRun("belief"), list[str]()
    run.loop.setup = replace(run.loop.setup, policy_id="fisher-map")
    path = record(tmp_path / "run.mcap", run)
    steps = replayed(path)
    assert len(steps) == 60 and all(each.decision is None for each in steps)
    assert report_replay(path, None, said.append)
    assert "fisher-map" in said[-1] and "no longer here" in said[-1] and "--policy belief" in said[-1]
    assert len([each for each in replayed(path, "belief") if each.decision]) == 60


def begun(policy_id: str, bracket: Bracketing | None = None) -> tuple[ControlLoop, list[FrameSet]]:
    """A loop after eight pairs, and four that follow."""
    pairs = list(itertools.islice(VirtualRun(policy_id).pairs(), 12))
    loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, START, ControlParameters(bracket=bracket))
    for pair in pairs[:8]:
        loop.step(pair)
    return loop, pairs[8:]


def of_fifth(setup: Any, state: Any) -> tuple[Any, Any]:
    """A setup and a state of the present format as the fifth format had them."""
    return {key: value for key, value in setup.items() if key != "vignettings"}, state


def of_fourth(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the fourth format had them."""
    setup, state = of_fifth(setup, state)
    limits = {key: value for key, value in setup["limits"].items() if key != "gains_db"}
    return {**setup, "limits": limits}, state


def of_second(setup: Any, state: Any) -> tuple[Any, Any]:
    """As the second format had them."""
    setup, state = of_fourth(setup, state)
    former_setup = {key: value for key, value in setup.items() if key != "responses"}
    return (
        {**former_setup, "response": setup["responses"]["left"]},
        {"past": state["past"], "motion": state["motions"]["left"], "policy": state["policy"]},
    )


def through_json(data: Any) -> Any:
    return from_json(to_json(data))


@pytest.mark.parametrize("as_it_was", [of_second, of_fourth, of_fifth])
def test_a_loop_goes_on_from_a_former_setup_and_state(as_it_was: Callable[[Any, Any], tuple[Any, Any]]) -> None:
    loop, pairs = begun("begin2022")
    setup, state = (through_json(each) for each in as_it_was(plain(loop.setup), loop.state()))
    again = ControlLoop(parse(upgraded_setup(setup), ControlSetup))
    again.restore(upgraded_state(state, again.setup))
    assert set(again.setup.responses) == set(SIDES)
    assert [again.step(pair) for pair in pairs] == [loop.step(pair) for pair in pairs]


def test_a_loop_of_the_tenth_format_goes_on_with_the_delay_that_it_knew() -> None:
    loop = VirtualRun("belief").loop
    state = through_json(loop.state())
    state["policy"]["latency"] = {"frames": 3, "level": 9.0}
    loop.restore(upgraded_state(state, loop.setup))
    assert isinstance(loop._policy, Belief)
    assert loop._policy.latency.frames == 3


@pytest.mark.parametrize("bracket", [None, Bracketing(2, 2.0, keep=True)])
@pytest.mark.parametrize("motion", ["policy", "dis"])
def test_where_motion_was_measured_by_dis_tiles_begin_anew(motion: str, bracket: Bracketing | None) -> None:
    """What is decided does not depend on it."""
    loop, pairs = begun("neves2009", bracket)
    setup, state = through_json(plain(loop.setup)), through_json(loop.state())
    setup["parameters"]["motion"] = motion
    by_dis = {
        "shape": [136, 180],
        "previous": np.zeros((68, 90), np.uint8),
        "previous_level": 9.0,
        "previous_time_ns": 1,
    }
    state["motions"] = dict.fromkeys(SIDES, by_dis)
    again = ControlLoop(parse(upgraded_setup(setup), ControlSetup))
    again.restore(upgraded_state(state, again.setup))
    assert again.setup.parameters.motion in {"policy", "tiles"}
    for pair in pairs:
        decision, expected = again.step(pair), loop.step(pair)
        assert replace(decision, motion_px=expected.motion_px) == expected


@pytest.mark.parametrize("keep", [False, True])
def test_brackets_without_frames_of_a_policy_do_not_need_it(keep: bool) -> None:
    parameters = ControlParameters(bracket=Bracketing(2, 2.0, keep))
    setup = through_json(plain(ControlLoop("belief", ResponseFunction.linear(), LIMITS, START, parameters).setup))
    found = parse(upgraded_setup({**setup, "policy_id": "fisher-map"}), ControlSetup)
    assert found.policy_id == ("fisher-map" if keep else "belief")


@pytest.mark.parametrize("bracket", [None, Bracketing(2, 2.0, keep=True)])
@pytest.mark.parametrize("policy_id", ["lu2010", "kim2018", "shin2019"])
def test_a_search_of_the_eighth_format_goes_on_with_the_camera_of_its_next_frame(
    policy_id: str, bracket: Bracketing | None
) -> None:
    loop, pairs = begun(policy_id, bracket)
    again = ControlLoop(loop.setup)
    again.restore(upgraded_state(through_json(_of_eighth(loop.state())), loop.setup))
    assert [again.step(pair) for pair in pairs] == [loop.step(pair) for pair in pairs]


def _of_eighth(state: Any) -> Any:
    """The state of a loop or a bracket as the eighth format had it."""
    policy = state["policy"]
    if "policy" in policy:
        return {**state, "policy": _of_eighth(policy)}
    assert "reference" in policy
    return {**state, "policy": {key: policy[key] for key in policy if key != "reference"}}


def test_anything_else_is_left_to_whoever_reads_it() -> None:
    for other in (None, 3, [], {}, {"policy": 1}, {"policy": {"memory": {"sightings": [1, {"views": [2]}]}}}):
        assert upgraded_setup(other) == other
        assert upgraded_state(other, VirtualRun("fixed").loop.setup) == other


def test_light_of_the_ninth_format_changed_as_its_levels_did() -> None:
    light = {"levels": [9, 12.5], "now": 1, "spread_frames": 1.0}
    assert parse(upgraded_light(light), LightAhead) == LightAhead((9.0, 12.5), (-9.0, -12.5), 1, 1.0)
    for other in (None, [], {"levels": 3}, {**light, "risen": [0.0, 1.0]}):
        assert upgraded_light(other) == other


FOURTEENTH = Path(__file__).with_name("format14.mcap")
"""Six steps that a daemon of that format recorded, with everything that control can be given."""


def test_a_recording_of_the_fourteenth_format_is_replayed_though_its_topics_had_other_names() -> None:
    with Reader(FOURTEENTH) as reader:
        assert {topic.split("/")[1] for topic in reader.topics} == {"autoexpose"}
        assert len(reader.topics) == 13
    steps = [item for item in Recording(FOURTEENTH) if isinstance(item, Step)]
    assert [step.sequence for step in steps] == list(range(1, 7))
    assert {frame.pixels.shape for step in steps for frame in step.pair.frames.values()} == {(68, 90)}
    for name in ("angular_rate_rad_s", "light_ahead", "steering"):
        assert any(getattr(step.inputs, name) is not None for step in steps)
    assert steps[0].requests == ("made up in step 100",)
    assert [each.same for each in replayed(FOURTEENTH)] == [False, *[True] * 5]  # a snapshot comes after the first


def test_names_are_all_that_changed_since_the_fourteenth_format(tmp_path: Path) -> None:
    new = record(tmp_path / "new.mcap", VirtualRun(imu=True, steered=True), 12)
    old = copy([new], tmp_path / "old.mcap", as_in_fourteenth)
    assert [each.same for each in replayed(old)] == [each.same for each in replayed(new)] == [False, *[True] * 11]


def test_topics_of_others_in_a_recording_are_left_alone(tmp_path: Path) -> None:
    """As after `ros2 bag record` beside a replay: another camera's image, and text of another's control."""
    new = record(tmp_path / "new.mcap", VirtualRun("fixed"), 3)

    def of_arm(topic: str, data: bytes) -> tuple[str, bytes]:
        if "/control/" in topic:
            return "/arm/control/state", b"\0\1\0\0\1\0\0\0\0"
        return topic.replace("/rig/", "/arm/"), data

    others = copy([new], tmp_path / "others.mcap", of_arm)
    both = copy([new, others], tmp_path / "both.mcap", lambda topic, data: (topic, data))
    assert len(replayed(both)) == 3


def test_recordings_of_two_rigs_in_one_file_are_refused_by_name(tmp_path: Path) -> None:
    new = record(tmp_path / "new.mcap", VirtualRun("fixed"), 3)
    other = copy([new], tmp_path / "other.mcap", lambda topic, data: (topic.replace("/rig/", "/scout/"), data))
    both = copy([new, other], tmp_path / "both.mcap", lambda topic, data: (topic, data))
    with pytest.raises(RecordingError, match="recordings of '/rig' and '/scout': replay them from a file each"):
        replayed(both)
