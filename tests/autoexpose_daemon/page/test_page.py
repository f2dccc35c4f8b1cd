"""The page as an operator meets it: in a browser, fed over real zenoh by a daemon made up or on scripted cameras."""

from __future__ import annotations

import contextlib
import itertools
import math
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.sync.client import connect

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.decision import Decision, Grounds
from autoexpose_daemon.control.step import ControlStep, StepInputs
from autoexpose_daemon.messages.client import ConsumerTally, response_to_json
from autoexpose_daemon.messages.keys import response_key, rig_key
from autoexpose_daemon.page.metrics import CONTENT_TYPE
from autoexpose_daemon.page.pair_views import MOST_VIEWERS
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.status.document import CameraStatus, DurationStatus, Fault, PublishStatus, RecorderStatus, Status
from autoexpose_daemon.status.states import State
from imaging.frames import FrameSet
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.page.browser import SHRUNK, Tab, browser
from tests.autoexpose_daemon.page.server import PageProcess, running_page
from tests.autoexpose_daemon.publish.steps import (
    DECISION,
    answering,
    endpoint,
    nothing,
    pair,
    publishing,
    telling,
    told,
    wait_until,
)
from tests.autoexpose_daemon.samples import EXPOSING, GROUNDS, registered_view
from tests.autoexpose_daemon.scripted import FRONT_AND_REAR, scripted_daemon

pytestmark = [pytest.mark.wire, pytest.mark.needs("chromium")]

HOSTILE = "<img src=x onerror=alert(1)>"
REASONS = "document.getElementById('reasons').innerText"
STATE = "document.getElementById('state-word')?.innerText"


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


TROUBLED = replace(
    EXPOSING,
    state=State.DEGRADED,
    reasons=("left camera gone", "calibration of the right camera does not fit: off by 9 grey levels"),
    cameras=EXPOSING.cameras | {"left": CameraStatus(None, None, None, None)},
    counts=replace(EXPOSING.counts, pairs=12345, mismatched_pairs=0),
    lost={"startup": 62, "left_missing": 7},
    decision=replace(DECISION, motion_px=math.nan),
    command_to_effect_ms=DurationStatus(0, 0.0, None, None),
    publishing=PublishStatus(432_000, 431_990, {"behind": 10}, "", {"slam": ConsumerTally(400_000, 12, 8, 4, 0)}, 1234),
    recorder=RecorderStatus(600, 4, "the disk is full"),
    faults=(*EXPOSING.faults, *EXPOSING.faults, Fault(1.7e9, "ERROR", HOSTILE)),
)
SHOWN = {
    "[data-camera=left]": ["camera gone, no picture yet"],
    "#headline": ["60.0", "2.0 h"],
    ".policy": ["by belief, locked at 1.00", "dB, EV \u22120.50, policy changed"],
    "#triggers": [
        "triggers\t12\u202f414",
        "stereo pairs\t12\u202f345",
        "lost without the left frame\t7",
        "mismatched pairs\t0",
    ],
    "#writes": ["late writes\t5", "refused writes\t6", "adjusted writes\t7", "decisions at the brightest limit\t8"],
    "#latency": ["median\t99 of 100", "decision\t2.00 ms\t8.00 ms", "command to effect\t\u2013"],
    "#cameras": ["left\tgone", "right\tFakeCam R2", "not tested yet"],
    "#consumers": ["slam\t400\u202f000\t8\t4", "1\u202f234 more"],
    "#published": ["431\u202f990 pairs sent; dropped: 10 behind"],
    "#recorder": ["steps\t600", "dropped\t4", "ended\tthe disk is full"],
    "#faults": ["checking that it answers 2 times", HOSTILE],
}
"""What the page has to say of it, by the place."""


def published(at: str, status: Status) -> Publisher:
    response = response_to_json(ResponseFunction.linear())
    return telling(at, told(status, **{response_key("rig", camera): response for camera in status.cameras}))


