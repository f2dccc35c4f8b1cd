"""Pictures of frames from other processes, on the page's own thread, and the history that it keeps."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.client import ReceivedSet
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.page import app, pair_views
from autoexpose_daemon.page.pair_views import (
    BUCKET_S,
    DELTA_LEVELS,
    DISPLAY_SIZE,
    LENGTH_S,
    SERIES,
    ExposureHistory,
    FramePicture,
    PairViews,
    PictureMaker,
)
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, FrameSet
from imaging.pixels import Layout, Pixels
from imaging.response import ResponseFunction
from tests.autoexpose_daemon.control.scene import expose, radiance
from tests.autoexpose_daemon.publish.steps import DECISION, PATIENCE_S, pair
from tests.autoexpose_daemon.samples import EXPOSING


def received(*shapes: tuple[int, int]) -> Iterator[ReceivedSet]:
    for number, shape in enumerate(shapes):
        yield ReceivedSet(pair(number, shape).frames, 0, number, number, DECISION, number * 10**9)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        ([(1, 1), (1, 1), (67, 90)], ["1x1 pixels are too small", "90x67 pixels are too small"]),
        *([(shape,), [f"{shape[1]}x{shape[0]} pixels are too narrow"]] for shape in ((68, 20_000), (20_000, 90))),
    ],
)
def test_frames_that_cannot_be_shown_do_not_end_the_page(
    shapes: list[tuple[int, int]], words: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    assert asyncio.run(followed(received(*shapes, (540, 720)))) == 1
    assert len(caplog.messages) == len(words)
    assert all(word in message for word, message in zip(words, caplog.messages, strict=True))


async def followed(pairs: Iterator[ReceivedSet]) -> int:
    """How many views were made of some pairs."""
    views = PairViews("rig", (), StatusClient(), ExposureHistory())

    class Client:
        def next_set(self, _timeout_s: float) -> ReceivedSet | None:
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

    def next_set(self, timeout_s: float) -> ReceivedSet | None:
        following = next(self._pairs, None)
        if following is None:
            time.sleep(timeout_s)
            return None
        return replace(following, received_ns=time.monotonic_ns())

    def close(self) -> None:
        """Nothing to do."""


@pytest.fixture
def one_pair_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_views, "RigClient", Following)


@pytest.mark.usefixtures("one_pair_each_time")
def test_nobody_sees_a_picture_from_before_they_watched() -> None:
    async def watch_twice() -> None:
        with PairViews("rig", (), StatusClient(), ExposureHistory()) as views:
            for watched in (1, 2):
                with views.watched() as before:
                    number, picture = await asyncio.wait_for(views.next_view(before), PATIENCE_S)
                    await until(lambda: views.promises)
                assert (number, bool(picture)) == (watched, True)
                await until(lambda: not views.promises)

    asyncio.run(watch_twice())


@pytest.mark.usefixtures("one_pair_each_time")
def test_nor_does_who_watches_beside_another_or_just_after() -> None:
    async def watch() -> None:
        with PairViews("rig", (), StatusClient(), ExposureHistory()) as views:
            with views.watched() as first:
                await asyncio.wait_for(views.next_view(first), PATIENCE_S)
                with views.watched() as beside:
                    await nothing_to_see(views, beside)
            with views.watched() as after:  # before the thread has noticed that nobody watched
                await nothing_to_see(views, after)

    asyncio.run(watch())


@pytest.mark.usefixtures("one_pair_each_time")
def test_the_prediction_of_a_pair_long_ago_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair_views, "STALE_S", 0.3)

    async def watch_on() -> None:
        with PairViews("rig", (), StatusClient(), ExposureHistory()) as views, views.watched():
            await until(lambda: views.promises)
            await until(lambda: not views.promises)

    asyncio.run(watch_on())


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
        history.add(BUCKET_S * number / 60, "all", ExposureSetting(time_us, 3.0), DECISION)
    (row,) = history.since(0.0)["all"]
    assert len(row) == 1 + len(SERIES)
    assert (row[0], row[TIME], row[GAIN]) == (0.0, (100.0, 5000.0), (3.0, 3.0))
    assert row[ASKED] == (DECISION.setting.exposure_time_us,) * 2


def test_what_was_not_decided_or_is_no_number_leaves_no_mark() -> None:
    history = ExposureHistory()
    history.add(0.0, "all", ExposureSetting(100.0, 3.0), None)
    history.add(0.1, "all", ExposureSetting(100.0, 3.0), replace(DECISION, metric=math.nan))
    (row,) = history.since(0.0)["all"]
    assert (row[TIME], row[METRIC]) == ((100.0, 100.0), None)


def test_it_forgets_what_is_older_and_gives_what_is_new() -> None:
    history = ExposureHistory()
    for number in range(10_000):
        history.add(number * BUCKET_S, "all", ExposureSetting(100.0 + number, 0.0), None)
    rows = history.since(0.0)["all"]
    assert len(rows) * BUCKET_S == LENGTH_S
    assert history.since(rows[-3][0]) == {"all": rows[-3:]}


def test_a_point_that_comes_late_does_not_go_back() -> None:
    history = ExposureHistory()
    history.add(10.0, "all", ExposureSetting(100.0, 0.0), None)
    history.add(10.0 - BUCKET_S, "all", ExposureSetting(300.0, 0.0), None)
    assert [row[:2] for row in history.since(0.0)["all"]] == [(10.0, (100.0, 300.0))]


AGE_S = 0.9


def test_a_status_stands_where_it_was_heard_unless_a_pair_is_newer() -> None:
    before_s = time.monotonic()
    (row,) = asyncio.run(recorded(pair_age_s=5.0))
    assert row[TIME] == (1000.0, 1000.0)
    assert before_s - AGE_S - BUCKET_S <= row[0] <= time.monotonic() - AGE_S
    assert asyncio.run(recorded(pair_age_s=0.02)) == []


"""The range of exposure times in a status, us."""


async def recorded(pair_age_s: float) -> list[tuple[Any, ...]]:
    """Rows made of a status that is `AGE_S` old, when the newest pair is `pair_age_s` old."""
    history = ExposureHistory()
    client: Any = SimpleNamespace(status=EXPOSING, silent_s=AGE_S)
    views: Any = SimpleNamespace(pair_s=time.monotonic() - pair_age_s)
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(app._record_status(client, views, history), 0.1)
    return history.since(-math.inf).get("all", [])


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "_STATUS_PERIOD_S", 0.01)


LINEAR = ResponseFunction.linear()
SETTING = ExposureSetting(1000.0, 0.0)


def frame_of(pixels: Pixels, layout: Layout = "grey", bit_depth: int = 8) -> Frame:
    return Frame(pixels, bit_depth, 0, 0, 0, 0, SETTING, layout=layout)


def colours(picture: FramePicture) -> NDArray[np.int16]:
    """Blue, green, red of every pixel, as a browser decodes them."""
    decoded = cv2.imdecode(np.frombuffer(picture.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert decoded is not None
    return decoded.astype(np.int16)


def test_saturated_is_red_and_black_is_blue_and_the_rest_is_as_it_was() -> None:
    grey = np.full((540, 720), 120, np.uint8)
    grey[:, :180] = 255
    grey[:, 540:] = 1
    picture = PictureMaker(LINEAR).picture(frame_of(grey))
    blue, _, red = cv2.split(colours(picture))
    assert (red - blue)[:, :170].min() > 100
    assert (blue - red)[:, 550:].min() > 100
    assert np.abs(colours(picture)[:, 190:530] - 120).max() < 8
    assert (picture.saturated_share, picture.black_share) == (0.25, 0.25)
    assert abs(float(np.mean(red - blue > 100)) - 0.25) < 0.01


def test_it_measures_what_control_measures() -> None:
    frame = expose(radiance(spread_stops=3.0, shape=(540, 720)), SETTING, half_scale_level=10.0)
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0)
    decision = ControlLoop("fixed", LINEAR, limits, SETTING).step(FrameSet(0, {"left": frame, "right": frame}))
    picture = PictureMaker(LINEAR).picture(frame)
    shares = picture.saturated_share, picture.black_share
    assert picture.metric > 0
    assert (picture.metric, *shares) == (decision.metric, decision.saturated_share, decision.black_share)


def test_the_curve_is_the_metric_of_pictures_predicted() -> None:
    maker = PictureMaker(LINEAR)
    dark = np.full((270, 360), 20, np.uint8)
    dark[::8] = 40
    curve = maker.curve(frame_of(dark))
    assert curve[list(DELTA_LEVELS).index(0.0)] == maker.picture(frame_of(dark)).metric
    brighter = GradientMetric().measure(cv2.medianBlur(np.minimum(dark.astype(int) * 4, 255).astype(np.uint8), 3))
    assert abs(curve[-1] - brighter) < 0.01
    assert curve == sorted(curve)


def test_large_frames_come_smaller() -> None:
    picture = PictureMaker(LINEAR).picture(frame_of(np.full((1080, 1440), 100, np.uint8)))
    assert colours(picture).shape[1] == DISPLAY_SIZE[0]


@pytest.mark.parametrize("layout", ["RGGB", "BGGR", "RGB", "BGR", "YUYV"])
def test_colours_are_shown(layout: Layout) -> None:
    """All of it orange."""
    orange = {"R": 200, "G": 120, "B": 40}
    deep = 4 if layout == "RGGB" else 0
    if layout == "YUYV":
        pixels = np.empty((270, 360, 2), np.uint8)
        pixels[..., 0], pixels[:, ::2, 1], pixels[:, 1::2, 1] = 135, 74, 174  # BT.601, full range
    elif len(layout) == 3:
        pixels = np.full((270, 360, 3), [orange[colour] for colour in layout], np.uint8)
    else:
        pixels = np.tile(np.array([orange[colour] for colour in layout], np.uint16).reshape(2, 2) << deep, (135, 180))
    frame = frame_of(pixels.astype(np.uint16 if deep else np.uint8), layout, 8 + deep)
    picture = PictureMaker(LINEAR).picture(frame)
    shown = [orange["G"]] * 3 if len(layout) == 4 and layout != "YUYV" else [orange[colour] for colour in "BGR"]
    assert np.abs(colours(picture) - shown).max() <= 4  # a mosaic is balanced: its mean is grey
    assert picture.width == (180 if deep or layout == "BGGR" else 360)
