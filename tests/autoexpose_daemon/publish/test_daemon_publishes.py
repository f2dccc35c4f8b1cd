"""From a daemon's control to a consumer: frames, status, grounds; the cameras do as they are told."""

from __future__ import annotations

import itertools
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zenoh

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.messages.frames import read_exposure_info
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.messages.types import CAMERA_INFO, TYPESTORE
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import Tuning
from autoexpose_daemon.service.service import Service, add_outlets
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status, grounds_from_json, grounds_to_json
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import Telemetry
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, answering, endpoint, nothing, telling, told, wait_until
from tests.autoexpose_daemon.samples import GROUNDS
from tests.autoexpose_daemon.scripted import SHAPE, config, scripted_daemon
from tests.calibration.geometry.written import small_ros
from tests.drivers.rig.test_rig import ScriptedCamera

pytestmark = pytest.mark.wire

CONTROL = {"policy": "neves2009"}
CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})


def test_a_consumer_gets_what_control_saw_and_decided() -> None:
    at = endpoint()
    with (
        scripted_daemon(control=CONTROL, publish={"listen": [at]}) as (_, _, seen),
        StereoClient(connect=[at]) as client,
    ):
        received = [pair for _, pair in zip(range(30), client, strict=False)]
    by_trigger = {pair.trigger: (pair, decision) for pair, decision in seen}
    assert any(pair.decision is not None for pair in received)
    for pair in received:
        original, decision = by_trigger[pair.trigger]
        assert pair.decision == decision
        assert original.frames["right"] is not None
        assert pair.right is not None
        for ours, theirs in ((pair.left, original.frames["left"]), (pair.right, original.frames["right"])):
            assert np.array_equal(ours.pixels, theirs.pixels)
            assert (ours.setting, ours.setting_source) == (theirs.setting, "chunk")
            assert ours.frame_id == theirs.frame_id
    ages_s = [time.time() - pair.stamp_ns * 1e-9 for pair in received[-3:]]
    assert all(0 < age_s < PATIENCE_S for age_s in ages_s)


def test_camera_info_of_both_cameras_follows_their_files_and_reloads(tmp_path: Path) -> None:
    at, (height, width) = endpoint(), SHAPE
    cameras = {}
    for camera, serial in (("left", "L"), ("right", "R")):
        cameras[camera] = {"serial": serial, "calibration": tmp_path / f"{camera}.yaml"}
        (tmp_path / f"{camera}.yaml").write_text(yaml.safe_dump(small_ros(camera, width, height)))
    infos: dict[str, Any] = {}

    def take(sample: zenoh.Sample) -> None:
        camera = str(sample.key_expr).split("/")[2]
        infos[camera] = TYPESTORE.deserialize_cdr(sample.payload.to_bytes(), CAMERA_INFO)

    with scripted_daemon(control=CONTROL, publish={"listen": [at]}, cameras=cameras) as (daemon, _, _):
        wait_until(lambda: daemon.telemetry.publishing and daemon.telemetry.publishing.sent, "frames")
        session = open_session("client", Endpoints(connect=[at]))
        with session, session.declare_subscriber("autoexpose/rig/*/camera_info", take):
            wait_until(lambda: len(infos) == 2, "both cameras' information")
            assert (infos["left"].p[3], infos["right"].p[3]) == (0.0, -0.08 * width)
            assert infos["right"].distortion_model == "plumb_bob"
            daemon.tune(Tuning(config(control=CONTROL))).result(PATIENCE_S)
            wait_until(lambda: not infos["left"].k.any(), "that the left camera is not calibrated")


def test_frames_of_a_camera_that_is_left_alone_keep_their_name() -> None:
    at = endpoint()
    with scripted_daemon(control=CONTROL, publish={"listen": [at]}) as (daemon, rig, _):
        wait_until(lambda: daemon.telemetry.publishing and daemon.telemetry.publishing.sent, "frames")
        session = open_session("client", Endpoints(connect=[at]))
        lone: list[str] = []

        def take(sample: zenoh.Sample) -> None:
            if read_exposure_info(sample.payload.to_bytes()).alone:
                lone.append(str(sample.key_expr))

        with session, session.declare_subscriber("autoexpose/rig/*/exposure", take):
            rig.left.lost = True
            wait_until(lambda: len(lone) > 20, "frames of the right camera alone")
        assert set(lone) == {"autoexpose/rig/right/exposure"}


def test_the_status_is_told_once_a_second_and_at_the_end() -> None:
    at = endpoint()
    with StatusClient("scout", [at]) as client:
        with scripted_daemon(control=CONTROL, publish={"listen": [at], "rig": "scout"}) as (daemon, *_):
            wait_until(lambda: latest(client).state is State.EXPOSING and latest(client).counts.pairs > 0, "pairs")
            status = latest(client)
            assert (status.rig, status.policy, status.ending) == ("scout", "neves2009", False)
            assert {name: camera.camera for name, camera in status.cameras.items()} == daemon.telemetry.cameras.names
            wait_until(lambda: latest(client).command_to_effect_ms.count > 0, "an effect")
            wait_until(lambda: latest(client).rate_hz > 0, "a second pair")
            wait_until(lambda: set(client.responses) == {"left", "right"}, "the responses")
        wait_until(lambda: latest(client).ending, "the last word")
        assert latest(client).counts.pairs == daemon.tally.pairs


