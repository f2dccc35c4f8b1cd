"""Requests to control over real sessions of zenoh: by the client and the terminal, by strangers, by nobody allowed."""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from zenoh.handlers import FifoChannel

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.config.request import LARGEST_REQUEST_BYTES, Request
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.publish import inbound as control_module
from autoexpose_daemon.publish.inbound import WAITING_REQUESTS, ControlDoor
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.recording.recorder import ContinuousRecorder
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.status.counters import LARGEST_ANSWER_BYTES, Answer, AnsweredShot, RequestTally
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import line_of
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.exposure import ExposureSetting
from tests.autoexpose_daemon.publish.processes import router
from tests.autoexpose_daemon.publish.steps import endpoint, nothing, wait_until
from tests.autoexpose_daemon.recording.runs import replayed
from tests.autoexpose_daemon.scripted import FRONT_AND_REAR, Seen, scripted_daemon
from tests.autoexpose_daemon.service.service_process import Within

pytestmark = pytest.mark.wire

SHOT = ExposureSetting(150.0, 3.0)


@contextmanager
def exposing(at: str, recorder: ContinuousRecorder | None = None, **sections: Any) -> Iterator[tuple[Daemon, Seen]]:
    """A daemon that has pairs, and takes requests."""
    with scripted_daemon(recorder, publish={"listen": [at]}, **sections) as (daemon, _, seen):
        wait_until(lambda: len(seen) > 20 and daemon.telemetry.publishing and daemon.telemetry.publishing.sent, "pairs")
        yield daemon, seen


def shot_by(control: ControlClient, received: Iterator[ReceivedPair]) -> tuple[AnsweredShot, ReceivedPair, int]:
    """A shot, its pair, and how often it was asked for: a busy machine loses the pair of some, here or there."""
    for times in range(1, 20):
        try:
            taken = control.shot(SHOT.exposure_time_us, SHOT.gain_db)
        except AutoexposeError as error:
            assert str(error).startswith("the shot failed: no frame")
            continue
        pair = next(pair for pair in received if pair.trigger >= taken.trigger)
        if pair.trigger == taken.trigger:
            return taken, pair, times
    raise AssertionError("no shot succeeds")


def test_a_client_changes_control_and_the_recording_of_it_replays(tmp_path: Path) -> None:
    at, file = endpoint(), tmp_path / "run.mcap"
    with (
        ContinuousRecorder(file, 600, PublishConfig()) as recorder,
        exposing(at, recorder) as (daemon, seen),
        ControlClient(connect=[at], name="ana") as control,
        StereoClient(connect=[at]) as frames,
    ):
        received = iter(frames)
        next(received)
        locked = control.lock().requests.locked
        assert locked is not None
        taken, pair, shots = shot_by(control, received)
        assert (pair.left.setting, pair.left.frame_id) == (SHOT, taken.frame_ids["left"])
        assert next(pair for pair in received if pair.decision is not None)
        wait_until(lambda: seen[-1][1] and seen[-1][1].setting == locked, "the lock to go on")
        control.unlock()
        assert control.ev(1.0).requests.ev_stops == 1.0
        assert control.policy("neves2009").policy == "neves2009"
        assert control.limits(max_time_us=3000.0).requests.bounds is not None
        answer = control.region("left", [(0, 0, 90, 90)], 0.1)
        assert str(answer.requests) == "EV +1, policy changed, limits changed, region left changed"
        wait_until(lambda: seen[-1][1] and seen[-1][1].reason.endswith("EV +1"), "a decision by all of that")
        status = describe(daemon.telemetry, daemon.tuning.config)
        assert "requested: EV +1, policy changed" in line_of(status)
        assert status.policy == "neves2009"
        assert str(control.reset().requests) == ""
        count = len(seen)
        wait_until(lambda: len(seen) > count + 5, "more pairs")
    steps = replayed(file)
    assert [request for each in steps for request in each.step.requests] == [
        f"{words}, asked by ana"
        for words in (
            "lock", *["shot 150 us, 3 dB"] * shots, "unlock", "EV +1", "policy neves2009", "limits max_time_us 3000",
            "region left (rectangles: 1)", "reset",
        )
    ]  # fmt: skip
    assert sum(each.step.inputs.override.shot is not None for each in steps) == shots
    assert {each.step.inputs.override.held for each in steps} >= {None, locked}
    unknown = [each for each in steps if each.decision is None]
    # The first of each loop: its snapshot is of the state after it. Changes that come between two pairs share a loop.
    assert 1 <= len(unknown) <= 5
    assert all(each.same for each in steps if each.decision is not None)