def test_it_tells_state_reasons_and_counts_in_words(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    tab.wait_for(f"{STATE} === 'waiting'", "a page without a daemon")
    tab.wait_for(f"{REASONS}.includes('{at}')", "the endpoint that does not answer")
    assert "is the daemon running" in tab.text("#reasons")
    with published(at, TROUBLED):
        tab.wait_for(f"{STATE} === 'degraded'", "the state")
        status, metrics, headers = page.get("/metrics")
        assert (status, headers["Content-Type"]) == (200, CONTENT_TYPE)
        assert 'autoexpose_pairs_total{rig="rig"} 12345.0' in metrics
        assert tab.text("#reasons").startswith("left camera gone")
        assert "off by 9 grey levels" in tab.text("#reasons")
        for place, words in SHOWN.items():
            assert [word for word in words if word not in tab.text(place)] == [], place
    assert tab.value("document.querySelectorAll('img').length") == 0
    tab.wait_for(f"{STATE} === 'silent'", "the silence to be reported")
    assert "nothing heard from the daemon for" in tab.text("#reasons")
    assert tab.complaints == []
    wait_until(lambda: 'autoexpose_up{rig="rig"} 0.0' in page.get("/metrics")[1], "silence in the metrics")


def test_a_daemon_that_leaves_says_so_and_a_new_one_is_found(tab: Tab, page: PageProcess, at: str) -> None:
    last = replace(EXPOSING, ending=True)

    def tell(ending: bool) -> dict[str, str]:
        return {rig_key("rig", "status"): (last if ending else EXPOSING).to_json()}

    tab.open(page.url)
    for _ in range(2):
        with publishing(PublishConfig(listen=(at,)), tell=tell):
            tab.wait_for(f"{STATE} === 'exposing'", "the daemon")
            tab.wait_for("!document.querySelector('.stale')", "pictures")
            for camera in ("left", "right"):
                assert max(tab.value(f"{SHRUNK}('[data-camera={camera}] canvas', 4, 3)")) > 0
        tab.wait_for(f"{STATE} === 'ended'", "the end of the daemon")
        tab.wait_for("document.querySelectorAll('figure.stale').length === 2", "stale pictures")
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


def test_a_robot_that_repeats_a_path_is_shown_on_it(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    hidden = "document.getElementById('repetition').hidden"
    with publishing(PublishConfig(listen=(at,))), StereoClient(connect=[at]) as repeating:
        tab.wait_for("document.body.dataset.trigger > 0", "pictures")
        assert tab.value(hidden)

        def shown() -> bool:
            repeating.send_registration(registered_view())
            return repeating.next_pair(0.1) is not None and not tab.value(hidden)

        wait_until(shown, "the card")
        words = "3.5 of 40.0 m, local map 17, shifted +12 px, 30 of 40 matches agree, 0.40 m/s, \u22120.10 rad/s"
        assert tab.text("#repetition-words").endswith(words)
        for canvas in ("path", "vote"):
            assert max(tab.value(f"{SHRUNK}('#{canvas}', 8, 8)")) > 0
        tab.wait_for(hidden, "its end")
    assert tab.complaints == []


def test_a_belief_is_drawn_in_place_of_the_prediction(tab: Tab, page: PageProcess, at: str) -> None:
    rests_on: list[Grounds | None] = [None]
    tab.open(page.url)
    words = "document.querySelector('.curve-words').innerText"
    title = "document.querySelector('.belief-title').hidden"
    with publishing(PublishConfig(listen=(at,)), explain=answering(lambda: rests_on[0])):
        tab.wait_for(f"{words}.includes('with metric')", "the prediction")
        assert tab.value(title)
        rests_on[0] = GROUNDS
        tab.wait_for(f"{words}.includes('12.00') && {words}.includes('8.00')", "what decides")
        assert not tab.value(title)
        assert len(set(tab.value(f"{SHRUNK}('.curve', 40, 40)"))) > 10
    assert tab.complaints == []


def test_a_pair_that_control_skipped_comes_without_the_decision_before(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    numbers = itertools.count(1)
    with Publisher(PublishConfig(listen=(at,)), ("left", "right"), nothing) as publisher:

        def shown(decision: Decision | None, reason: str) -> bool:
            publisher(ControlStep(StepInputs(pair(next(numbers))), decision))
            return tab.text(".reason").startswith(reason)

        wait_until(lambda: shown(DECISION, DECISION.reason), "a decision")
        assert "stops" in tab.text(".values")
        wait_until(lambda: shown(None, "none: control skipped this pair"), "a pair without one")
        assert tab.text(".values") == ""
    assert tab.complaints == []


def consumers(publisher: Publisher) -> list[str]:
    """Pages among them."""
    return [name for name in publisher.tally.consumers.listed(time.monotonic_ns()) if name.startswith("page-")]


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


def test_one_viewer_too_many_is_told_so_and_shown_the_page_later(tab: Tab, page: PageProcess) -> None:
    with contextlib.ExitStack() as viewers:
        for _ in range(MOST_VIEWERS):
            viewers.enter_context(connect(f"ws://{page.host}:{page.port}/live", proxy=None))
        tab.open(page.url)
        tab.wait_for(f"{REASONS} === 'too many browsers watch already; trying again'", "the refusal")
    tab.wait_for(f"{STATE} === 'waiting'", "the page")
    assert tab.complaints == []


def test_a_dead_thread_ends_the_page_and_is_named(at: str) -> None:
    dying = f"""
from autoexpose_daemon.page import pair_views
from autoexpose_daemon.page.serve import serve
pair_views.PairViews._wait_for_viewers = None
serve("rig", ["{at}"], "127.0.0.1", 0, None)
"""
    died = subprocess.run([sys.executable, "-c", dying], capture_output=True, text=True, timeout=60, check=False)
    assert died.returncode == 1
    assert "TypeError: 'NoneType' object is not callable" in died.stderr
    assert "the thread pairs died" in died.stderr


def test_it_stops_at_a_signal_that_comes_before_the_first_request(at: str) -> None:
    early = f"""
import signal, uvicorn
from autoexpose_daemon.page.serve import serve
run = uvicorn.Server.run
def run_late(*server, **options):
    signal.raise_signal(signal.SIGTERM)
    run(*server, **options)
uvicorn.Server.run = run_late
serve("rig", ["{at}"], "127.0.0.1", 0, None)
"""
    stopped = subprocess.run([sys.executable, "-c", early], capture_output=True, text=True, timeout=60, check=False)
    assert (stopped.returncode, "Traceback" in stopped.stderr) == (0, False)


def test_the_browser_would_tell_a_broken_page(tab: Tab) -> None:
    tab.open("data:text/html,<script>nothing()</script>")
    assert "nothing is not defined" in "".join(tab.complaints)
    tab.complaints.clear()


SHAPE = (27, 36)


def test_what_is_shown_is_what_was_published(tab: Tab, page: PageProcess, at: str) -> None:
    with scripted_daemon(control={"policy": "neves2009"}, publish={"listen": [at]}) as (_, _, seen):
        tab.open(page.url)
        tab.wait_for(f"{STATE} === 'exposing' && !document.querySelector('.stale')", "pictures")
        tab.wait_for("document.querySelector('.curve-words').innerText !== ''", "a prediction curve")
        compare(tab, seen)
        assert tab.value("document.querySelector('.curve-words').innerText.includes('does not go by')")
        assert "predicted best" not in tab.text(".curve-words")
        assert tab.value("[...document.querySelectorAll('.lane')].every((lane) => !lane.hidden)")
        for canvas in (".curve", ".lane canvas"):
            assert len(set(tab.value(f"{SHRUNK}('{canvas}', 40, 20)"))) > 5
        assert tab.complaints == []
        assert page.stop() == 0
        assert "Traceback" not in page.log


def test_a_policy_that_predicts_has_its_prediction_and_one_without_a_metric_no_empty_curve(
    tab: Tab, page: PageProcess, at: str
) -> None:
    words = "document.querySelector('.curve-words').innerText"
    unseen = "[...document.querySelectorAll('.lane')].filter(({ hidden }) => hidden).map(({ innerText }) => innerText)"
    with scripted_daemon(control={"policy": "belief"}, publish={"listen": [at]}):
        tab.open(page.url)
        tab.wait_for(f"{words}.includes('the best plan') && {unseen}.length === 1", "its belief")
        assert "metric" not in tab.text(".values")
    with scripted_daemon(control={"policy": "begin2022"}, publish={"listen": [at]}):
        tab.open(page.url)
        tab.wait_for(f"{words}.includes('predicted best') || {words}.includes('no gradient')", "its prediction")
        tab.wait_for(f"{unseen}.length === 0", "its metric")
        assert "does not go by" not in tab.text(".curve-words")


def test_a_range_has_its_unit_once(tab: Tab, page: PageProcess) -> None:
    tab.open(page.url)
    shown = """(async () => {
      const { range, micros } = await import("/static/format.js");
      return [range([2050, 2380], micros), range([900, 2380], micros), range([900, 900], micros)];
    })()"""
    assert tab.value(shown) == ["2.05 to 2.38 ms", "900 µs to 2.38 ms", "900 µs"]


def test_cameras_of_several_groups_are_shown_group_by_group(tab: Tab, page: PageProcess, at: str) -> None:
    tab.open(page.url)
    tab.wait_for(f"{STATE} === 'waiting'", "a page that expects a stereo pair")
    sections: dict[str, Any] = {
        "cameras": FRONT_AND_REAR,
        "control": {"policy": "neves2009"},
        "groups": {"rear": {"policy": "fixed"}},
    }
    with scripted_daemon(publish={"listen": [at]}, **sections) as (_, rig, _):
        tab.wait_for(f"{STATE} === 'exposing' && !document.querySelector('.stale')", "pictures")
        words = "[...document.querySelectorAll('.curve-words')].map(({ innerText }) => innerText)"
        tab.wait_for(f"{words}.every((said) => said.includes('with metric'))", "a prediction for each group")
        tab.wait_for("document.querySelector('[data-group=rear] .reason').innerText === 'fixed'", "a decision")
        cameras = "[...document.querySelectorAll('[data-group={}] figure')].map((each) => each.dataset.camera)"
        assert tab.value(cameras.format("front")) == ["front_left", "front_right"]
        assert tab.value(cameras.format("rear")) == ["rear"]
        assert tab.text("[data-group=front] .decision h2").split() == ["Decision", "for", "front", "by", "neves2009"]
        assert tab.text("[data-group=rear] .curve-title") == "Predicted metric of the rear picture"
        assert "gain 0.0 dB" in tab.text("[data-camera=rear] dl").replace("\n", " ")
        for place in ("[data-camera=rear] canvas", "[data-group=rear] .curve", "#history .lanes:last-child canvas"):
            assert len(set(tab.value(f"{SHRUNK}('{place}', 40, 20)"))) > 5, place
        assert tab.value("document.querySelectorAll('.lane').length") == 8
        assert "group\trear" in tab.text("#cameras")
        assert "whole sets\t" in tab.text("#triggers") and "stereo" not in tab.text("#triggers")
        rig["rear"].lost = True
        stale = "[...document.querySelectorAll('figure.stale')].map((each) => each.dataset.camera).join()"
        tab.wait_for(f"{stale} === 'rear'", "the others going on")
        assert "camera gone, no picture for" in tab.text("[data-camera=rear]")
        assert tab.complaints == []


def compare(tab: Tab, run: Sequence[tuple[FrameSet, Decision | None]]) -> None:
    """A pair on the page, picture and numbers, with that of control; one that was decided on, while there is light."""
    seen: dict[int, Any] = {}
    while (shown := look(tab))["trigger"] not in seen:
        decided = [(pair, decision) for pair, decision in list(run) if decision is not None]
        seen = {pair.trigger: (pair, decision) for pair, decision in decided if pair.reference.pixels.std() > 10}
    pair, decision = seen[shown["trigger"]]
    for words in (decision.reason, f"level {decision.level:.2f} stops"):
        assert words in shown["decision"]
    if decision.metric is not None:  # the policy goes by it
        assert f"metric {decision.metric:.4f}" in shown["decision"]
        assert f"metric {decision.metric:.4f}" in shown["left"]
    for camera, frame in (("left", pair.frames["left"]), ("right", pair.frames["right"])):
        assert f"gain {frame.setting.gain_db:.1f} dB" in shown[camera]
        taken = cv2.resize(frame.pixels, SHAPE[::-1], interpolation=cv2.INTER_AREA).ravel()
        drawn = np.array(shown[f"{camera} pixels"])
        assert np.corrcoef(taken, drawn)[0, 1] > 0.9


def look(tab: Tab) -> dict[str, Any]:
    """What the page shows of one pair, at one moment."""
    height, width = SHAPE
    expression = f"""(() => {{
      const words = (selector) => document.querySelector(selector).innerText.replaceAll("\\n", " ");
      const shown = {{ trigger: Number(document.body.dataset.trigger), decision: words(".decision") }};
      for (const camera of ["left", "right"]) {{
        shown[camera] = words(`[data-camera=${{camera}}] figcaption`);
        shown[`${{camera}} pixels`] = {SHRUNK}(`[data-camera=${{camera}}] canvas`, {width}, {height});
      }}
      return shown;
    }})()"""
    shown: dict[str, Any] = tab.value(expression)
    return shown
