"""Steps of control to publish, made up."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future

import numpy as np

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Decision, Grounds
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages.keys import rig_key
from autoexpose_daemon.publish.publisher import Explain, Publisher, Tell
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.telemetry import DropReason
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, FrameSet
from tests.fakes import loopback_address
from tests.meanwhile import meanwhile

PATIENCE_S = 20.0
SETTING = ExposureSetting(1000.0, 6.0)
DECISION = Decision(SETTING, 10.96, "held", 0.1, 0.0, 0.0, 1.0)


def wait_until(condition: Callable[[], object], what: str) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"waited in vain for {what}"
        threading.Event().wait(0.005)


def pair(number: int, shape: tuple[int, int] = (540, 720)) -> FrameSet:
    """The pair of trigger `number`; its pixels all have that number, modulo 256."""
    now_ns = time.monotonic_ns()
    frame = Frame(np.full(shape, number % 256, np.uint8), 8, number, now_ns, now_ns, now_ns, SETTING)
    return FrameSet(number, {"left": frame, "right": frame})


def nothing(_last: bool) -> dict[str, str]:
    return {}


def endpoint() -> str:
    """One of one's own, on this machine."""
    return f"tcp/{loopback_address()}:7448"


def told(status: Status, **texts: str) -> Tell:
    """What a daemon of that status tells, and more."""
    return lambda _last: {rig_key(status.rig, "status"): status.to_json(), **texts}


def telling(
    at: str, tell: Tell, rig: str = "rig", connect: Sequence[str] = (), explain: Explain | None = None
) -> Publisher:
    """A publisher without pairs."""
    return Publisher(
        PublishConfig(rig=rig, listen=(at,), connect=tuple(connect)), ("left", "right"), tell, explain=explain
    )


def answering(told: Callable[[], Grounds | None], *groups: str) -> Explain:
    """Control that says at once on what it decides, for each group."""

    def explain() -> Future[Grounds | None]:
        answer: Future[Grounds | None] = Future()
        answer.set_result(told())
        return answer

    return dict.fromkeys(groups or ("all",), explain)


@contextlib.contextmanager
def publishing(
    config: PublishConfig, period_s: float = 1 / 60, tell: Tell = nothing, explain: Explain | None = None
) -> Iterator[Publisher]:
    """A publisher that gets a pair at each period, as from a running rig, until the block ends."""

    def run(stop: threading.Event) -> None:
        for number in itertools.count(1):
            if stop.wait(period_s):
                return
            publisher(ControlStep(StepInputs(pair(number)), DECISION))

    with Publisher(config, ("left", "right"), tell, explain=explain) as publisher, meanwhile(run):
        yield publisher
    tally = publisher.tally
    assert tally.offered == tally.sent + tally.dropped.total()
    assert set(tally.dropped) <= set(DropReason)
