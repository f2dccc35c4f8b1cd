"""Pictures and curves of the newest pairs, made only while someone watches, and the last minutes in numbers."""

from __future__ import annotations

import asyncio
import logging
import math
import os
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic_core import to_json

from autoexpose_daemon.client import ReceivedSet, RigClient
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.control.decision import Decision, Grounds
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables
from autoexpose_daemon.control.picture.image import ImagePreparation, Shrinking, fit
from autoexpose_daemon.control.policies.ids import PREDICTING
from autoexpose_daemon.messages.inputs import RegisteredView
from autoexpose_daemon.messages.keys import ONE_GROUP
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame
from imaging.python310 import Self
from imaging.response import ResponseFunction, prediction_tables

DISPLAY_SIZE = (720, 720)
"""Largest width and height of a picture sent to a browser."""

DELTA_LEVELS = np.linspace(-2.0, 2.0, 17)
"""Changes of level (stops) at which the metric is predicted: the range of algorithm 1."""

_LONGEST_STRIP = 100
"""Length to width of a frame: nothing of the width of a much longer one is left at the size that control uses."""

_SATURATED_BGR, _BLACK_BGR = (45, 35, 240), (255, 110, 20)
_MOST_BALANCE = 4.0
_JPEG = (
    cv2.IMWRITE_JPEG_QUALITY, 80,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,  # else marks bleed into their neighbours
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FramePicture:
    """A frame for a browser, and what control would measure on the whole of it."""

    # saturated pixels are red, black ones blue: the pixels that the shares count, in the image that control uses
    jpeg: bytes
    width: int  # of what control and navigation see of the frame; they see a colour mosaic at half its size
    metric: float  # M_g, 0..1 per pixel (eq. 5)
    # shares (0..1) of its pixels, as in a decision
    saturated_share: float
    black_share: float


class PictureMaker:
    """Measures whole frames of one camera with the paper's metric, using the camera's response."""

    def __init__(self, response: ResponseFunction) -> None:
        self.response = response
        self._preparation = ImagePreparation()
        self._metric = GradientMetric()
        self._shares = ExtremeShares(response)
        self._tables = PackedTables(prediction_tables(response, DELTA_LEVELS.tolist()))

    def picture(self, frame: Frame) -> FramePicture:
        """The picture of a frame, in its colours; ConfigurationError if it is too small for control, or too narrow."""
        grey = frame.grey8(self.response.saturation)
        image = self._prepared(grey)
        saturated, black = self._shares.measure(image)
        jpeg = self._marked(in_colours(frame), image)
        return FramePicture(jpeg, grey.shape[1], self._metric.measure(image), saturated, black)

    def curve(self, frame: Frame) -> list[float]:
        """M_g at each of `DELTA_LEVELS`, as the response predicts it (eq. 20); at 0 it is the frame's own."""
        image = self._prepared(frame.grey8(self.response.saturation))
        return [float(m) for m in self._metric.measure_predictions(image, self._tables)]

    def _prepared(self, grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
        height, width = grey.shape
        if max(height, width) > _LONGEST_STRIP * min(height, width):
            raise ConfigurationError(f"frames of {width}x{height} pixels are too narrow")
        return self._preparation.prepare(grey)

    def _marked(self, colours: NDArray[np.uint8], image: NDArray[np.uint8]) -> bytes:
        """`colours` (BGR) as JPEG, marked where the shares count pixels of its prepared `image`."""
        size = fit(colours.shape[:2], DISPLAY_SIZE)
        small = Shrinking(colours.shape, size).shrink(colours).copy()
        large = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
        small[large >= self._shares.saturated_from] = _SATURATED_BGR
        small[large <= self._shares.black_to] = _BLACK_BGR
        _, jpeg = cv2.imencode(".jpg", small, _JPEG)
        return jpeg.tobytes()


def in_colours(frame: Frame) -> NDArray[np.uint8]:
    """A frame's colours as its camera sent them: BGR, shape (height, width, 3), uint8.

    A mosaic, which sensors send without white balance, is balanced so that its mean is grey.
    """
    pixels: Any = frame.pixels if frame.bit_depth == 8 else (frame.pixels >> frame.bit_depth - 8).astype(np.uint8)
    match frame.layout:
        case "grey":
            colours = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)
        case "RGB":
            colours = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
        case "BGR":
            colours = pixels
        case "YUYV":  # OpenCV's own YUYV is not full range
            u, v = (np.repeat(pixels[:, place::2, 1], 2, axis=1) for place in (0, 1))
            colours = cv2.cvtColor(np.dstack([pixels[..., 0], v, u]), cv2.COLOR_YCrCb2BGR)
        case mosaic:
            colours = _balanced(cv2.cvtColor(pixels, getattr(cv2, f"COLOR_Bayer{mosaic}2BGR")))
    return np.asarray(colours, np.uint8)


def _balanced(colours: Any) -> Any:
    blue, green, red, _ = cv2.mean(colours)
    gains = [min(green / max(mean, 1.0), _MOST_BALANCE) for mean in (blue, green, red)]
    tables = [np.clip(gain * np.arange(256), 0, 255).astype(np.uint8) for gain in gains]
    return cv2.LUT(colours, cv2.merge([table.reshape(256, 1) for table in tables]))


log = logging.getLogger(__name__)

BUCKET_S = 0.5
"""Finer than a pixel of the chart; each bucket keeps its least and greatest value, so no spike is lost."""

LENGTH_S = 300.0

SERIES = (
    "exposure_time_us", "gain_db", "level", "metric", "asked_time_us", "asked_gain_db", "asked_level",
)  # fmt: skip
"""The columns of a row: what a group's frames were taken with and measured, and what was requested."""

Range = tuple[float, float] | None
"""The least and the greatest value; None without any."""


class _Bucket:
    """Half a second, by group."""

    def __init__(self, start_s: float) -> None:
        self.start_s = start_s
        self.ranges: dict[str, list[Range]] = {}

    def add(self, group: str, values: Sequence[float | None]) -> None:
        """Widen the ranges of a group by one value of each series."""
        ranges = self.ranges.setdefault(group, [None] * len(SERIES))
        for column, value in enumerate(values):
            if value is not None and math.isfinite(value):
                low, high = ranges[column] or (value, value)
                ranges[column] = min(low, value), max(high, value)


class ExposureHistory:
    """Rows of the last five minutes for each group of cameras, oldest first. Any thread may add or read."""

    def __init__(self) -> None:
        self._rows: deque[_Bucket] = deque(maxlen=round(LENGTH_S / BUCKET_S))
        self._lock = threading.Lock()

    def add(self, now_s: float, group: str, applied: ExposureSetting, decision: Decision | None) -> None:
        """Add the setting of a group's frames and the decision on them; `now_s` is from CLOCK_MONOTONIC."""
        taken = (*astuple(applied), applied.level)
        asked = (None,) * 4
        if decision is not None:
            asked = (decision.metric, *astuple(decision.setting), decision.setting.level)
        start_s = math.floor(now_s / BUCKET_S) * BUCKET_S
        with self._lock:
            if not self._rows or self._rows[-1].start_s < start_s:
                self._rows.append(_Bucket(start_s))
            self._rows[-1].add(group, (*taken, *asked))

    def since(self, time_s: float) -> dict[str, list[tuple[Any, ...]]]:
        """Rows of each group from `time_s` on: time (s), then the range of each of `SERIES`. The newest may change."""
        found: dict[str, list[tuple[Any, ...]]] = {}
        with self._lock:
            for row in self._rows:
                if row.start_s >= time_s:
                    for group, ranges in row.ranges.items():
                        found.setdefault(group, []).append((row.start_s, *ranges))
        return found


def pair_message(
    pair: ReceivedSet,
    pictures: Mapping[CameraName, FramePicture],
    firsts: Mapping[str, CameraName],  # the first camera of each group
    registered: RegisteredView | None = None,
) -> bytes:
    """Length of the text (4 bytes, little-endian), the text in JSON, then the JPEGs in its order."""
    decisions = {group: pair.decisions.get(camera) for group, camera in firsts.items()}
    text = {
        "trigger": pair.trigger,
        "pictures": [_described(camera, pair.frames[camera], picture) for camera, picture in pictures.items()],
        "decisions": {group: decision and _decided(decision) for group, decision in decisions.items()},
        "registered": None if registered is None else _registered(registered),
    }
    head = to_json(text, inf_nan_mode="null")
    return b"".join([struct.pack("<I", len(head)), head, *(picture.jpeg for picture in pictures.values())])


def _described(camera: CameraName, frame: Frame, picture: FramePicture) -> dict[str, Any]:
    about = {"camera": camera, "jpeg_bytes": len(picture.jpeg), "frame_width": picture.width, **asdict(frame.setting)}
    return about | _fields(picture, "metric", "saturated_share", "black_share")


def _decided(decision: Decision) -> dict[str, Any]:
    names = ("reason", "level", "metric", "saturated_share", "black_share", "motion_px")
    return asdict(decision.setting) | _fields(decision, *names)


def _registered(view: RegisteredView) -> dict[str, Any]:
    names = ("camera", "distance_m", "length_m", "local_map", "shift_px", "forward_m_s", "turn_rad_s", "stopped")
    matches = [values.tolist() for values in (view.x_px, view.y_px, view.shifts_px, view.agreed)]
    return {**_fields(view, *names), "matches": matches}


def _fields(source: object, *names: str) -> dict[str, Any]:
    return {name: getattr(source, name) for name in names}


MOST_VIEWERS = 32
PICTURE_PERIOD_NS = 250_000_000
CURVE_PERIOD_NS = 1_000_000_000
STALE_S = 2.0
"""Without a pair for this long, what is known of the newest one is old, as in `page.js`."""

_PATIENCE_S = 0.25
_JOIN_S = 3.0
_LINEAR = ResponseFunction.linear()
"""Used until the daemon has sent its responses, which it does once a second."""


@dataclass(frozen=True, slots=True)
class Curve:
    """The M_g of the newest image of a group's first camera as predicted at other exposures; all levels are in stops.

    `level` is the image's own, `decided_level` what the daemon decided on for it; None if it skipped the pair.
    `decides`: whether the policy goes by such a prediction; to others, it is only a comparison.
    """

    delta_levels: tuple[float, ...]
    metrics: tuple[float, ...]
    level: float
    decided_level: float | None
    decides: bool


@dataclass(frozen=True, slots=True)
class Promise:
    """What a group's newest decision rests on: a belief, or for policies that have none the curve of a prediction."""

    grounds: Grounds | None = None
    curve: Curve | None = None


class PairViews:
    """The newest pair, or set of a rig with another number of cameras, as a message to browsers.

    A thread consumes pairs, only while there are viewers: the frames of the cameras that are there. Created and watched
    on an event loop, whose coroutines it wakes.

    `promises` are by group; there are none before the first pair, once nobody watches, and once pairs no longer come.
    `pair_s` is when the newest pair arrived, from CLOCK_MONOTONIC; 0 before the first.
    """

    def __init__(self, rig: str, connect: Sequence[str] | None, status: StatusClient, history: ExposureHistory) -> None:
        self.promises: dict[str, Promise] = {}
        self.pair_s = 0.0
        self.rig = rig
        self._connect = connect
        self._status = status
        self._history = history
        self._makers: dict[CameraName, PictureMaker] = {}
        self._loop = asyncio.get_running_loop()
        self._rung = asyncio.Event()
        self._newest = (0, b"")
        self._last_error = ""
        self._watched = threading.Condition()
        self._watching = 0
        self._closed = False
        self._client: RigClient | None = None
        self._thread = threading.Thread(target=self._run, name="pairs", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._watched:
            self._closed = True
            self._watched.notify_all()
        if self._client is not None:
            self._client.close()
        self._thread.join(_JOIN_S)

    @property
    def crowded(self) -> bool:
        """Whether there are too many viewers for another one."""
        return self._watching >= MOST_VIEWERS

    @contextmanager
    def watched(self) -> Iterator[int]:
        """Count as a viewer while this context is entered; its value is the number of the newest pair before that."""
        with self._watched:
            self._watching += 1
            self._watched.notify_all()
        try:
            yield self._newest[0]
        finally:
            with self._watched:
                self._watching -= 1

    async def next_view(self, after: int) -> tuple[int, bytes]:
        """The newest pair as a message, with its number, as soon as that exceeds `after`."""
        while (newest := self._newest)[0] <= after:
            await self._rung.wait()
        return newest

    def _run(self) -> None:
        while self._wait_for_viewers():
            cameras, name = self._present(), f"page-{os.getpid()}"
            with RigClient(self.rig, self._connect, name=name, cameras=cameras) as self._client:
                self._follow(self._client, cameras)
            if not self._watching:
                self.promises = {}  # old by the time that someone watches again

    def _present(self) -> Sequence[CameraName] | None:
        """The cameras that are open while others are gone; None: all."""
        status = self._status.status
        present = () if status is None else [name for name, each in status.cameras.items() if each.camera is not None]
        return present if status is not None and 0 < len(present) < len(status.cameras) else None

    def _wait_for_viewers(self) -> bool:
        with self._watched:
            self._watched.wait_for(lambda: self._watching or self._closed)
            return not self._closed

    def _follow(self, client: RigClient, cameras: Sequence[CameraName] | None = None) -> None:
        """Show the sets of a client for these cameras, while somebody watches and they are those that are open."""
        picture_ns = curve_ns = 0
        while self._watching and not self._closed and self._present() == cameras:
            pair = client.next_set(_PATIENCE_S)
            if pair is None:
                if time.monotonic() - self.pair_s > STALE_S:
                    self.promises = {}  # old for who begins to watch now
                continue
            self.pair_s = pair.received_ns * 1e-9
            firsts = self._firsts(pair)
            for group, camera in firsts.items():
                self._history.add(self.pair_s, group, pair.frames[camera].setting, pair.decisions.get(camera))
            try:
                if pair.received_ns >= picture_ns:
                    picture_ns = pair.received_ns + PICTURE_PERIOD_NS
                    self._show(pair, firsts)
                if pair.received_ns >= curve_ns:
                    curve_ns = pair.received_ns + CURVE_PERIOD_NS
                    self.promises = {group: self._promise(pair, group, camera) for group, camera in firsts.items()}
            except ConfigurationError as error:  # the frames are too small or narrow
                if str(error) != self._last_error:
                    self._last_error = str(error)
                    log.warning("no pictures: %s", error)

    def _firsts(self, pair: ReceivedSet) -> dict[str, CameraName]:
        """The first camera of each group in a pair; of one group, until the daemon has told its status."""
        status = self._status.status
        groups = {} if status is None else {name: group.cameras for name, group in status.by_group.items()}
        known = {name: [camera for camera in cameras if camera in pair.frames] for name, cameras in groups.items()}
        firsts = {name: cameras[0] for name, cameras in known.items() if cameras}
        return firsts or {ONE_GROUP: next(iter(pair.frames))}

    def _maker(self, camera: CameraName) -> PictureMaker:
        response = self._status.responses.get(camera, _LINEAR)
        known = self._makers.get(camera)
        if known is None or not _same(known.response, response):
            known = self._makers[camera] = PictureMaker(response)
        return known

    def _promise(self, pair: ReceivedSet, group: str, camera: CameraName) -> Promise:
        grounds = self._status.ask_grounds(group)
        if grounds is not None:
            return Promise(grounds=grounds)
        frame, decision = pair.frames[camera], pair.decisions.get(camera)
        metrics = self._maker(camera).curve(frame)
        decided = None if decision is None else decision.level
        known = None if self._status.status is None else self._status.status.by_group.get(group)
        decides = known is not None and known.policy in PREDICTING
        return Promise(curve=Curve(tuple(DELTA_LEVELS), tuple(metrics), frame.setting.level, decided, decides))

    def _show(self, pair: ReceivedSet, firsts: Mapping[str, CameraName]) -> None:
        pictures = {camera: self._maker(camera).picture(frame) for camera, frame in pair.frames.items()}
        self._newest = self._newest[0] + 1, pair_message(pair, pictures, firsts, self._status.registered)
        self._loop.call_soon_threadsafe(self._ring)

    def _ring(self) -> None:
        self._rung.set()
        self._rung = asyncio.Event()


def _same(one: ResponseFunction, other: ResponseFunction) -> bool:
    """Whether they are the same curve; the daemon sends it once a second."""
    levels = (one.black_level, one.saturation) == (other.black_level, other.saturation)
    return levels and np.array_equal(one.log2_exposure, other.log2_exposure)
