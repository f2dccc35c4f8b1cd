"""The page as an operator meets it: in a browser, fed by a made-up daemon over real zenoh."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import pytest

from autoexpose_daemon.config import Config
from autoexpose_daemon.config_publish import PublishConfig
from autoexpose_daemon.describe import describe
from autoexpose_daemon.publish.keys import response_key, status_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.publish.tally import ConsumerTally
from autoexpose_daemon.states import State
from autoexpose_daemon.status import (
    CameraStatus,
    Fault,
    PublishStatus,
    RecorderStatus,
    Status,
    response_to_json,
)
from autoexpose_daemon.telemetry import Telemetry
from calibration.response import ResponseFunction
from tests.page.browser import Tab, browser
from tests.page.server import PageProcess, running_page
from tests.publish.steps import DECISION, SETTING, endpoint, publishing, wait_until

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})
HOSTILE = "<img src=x onerror=alert(1)>"
STATE = "document.getElementById('state-word').innerText"


@pytest.fixture(scope="module")
def tab() -> Iterator[Tab]:
    with browser() as tab:
        tab.screen(1280, 900)
        yield tab


@pytest.fixture
def at() -> str:
    return endpoint()


@pytest.fixture
def page(at: str) -> Iterator[PageProcess]:
    with running_page("--connect", at) as page:
        yield page


def made_up() -> Status:
    """A daemon that has seen some trouble."""
    camera = CameraStatus("Model A7", SETTING, 0.4, None)
    return replace(
        describe(Telemetry(), CONFIG),
        state=State.DEGRADED,
        reasons=("left camera gone", "calibration of the right camera does not fit: off by 9 grey levels"),
        cameras={"left": CameraStatus(None, None, None, None), "right": camera},
        rate_hz=59.94,
        pairs=12345,
        lost={"startup": 62, "left_missing": 7},
        late_writes=3,
        clamped_decisions={"brightest": 5},
        decision=replace(DECISION, motion_px=math.nan),
        publishing=PublishStatus(100, 99, {"behind": 1}, "", {"odometry": ConsumerTally(90, 3, 2, 1)}),
        recorder=RecorderStatus(600, 4, "the disk is full"),
        faults=(
            Fault(1_700_000_000.0, "WARNING", "left camera: no frames"),
            Fault(1_700_000_009.0, "WARNING", "left camera: no frames"),
            Fault(1_700_000_010.0, "ERROR", HOSTILE),
        ),
    )


def published(at: str, status: Status) -> Publisher:
    responses = {response_key("rig", side): response_to_json(ResponseFunction.linear()) for side in status.cameras}
    texts = {status_key("rig"): status.to_json(), **responses}
    return Publisher(PublishConfig(listen=(at,)), 2, lambda _last: texts)


def test_it_tells_state_reasons_and_counts_in_words(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    tab.wait_for(f"{STATE} === 'waiting'", "a page without a daemon")
    assert "nothing heard of a daemon of rig rig" in tab.text("reasons")
    with published(at, made_up()):
        tab.wait_for(f"{STATE} === 'degraded'", "the state")
    assert tab.text("reasons").startswith("left camera gone")
    assert "off by 9 grey levels" in tab.text("reasons")
    expected = {
        "headline": ["59.9"],
        "triggers": ["12\u202f345 of 12\u202f414", "lost: left missing\t7", "mismatched pairs\t0"],
        "writes": ["late\t3", "decisions held at the brightest bound\t5"],
        "latency": ["median\t99 %", "command to effect\t–"],
        "cameras": ["left\tgone", "right\tModel A7", "off by 0.4 grey levels"],
        "consumers": ["odometry\t90\t2\t1"],
        "published": ["99 pairs sent; dropped: 1 behind"],
        "recorder": ["steps\t600", "dropped\t4", "ended\tthe disk is full"],
        "faults": ["left camera: no frames 2 times", HOSTILE],
    }
    for place, words in expected.items():
        assert [word for word in words if word not in tab.text(place)] == [], place
    assert tab.value("document.querySelectorAll('img').length") == 0
    tab.wait_for(f"{STATE} === 'silent'", "the silence to be told")
    assert "nothing heard of the daemon for" in tab.text("reasons")
    assert tab.complaints == []


def test_a_daemon_that_leaves_says_so_and_a_new_one_is_found(tab: Tab, page: PageProcess, at: str) -> None:
    running = replace(made_up(), state=State.EXPOSING, reasons=())
    last = replace(running, ending=True)

    def tell(ending: bool) -> dict[str, str]:
        return {status_key("rig"): (last if ending else running).to_json()}

    tab.open(page.url)
    for _ in range(2):
        with publishing(PublishConfig(listen=(at,)), tell=tell):
            tab.wait_for(f"{STATE} === 'exposing'", "the daemon")
            tab.wait_for("!document.querySelector('.stale')", "pictures")
            for side in ("left", "right"):
                assert max(tab.pixels(f"#{side} canvas", 4, 3)) > 0
        tab.wait_for(f"{STATE} === 'ended'", "the end of the daemon")
        tab.wait_for("document.querySelectorAll('.stale').length === 2", "stale pictures")
    assert tab.complaints == []


def test_a_hidden_tab_takes_no_pictures(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    with publishing(PublishConfig(listen=(at,))) as publisher:
        tab.wait_for("document.body.dataset.trigger > 0", "pictures")
        wait_until(lambda: consumers(publisher), "the page among the consumers")
        tab.value(hiding(True))
        wait_until(lambda: not consumers(publisher), "the page to leave")
        shown = tab.value("document.body.dataset.trigger")
        tab.value(hiding(False))
        tab.wait_for(f"document.body.dataset.trigger > {shown}", "pictures again")
    assert tab.complaints == []


def consumers(publisher: Publisher) -> list[str]:
    return [name for name in describe_consumers(publisher) if name.startswith("page-")]


def describe_consumers(publisher: Publisher) -> list[str]:
    telemetry = Telemetry(publishing=publisher.tally)
    said = describe(telemetry, CONFIG).publishing
    return [] if said is None else list(said.consumers)


def hiding(hidden: bool) -> str:
    """What a browser does when the operator looks at another tab."""
    return (
        f"Object.defineProperty(document, 'hidden', {{value: {str(hidden).lower()}, configurable: true}}),"
        "document.dispatchEvent(new Event('visibilitychange'))"
    )


def test_a_page_whose_process_is_gone_says_so_and_comes_back(tab: Tab, at: str) -> None:
    with running_page("--connect", at) as page:
        tab.open(page.url)
        tab.wait_for(f"{STATE} === 'waiting'", "the page")
        assert page.stop() == 0
        tab.wait_for(f"{STATE} === 'no connection'", "the loss of the page")
    with running_page("--connect", at, "--port", str(page.port)):
        tab.wait_for(f"{STATE} === 'waiting'", "the page's return")
    assert all("ERR_CONNECTION_REFUSED" in complaint for complaint in tab.complaints)
    tab.complaints.clear()


def test_the_browser_would_tell_a_broken_page(tab: Tab) -> None:
    tab.open("data:text/html,<script>nothing()</script>")
    assert "nothing is not defined" in "".join(tab.complaints)
    tab.complaints.clear()
