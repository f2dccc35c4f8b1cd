"""What a decision rests on, asked of a daemon over a real session of zenoh."""

from __future__ import annotations

from concurrent.futures import Future

import pytest

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Grounds
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.status.document import grounds_from_json, grounds_to_json
from tests.autoexpose_daemon.grounds import GROUNDS
from tests.autoexpose_daemon.publish.steps import endpoint, nothing, wait_until
from tests.autoexpose_daemon.scripted import scripted_daemon

pytestmark = pytest.mark.wire


def test_a_daemon_tells_what_its_decision_rests_on() -> None:
    at = endpoint()
    with (
        StatusClient(connect=[at]) as client,
        scripted_daemon(control={"policy": "belief"}, publish={"listen": [at]}) as (_, _, seen),
    ):
        told: list[Grounds] = []

        def answered() -> bool:
            grounds = client.ask_grounds()
            told.extend([] if grounds is None else [grounds])
            return bool(told)

        wait_until(answered, "an answer")
        grounds = told[0]
        assert list(grounds.scenes) == ["left", "right"]
        decided = [decision.level for _, decision in list(seen) if decision is not None]
        assert min(abs(level - grounds.best_level) for level in decided) < 0.01


def test_however_many_ask_control_is_asked_now_and_then() -> None:
    at, asked = endpoint(), []

    def explain() -> Future[Grounds | None]:
        answer: Future[Grounds | None] = Future()
        answer.set_result(GROUNDS)
        asked.append(answer)
        return answer

    with Publisher(PublishConfig(listen=(at,)), 2, nothing, explain=explain), StatusClient(connect=[at]) as client:
        wait_until(lambda: client.ask_grounds() == GROUNDS, "an answer")
        for _ in range(20):
            assert client.ask_grounds() == GROUNDS
    assert len(asked) < 10


@pytest.mark.parametrize("damaged", [b"", b"null", b"{}", b"[]", b"\xff", b" " * 100_000])
def test_what_is_no_answer_is_none(damaged: bytes) -> None:
    assert grounds_from_json(damaged) is None


def test_an_answer_comes_back_as_it_was() -> None:
    assert grounds_from_json(grounds_to_json(GROUNDS)) == GROUNDS
    assert grounds_from_json(grounds_to_json(None)) is None
