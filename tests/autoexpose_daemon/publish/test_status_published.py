"""What other processes are told of a daemon, over zenoh; the cameras do as they are told."""

from __future__ import annotations

import itertools
import threading

import pytest

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.config.document import Config, PublishConfig
from autoexpose_daemon.messages.keys import status_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.service.service import Service, add_outlets
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.states import State
from autoexpose_daemon.status.telemetry import Telemetry
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, wait_until
from tests.autoexpose_daemon.scripted import scripted_daemon
from tests.drivers.rig.test_rig import ScriptedCamera

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})

pytestmark = pytest.mark.wire


def test_the_status_is_told_once_a_second_and_at_the_end() -> None:
    at = endpoint()
    with StatusClient("scout", [at]) as client:
        with scripted_daemon(control={"policy": "neves2009"}, publish={"listen": [at], "rig": "scout"}) as (daemon, *_):
            wait_until(lambda: latest(client).state is State.EXPOSING and latest(client).counts.pairs > 0, "pairs")
            status = latest(client)
            assert (status.rig, status.policy, status.ending) == ("scout", "neves2009", False)
            assert {side: camera.camera for side, camera in status.cameras.items()} == daemon.telemetry.cameras.names
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
            with Publisher(PublishConfig(listen=(at,)), 2, lambda _last: {status_key("rig"): said.to_json()}):
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

        with Publisher(PublishConfig(connect=(at,)), 2, tell):
            wait_until(lambda: got, "the first")
        wait_until(lambda: got >= set(last), "all")


def test_what_is_no_status_is_passed_over() -> None:
    at = endpoint()
    said = describe(Telemetry(), CONFIG)
    texts = itertools.chain(["", "{}", "no JSON"], itertools.repeat(said.to_json()))
    with (
        Publisher(PublishConfig(listen=(at,)), 2, lambda _last: {status_key("rig"): next(texts)}),
        StatusClient(connect=[at]) as client,
    ):
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