def asked(session: zenoh.Session, payload: bytes | None) -> str:
    """What the daemon answers to any bytes."""
    (reply,) = session.get(rig_key("rig", "control"), payload=payload)
    answer = reply.ok or reply.err
    assert answer is not None
    return answer.payload.to_string()


def test_what_is_no_request_is_refused_in_a_sentence_and_changes_nothing() -> None:
    at = endpoint()
    with exposing(at) as (daemon, _), open_session("client", Endpoints(connect=[at])) as session:
        before = daemon.tuning
        assert "no payload: send a request in JSON" in asked(session, None)
        assert asked(session, b"\xff\x1b[2J").startswith("invalid JSON: ")
        assert asked(session, b'{"by": "x", "ev": 1}').startswith("ev: unknown key; known: by, group, reset,")
        assert asked(session, b'{"by": "\\u001b[2J", "locked": true}').startswith("by: '\\x1b[2J' is not a valid name")
        assert asked(session, bytes(LARGEST_REQUEST_BYTES + 1)).startswith("a request of 32769 bytes")
        assert "leaves no pixel" in asked(session, b'{"by":"x","region":{"left":{"rectangles":[{"box":[0,0,1,1]}]}}}')
        assert json.loads(asked(session, b'{"by": "x"}'))["requests"]["taken"] == 0
        assert daemon.tuning is before
        assert str(daemon.telemetry.requests) == ""


@pytest.mark.parametrize("where", ["the daemon's own file", "a router"])
def test_nobody_asks_anything_where_access_control_forbids_it(tmp_path: Path, where: str) -> None:
    """As in docs/do/control-api.md: frames are for all, requests for none."""
    at = endpoint()
    rule = {
        "id": "no control",
        "permission": "deny",
        "flows": ["ingress"],
        "messages": ["query"],
        "key_exprs": ["autoexpose/*/control"],
    }
    access = {
        "enabled": True,
        "default_permission": "allow",
        "rules": [rule],
        "subjects": [{"id": "all"}],
        "policies": [{"rules": ["no control"], "subjects": ["all"]}],
    }
    ends = {"listen": {"endpoints": [at]}, "scouting": {"multicast": {"enabled": False}}, "access_control": access}
    file = tmp_path / "zenoh.json5"
    with contextmanager(_at)(where, file, ends, at) as publish, scripted_daemon(publish=publish) as (daemon, _, seen):
        with StereoClient(connect=[at]) as frames:
            assert frames.next_pair(20.0) is not None
        with ControlClient(connect=[at]) as control, pytest.raises(AutoexposeError, match="may you ask it"):
            control.lock()
        assert (daemon.telemetry.requests.taken, daemon.telemetry.requests.refused) == (0, 0)
        assert seen


def _at(where: str, file: Path, ends: dict[str, object], at: str) -> Iterator[dict[str, object]]:
    if where == "a router":
        file.write_text(json.dumps({"mode": "router", **ends}))
        with router(file):
            yield {"listen": [], "connect": [at]}
    else:
        file.write_text(json.dumps(ends))
        yield {"zenoh": str(file)}