def latest(client: StatusClient) -> Status:
    wait_until(lambda: client.status is not None, "a status")
    assert client.status is not None
    return client.status


def test_it_is_told_without_a_single_pair_and_the_next_daemon_is_found() -> None:
    at = endpoint()
    said = describe(Telemetry(), CONFIG)
    with StatusClient(connect=[at]) as client:
        for _ in range(2):
            with telling(at, told(said)):
                assert [client.wait(PATIENCE_S), client.wait(PATIENCE_S)] == [said, said]


def test_all_that_is_told_last_arrives() -> None:
    """Far more than the queue of one consumer holds, and too late for shared memory, which goes with the session."""
    at = endpoint()
    last = {f"autoexpose/rig/{number}": "x" * 10_000 for number in range(600)}
    with open_session("peer", Endpoints(listen=[at])) as session:
        got: set[str] = set()
        session.declare_subscriber("autoexpose/rig/*", lambda sample: got.add(str(sample.key_expr)))

        def tell(is_last: bool) -> dict[str, str]:
            return last if is_last else {"autoexpose/rig/first": "x"}

        with Publisher(PublishConfig(connect=(at,)), ("left", "right"), tell):
            wait_until(lambda: got, "the first")
        wait_until(lambda: got >= set(last), "all")


def test_what_is_no_status_is_passed_over() -> None:
    at = endpoint()
    said = describe(Telemetry(), CONFIG)
    texts = itertools.chain(["", "{}", "no JSON"], itertools.repeat(said.to_json()))
    with telling(at, lambda _last: {rig_key("rig", "status"): next(texts)}), StatusClient(connect=[at]) as client:
        assert client.wait(PATIENCE_S) == said


def test_the_last_status_names_what_ended_the_daemon() -> None:
    at = endpoint()
    config = Config.model_validate(
        {"cameras": {"left": {"serial": "L"}}, "control": {"policy": "fixed"}, "publish": {"listen": [at]}}
    )
    camera = ScriptedCamera((90, 120))

    def die(*_: object) -> None:
        raise ZeroDivisionError("died in an observer")

    service = Service(
        config, lambda config, start: add_outlets(Daemon(config, {"left": lambda: camera}, start, [die]), config)
    )

    def run() -> None:
        with pytest.raises(ZeroDivisionError):
            service.run(threading.Event(), lambda _tell: None)

    thread = threading.Thread(target=run)
    with StatusClient(connect=[at]) as client:
        thread.start()
        assert latest(client).state is State.STARTING
        wait_until(lambda: latest(client).cameras["left"].camera == "scripted S", "the camera")
        camera.expose()
        wait_until(lambda: latest(client).ending, "the last word")
        thread.join()
    assert (latest(client).state, latest(client).reasons) == (State.FAILED, ("died in an observer",))


def test_a_daemon_tells_what_its_decision_rests_on() -> None:
    at = endpoint()
    with (
        StatusClient(connect=[at]) as client,
        scripted_daemon(control={"policy": "belief"}, publish={"listen": [at]}) as (_, _, seen),
    ):
        answers = (client.ask_grounds() for _ in itertools.count())
        both = ["left", "right"]  # the very first decision may rest on one frame alone
        grounds = next(answer for answer in answers if answer is not None and list(answer.scenes) == both)
        decided = [decision.level for _, decision in list(seen) if decision is not None]
        assert min(abs(level - grounds.best_level) for level in decided) < 0.01


def test_however_many_ask_control_is_asked_now_and_then() -> None:
    at, asked = endpoint(), itertools.count()
    explain = answering(lambda: GROUNDS if next(asked) >= 0 else None)
    with telling(at, nothing, explain=explain), StatusClient(connect=[at]) as client:
        wait_until(lambda: client.ask_grounds() == GROUNDS, "an answer")
        for _ in range(20):
            assert client.ask_grounds() == GROUNDS
    assert next(asked) < 10


def test_each_group_is_asked_for_its_own() -> None:
    at, of_rear = endpoint(), replace(GROUNDS, level=9.0)
    explain = {**answering(lambda: GROUNDS, "front"), **answering(lambda: of_rear, "rear")}
    with telling(at, nothing, explain=explain), StatusClient(connect=[at]) as client:
        wait_until(lambda: client.ask_grounds() == GROUNDS, "an answer")
        assert client.ask_grounds("rear") == of_rear
        assert client.ask_grounds("front") == GROUNDS
        for stranger in ("port", "", "*", "a b", "rear&x#?"):
            assert client.ask_grounds(stranger) is None


def test_an_answer_comes_back_as_it_was() -> None:
    assert grounds_from_json(grounds_to_json(GROUNDS)) == GROUNDS
    assert grounds_from_json(grounds_to_json(None)) is None
