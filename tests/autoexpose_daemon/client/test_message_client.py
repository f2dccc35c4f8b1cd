"""The daemon's messages as bytes, for programs that bring their own types."""

from __future__ import annotations

import queue
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from functools import partial

import pytest

from autoexpose_daemon.client import MessageClient
from autoexpose_daemon.config.document import ImuConfig, PublishConfig
from autoexpose_daemon.config.request import Request
from autoexpose_daemon.messages.frames import read_image
from autoexpose_daemon.publish.inbound import ImuSubscriber
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.runtime.inputs import AngularRate
from autoexpose_daemon.status.counters import Answer, Counts, RequestTally
from imaging.errors import AutoexposeError, ConfigurationError
from tests import REPOSITORY
from tests.autoexpose_daemon.publish.steps import PATIENCE_S, endpoint, nothing, publishing, wait_until
from tests.fuzz.of_host import imu_seeds

pytestmark = pytest.mark.wire


def test_it_needs_zenoh_and_nothing_else() -> None:
    """ROS 2's Python has an old numpy, and neither rosbags nor pydantic."""
    code = (
        "import sys; before = {*sys.modules}; from autoexpose_daemon.client import MessageClient; import zenoh\n"
        "print(*sorted({name.split('.')[0] for name in {*sys.modules} - before} - sys.stdlib_module_names))"
    )
    imported = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, text=True, capture_output=True, check=True)
    ours = {"autoexpose_daemon", "documents", "drivers", "imaging"}
    assert {*imported.stdout.split()} - ours == {"zenoh"}


def test_messages_arrive_as_they_were_sent_until_they_are_not_wanted() -> None:
    at, images = endpoint(), queue.Queue[bytes]()
    with publishing(PublishConfig(listen=(at,))), MessageClient("rig", [at]) as client:
        client.subscribe("left/image", images.put)
        _, image = read_image(images.get(timeout=PATIENCE_S))
        assert image.pixels.shape == (540, 720)
        client.unsubscribe("left/image")
        exposures: queue.Queue[bytes] = queue.Queue()
        client.subscribe("left/exposure", exposures.put)
        for _ in range(3):
            assert len(exposures.get(timeout=PATIENCE_S)) < 1000
        images.queue.clear()
        for _ in range(10):
            exposures.get(timeout=PATIENCE_S)
        assert images.empty()


@pytest.fixture
def asked() -> Iterator[tuple[MessageClient, list[Request]]]:
    """A client, and the requests that arrived; those for another policy are refused."""
    requests: list[Request] = []

    def ask(request: Request) -> Future[Answer]:
        requests.append(request)
        answer: Future[Answer] = Future()
        if request.policy is not None:
            answer.set_exception(ConfigurationError("not that one"))
        else:
            answer.set_result(Answer("belief", RequestTally(ev_stops=request.ev_stops or 0.0)))
        return answer

    at = endpoint()
    troubles: queue.Queue[str] = queue.Queue()
    config = PublishConfig(listen=(at,))
    with Publisher(config, ("left",), nothing, ask=ask), MessageClient("rig", [at], on_trouble=troubles.put) as client:
        while troubles.get(timeout=PATIENCE_S):
            pass
        yield client, requests


def test_control_answers_or_refuses(asked: tuple[MessageClient, list[Request]]) -> None:
    client, requests = asked
    assert client.ask({"by": "ROS", "ev_stops": -1.0})["requests"]["ev_stops"] == -1.0
    assert requests[0].by == "ROS"
    with pytest.raises(AutoexposeError, match="not that one"):
        client.ask({"by": "ROS", "policy": "neves2009"})
    with pytest.raises(AutoexposeError, match="ev_stops"):
        client.ask({"by": "ROS", "ev_stops": 9})


def test_bytes_reach_whoever_listens() -> None:
    at, heard = endpoint(), queue.Queue[bytes]()
    with Publisher(PublishConfig(listen=(at,)), ("left",), nothing), MessageClient("rig", [at]) as listener:
        listener.subscribe("imu", heard.put)
        with MessageClient("rig", [at]) as sender:

            def arrives() -> bool:
                sender.send("imu", b"turning")
                return not heard.empty()

            wait_until(arrives, "bytes")
    assert heard.get() == b"turning"


def test_an_imu_reaches_a_daemon_that_listens_at_its_own_endpoint() -> None:
    at = endpoint()
    config = ImuConfig(key="autoexpose/rig/imu", connect=(at,))
    rate, sample = AngularRate(config, Counts()), next(imu_seeds())
    with (
        Publisher(PublishConfig(listen=(at,)), ("left",), nothing),
        ImuSubscriber(config, rate),
        MessageClient("rig", [at]) as node,
    ):

        def arrives() -> bool:
            node.send("imu", sample)
            return rate.tally.samples > 0

        wait_until(arrives, "a sample")


def test_it_asks_in_vain_where_no_daemon_is() -> None:
    with MessageClient("rig", [endpoint()]) as client, pytest.raises(AutoexposeError, match="is the daemon running"):
        client.ask({"by": "ROS"})


def test_names_and_endpoints_are_checked() -> None:
    for wrong in (partial(MessageClient, "no rig"), partial(MessageClient, "rig", ["7448"])):
        with pytest.raises(ConfigurationError):
            wrong()