def test_control_that_does_not_respond_is_named_and_what_it_did_not_begin_is_withdrawn(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(control_module, "_PATIENCE_S", 0.1)
    at, waiting = endpoint(), list[Future[Answer]]()

    def ask(_: Request) -> Future[Answer]:
        waiting.append(Future())
        return waiting[-1]

    with (
        Publisher(PublishConfig(listen=(at,)), ("left", "right"), nothing, ask=ask) as publisher,
        ControlClient(connect=[_opened(publisher, at)]) as control,
    ):
        with pytest.raises(AutoexposeError, match="control does not respond: nothing has changed"):
            control.lock()
        (answer,) = waiting
        assert answer.cancelled()


@contextmanager
def door_of_slow_control(
    now_s: Callable[[], float] = time.monotonic,
) -> Iterator[tuple[ControlDoor, list[Future[Answer]], zenoh.Session]]:
    """A door, the answers that control has begun on and does not give by itself, and the session of who asks."""
    at, closed, begun = endpoint(), threading.Event(), list[Future[Answer]]()

    def ask(_: Request) -> Future[Answer]:
        begun.append(Future())
        begun[-1].set_running_or_notify_cancel()
        return begun[-1]

    door = ControlDoor(ask, closed, now_s)
    with (
        open_session("peer", Endpoints(listen=[at])) as daemon,
        open_session("client", Endpoints(connect=[at])) as session,
    ):
        queries = daemon.declare_queryable(rig_key("rig", "control"), FifoChannel(WAITING_REQUESTS))
        serving = threading.Thread(target=door.serve, args=(queries,))
        serving.start()
        yield door, begun, session
        closed.set()
    serving.join()


def test_a_request_that_waited_too_long_for_an_earlier_one_is_not_passed_on() -> None:
    """Its sender may have given up by the time it would take effect."""
    now_s = [100.0]
    with door_of_slow_control(lambda: now_s[0]) as (door, begun, session):
        shot = session.get(rig_key("rig", "control"), payload=b'{"by": "ana"}')
        wait_until(lambda: begun, "the first request")
        late = session.get(rig_key("rig", "control"), payload=b'{"by": "bob", "locked": true}')
        wait_until(lambda: door._waiting.qsize() == 1, "the second request")
        now_s[0] += 6.0
        fresh = session.get(rig_key("rig", "control"), payload=b'{"by": "cid", "locked": false}')
        wait_until(lambda: door._waiting.qsize() == 2, "the third request")
        begun[0].set_result(Answer("fixed", RequestTally()))
        assert shot.recv().ok is not None
        refusal = late.recv().err
        assert refusal is not None
        assert refusal.payload.to_string() == "control was busy with earlier requests: nothing has changed"
        wait_until(lambda: len(begun) == 2, "the third request to be passed on")
        begun[1].set_result(Answer("fixed", RequestTally()))
        assert fresh.recv().ok is not None
    assert len(begun) == 2


def test_a_daemon_that_stops_answers_who_still_waits() -> None:
    at, said = endpoint(), list[str]()
    begun: Future[Answer] = Future()
    asked_for = threading.Event()

    def ask(_: Request) -> Future[Answer]:
        begun.set_running_or_notify_cancel()
        asked_for.set()
        return begun

    def lock() -> None:
        with ControlClient(connect=[at]) as control, pytest.raises(AutoexposeError) as refused:
            control.lock()
        said.append(str(refused.value))

    with Publisher(PublishConfig(listen=(at,)), ("left", "right"), nothing, ask=ask) as publisher:
        _opened(publisher, at)
        asking = threading.Thread(target=lock)
        asking.start()
        assert asked_for.wait(20.0)
    asking.join()
    (why,) = said
    assert why == "the daemon is stopping" or why.startswith("no answer")


def _opened(publisher: Publisher, at: str) -> str:
    wait_until(lambda: publisher._open, "the publisher's session")
    return at


def test_an_answer_of_another_program_is_refused() -> None:
    at = endpoint()
    answers = iter([b"?", b"\xff", bytes(LARGEST_ANSWER_BYTES + 1)])
    with (
        open_session("peer", Endpoints(listen=[at])) as other,
        other.declare_queryable(rig_key("rig", "control"), lambda query: query.reply(query.key_expr, next(answers))),
        ControlClient(connect=[at]) as control,
    ):
        for _ in range(3):
            with pytest.raises(AutoexposeError, match="is not from a daemon of this version"):
                control.show()


def test_all_requests_at_once_are_answered_though_not_all_are_served() -> None:
    at = endpoint()
    with exposing(at), open_session("client", Endpoints(connect=[at])) as session:
        wait_until(lambda: bool(asked(session, b"?")), "an answer")
        replies = [session.get(rig_key("rig", "control"), payload=b'{"by": "ana"}') for _ in range(120)]
        answers = [list(each) for each in replies]
    assert [len(each) for each in answers] == [1] * 120
    served = [reply for (reply,) in answers if reply.ok is not None]
    refused = {reply.err.payload.to_string() for (reply,) in answers if reply.err is not None}
    assert len(served) >= WAITING_REQUESTS
    assert all("busy, 32 requests are waiting" in why for why in refused)


def test_requests_too_large_do_not_wait() -> None:
    """They would fill the memory: a message may have 64 MB."""
    with door_of_slow_control() as (_, begun, session):
        busy = session.get(rig_key("rig", "control"), payload=b'{"by": "ana"}')
        wait_until(lambda: begun, "a request that takes long")
        for _ in range(3):
            assert asked(session, bytes(8 << 20)).startswith("a request of 8388608 bytes")
        begun[0].set_result(Answer("fixed", RequestTally()))
        assert busy.recv().ok is not None


@pytest.mark.parametrize("connect", ["10.0.0.1:7447", ["tcp/127.0.0.1:1", "10.0.0.1:7447"]])
@pytest.mark.parametrize("client", [StereoClient, ControlClient])
def test_what_is_no_endpoint_is_refused_at_once(
    client: type[StereoClient | ControlClient], connect: str | list[str]
) -> None:
    with pytest.raises(ConfigurationError, match="7447 is not an endpoint: write protocol/address"):
        client("rig", connect)


def test_a_name_is_checked_before_anything_is_sent() -> None:
    control = ControlClient(name="\x1b[2J")
    with pytest.raises(ConfigurationError, match="is not a valid name"):
        control.lock()


def test_the_terminal(within: Within) -> None:
    at = endpoint()

    def ctl(*arguments: str) -> str:
        code, text, told = within("ctl", "--connect", at, "--by", "ana", *arguments)
        assert (code, told) == (0, "")
        return text

    def refused(*arguments: str) -> str:
        return within.refused("ctl", "--connect", at, "--by", "ana", *arguments)

    with exposing(at) as (daemon, _):
        assert re.fullmatch(
            rf"policy    {DEFAULT_POLICY}\nexposure  locked at \d+ us, 0.0 dB\nEV        0\n"
            r"bounds    20 to 7500 us, 0 to 30 dB\nchanged   nothing\nlatest    lock, asked by ana\n",
            ctl("lock"),
        )
        assert "EV        -0.5\n" in ctl("ev", "-0.5")
        for shots in range(1, 20):  # noqa: B007  # a busy machine loses the frames of some
            _, text, told = within("ctl", "--connect", at, "--by", "ana", "shot", "--time-us", "500")
            if "the shot failed: no frame" not in told:
                break
        assert re.fullmatch(r"trigger \d+: left frame \d+, right frame \d+, taken with 500 us, 0.0 dB\n", text)
        assert "changed   policy\n" in ctl("policy", "zhang2017")
        limits = ctl("limits", "--max-time-us", "4000")
        assert "bounds    20 to 4000 us, 0 to 30 dB\nchanged   policy, limits\n" in limits
        assert "changed   policy, limits, region right\n" in ctl("region", "right", "--rectangle", "0,0,90,90")
        assert "exposure  decided by the policy\n" in ctl("unlock")
        assert "changed   nothing\n" in ctl("reset")
        assert daemon.telemetry.requests.taken == 7 + shots
        assert "latest    reset, asked by ana\n" in ctl("show")
        for arguments, why in (
            (("ev", "9"), "ev_stops: 9.0 is out of bounds"),
            (("region", "left", "--rectangle", "1,2"), "1,2 is not a rectangle: give X,Y,WIDTH,HEIGHT"),
            (("shot", "--time-us", "9000"), "shot 9000 us, 0 dB is out of bounds"),
        ):
            assert refused(*arguments).startswith(f"autoexpose: {why}")
        assert daemon.telemetry.requests.taken == 7 + shots
    assert f"no answer for rig rig from {at}: is the daemon running" in refused("lock")
    told = within.refused("ctl", "--zenoh", "/nowhere.json5", "lock")
    assert "/nowhere.json5 cannot be read (No such file or directory): name a zenoh configuration file" in told


def test_groups_of_cameras_are_asked_together_or_one_by_one(within: Within) -> None:
    at = endpoint()

    def ctl(*arguments: str) -> list[str]:
        code, text, told = within("ctl", "--connect", at, "--by", "ana", *arguments)
        assert (code, told) == (0, "")
        return text.splitlines()

    def refused(*arguments: str) -> str:
        return within.refused("ctl", "--connect", at, *arguments)

    with exposing(at, cameras=FRONT_AND_REAR) as (daemon, _), ControlClient(connect=[at], group="rear") as rear:
        assert {name: group.requests.locked for name, group in rear.show().groups.items()} == {"rear": None}
        assert set(rear.ask({"group": None, "ev_stops": -1.0}).groups) == {"front", "rear"}
        assert rear.ev(-0.25).requests.ev_stops == -0.25
        assert "EV        -0.5" in ctl("--group", "rear", "ev", "-0.5")
        told = ctl("lock")
        of_front, of_rear = told[: len(told) // 2], told[len(told) // 2 :]
        assert of_front[0] == "group     front" and of_rear[0] == "group     rear"
        assert "EV        -1" in of_front and "EV        -0.5" in of_rear
        assert "latest    lock of group rear, asked by ana" in of_rear
        assert "exposure  decided by the policy" in ctl("--group", "rear", "unlock")
        assert "changed   region rear" in ctl("region", "rear", "--rectangle", "0,0,90,90")
        front, behind = daemon.groups["front"].tally, daemon.groups["rear"].tally
        assert front.requests.locked is not None and behind.requests.locked is None
        assert (front.requests.changed, behind.requests.changed) == ((), ("region rear",))
        assert "there is no group port: give one of front, rear" in refused("--group", "port", "lock")
        assert "region.rear: that camera is not in group front" in refused("--group", "front", "region", "rear")
        assert "the rig has no left camera" in refused("region", "left")
        assert "give group, one of front, rear" in refused("shot", "--time-us", "500")
