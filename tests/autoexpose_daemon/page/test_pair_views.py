"""Frames from other processes, on the page's own thread, and the history that it keeps."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from autoexpose_daemon.client import ReceivedPair
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.page import app, pair_views
from autoexpose_daemon.page.pair_views import BUCKET_S, LENGTH_S, SERIES, ExposureHistory, PairViews
from imaging.exposure import ExposureSetting
from tests.autoexpose_daemon.publish.steps import DECISION, PATIENCE_S, pair
from tests.autoexpose_daemon.statuses import EXPOSING


def received(*shapes: tuple[int, int]) -> Iterator[ReceivedPair]:
    for number, shape in enumerate(shapes):
        left, right = pair(number, shape).frames.values()
        yield ReceivedPair(left, right, 0, number, number, DECISION, number * 10**9)


def test_frames_too_small_to_show_do_not_end_the_page(caplog: pytest.LogCaptureFixture) -> None:
    shown = asyncio.run(followed(received((1, 1), (1, 1), (540, 720), (67, 90))))
    assert shown == 1
    assert caplog.messages == [
        f"no pictures: frames of {size} pixels are too small: set at least 90x68 (a colour mosaic, seen at half its "
        "size: 180x136)"
        for size in ("1x1", "90x67")
    ]


@pytest.mark.parametrize("shape", [(68, 20_000), (68, 60_000), (20_000, 90)])
def test_nor_do_frames_too_narrow(shape: tuple[int, int], caplog: pytest.LogCaptureFixture) -> None:
    shown = asyncio.run(followed(received(shape, (540, 720))))
    assert shown == 1
    assert caplog.messages == [f"no pictures: frames of {shape[1]}x{shape[0]} pixels are too narrow"]


async def followed(pairs: Iterator[ReceivedPair]) -> int:
    """How many views were made of some pairs."""
    views = PairViews("rig", (), StatusClient(), ExposureHistory())

    class Client:
        def next_pair(self, _timeout_s: float) -> ReceivedPair | None:
            following = next(pairs, None)
            views._closed = following is None
            return following

    with views.watched():
        client: Any = Client()
        views._follow(client)
    number, _ = await views.next_view(0)
    return number


class Following(contextlib.nullcontext[None]):
    """A client that has one pair each time it is opened."""

    def __init__(self, *_: object, **__: object) -> None:
        super().__init__()
        self._pairs = received((540, 720))

    def __enter__(self) -> Any:
        return self

    def next_pair(self, timeout_s: float) -> ReceivedPair | None:
        following = next(self._pairs, None)
        if following is None:
            time.sleep(timeout_s)
            return None
        return replace(following, received_ns=time.monotonic_ns())

    def close(self) -> None:
        """Nothing to do."""


def test_nobody_sees_a_picture_from_before_they_watched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_views, "StereoClient", Following)
    asyncio.run(watched_twice())


async def watched_twice() -> None:
    with PairViews("rig", (), StatusClient(), ExposureHistory()) as views:
        with views.watched() as before:
            number, picture = await asyncio.wait_for(views.next_view(before), PATIENCE_S)
            await until(lambda: views.curve is not None)
        assert (number, bool(picture)) == (1, True)
        await until(lambda: views.curve is None)
        with views.watched() as before:
            number, picture = await asyncio.wait_for(views.next_view(before), PATIENCE_S)
        assert (number, bool(picture)) == (2, True)


def test_nor_does_who_watches_beside_another_or_just_after(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_views, "StereoClient", Following)
    asyncio.run(watched_by_two())


async def watched_by_two() -> None:
    """The one pair of `Following` arrives while only the first watches."""
    with PairViews("rig", (), StatusClient(), ExposureHistory()) as views:
        with views.watched() as first:
            await asyncio.wait_for(views.next_view(first), PATIENCE_S)
            with views.watched() as beside:
                await nothing_to_see(views, beside)
        with views.watched() as after:  # before the thread has noticed that nobody watched
            await nothing_to_see(views, after)


def test_the_prediction_of_a_pair_long_ago_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_views, "StereoClient", Following)
    monkeypatch.setattr(pair_views, "STALE_S", 0.3)
    asyncio.run(watched_on())


async def watched_on() -> None:
    """After the one pair of `Following` the daemon is silent."""
    with PairViews("rig", (), StatusClient(), ExposureHistory()) as views, views.watched():
        await until(lambda: views.curve is not None)
        await until(lambda: views.curve is None)


async def nothing_to_see(views: PairViews, after: int) -> None:
    with pytest.raises(asyncio.TimeoutError):
        await asyncio.wait_for(views.next_view(after), 0.1)


async def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        await asyncio.sleep(0.01)


TIME, GAIN, METRIC, ASKED = 1, 2, 4, 5


def test_no_spike_between_two_points_of_the_drawing_is_lost() -> None:
    history = ExposureHistory()
    for number in range(60):
        time_us = 5000.0 if number == 17 else 100.0
        history.add(BUCKET_S * number / 60, ExposureSetting(time_us, 3.0), DECISION)
    (row,) = history.since(0.0)
    assert len(row) == 1 + len(SERIES)
    assert (row[0], row[TIME], row[GAIN]) == (0.0, (100.0, 5000.0), (3.0, 3.0))
    assert row[ASKED] == (DECISION.setting.exposure_time_us,) * 2


def test_what_was_not_decided_or_is_no_number_leaves_no_mark() -> None:
    history = ExposureHistory()
    history.add(0.0, ExposureSetting(100.0, 3.0), None)
    history.add(0.1, ExposureSetting(100.0, 3.0), replace(DECISION, metric=math.nan))
    (row,) = history.since(0.0)
    assert (row[TIME], row[METRIC]) == ((100.0, 100.0), None)


def test_it_forgets_what_is_older_and_gives_what_is_new() -> None:
    history = ExposureHistory()
    for number in range(10_000):
        history.add(number * BUCKET_S, ExposureSetting(100.0 + number, 0.0), None)
    rows = history.since(0.0)
    assert len(rows) * BUCKET_S == LENGTH_S
    assert history.since(rows[-3][0]) == rows[-3:]


def test_a_point_that_comes_late_does_not_go_back() -> None:
    history = ExposureHistory()
    history.add(10.0, ExposureSetting(100.0, 0.0), None)
    history.add(10.0 - BUCKET_S, ExposureSetting(300.0, 0.0), None)
    assert [row[:2] for row in history.since(0.0)] == [(10.0, (100.0, 300.0))]


AGE_S = 0.9
HEARD_TIME = (1000.0, 1000.0)
"""The range of exposure times in a status, us."""


async def recorded(pair_age_s: float) -> list[tuple[Any, ...]]:
    """Rows made of a status that is `AGE_S` old, when the newest pair is `pair_age_s` old."""
    history = ExposureHistory()
    client: Any = SimpleNamespace(status=EXPOSING, silent_s=AGE_S)
    views: Any = SimpleNamespace(pair_s=time.monotonic() - pair_age_s)
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(app._record_status(client, views, history), 0.1)
    return history.since(-math.inf)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "_STATUS_PERIOD_S", 0.01)


def test_a_status_stands_where_it_was_heard() -> None:
    before_s = time.monotonic()
    (row,) = asyncio.run(recorded(pair_age_s=5.0))
    assert row[1] == HEARD_TIME
    assert before_s - AGE_S - BUCKET_S <= row[0] <= time.monotonic() - AGE_S


def test_a_status_older_than_the_newest_pair_leaves_no_mark() -> None:
    assert asyncio.run(recorded(pair_age_s=0.02)) == []
