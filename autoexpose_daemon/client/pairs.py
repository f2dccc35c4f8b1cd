"""From single messages to complete pairs, and a count of those that never became complete. No transport here."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.frames import (
    ReceivedImage,
    decision_of,
    frame_of,
    read_exposure_info,
    read_image,
    stamp_ns,
)
from imaging.errors import ConfigurationError
from imaging.frames import SIDES, Frame, Side, StereoPair
from imaging.normalised import Bits, normalised
from imaging.pixels import Pixels
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

_KEPT_STAMPS = 64
"""Triggers whose messages wait for the rest, about a second: the images of each camera queue separately."""

_KEPT_BYTES = 256 << 20
"""For images that wait: far more than a second of 720 x 540 takes, and enough for three pairs of the largest images."""

_LONGEST_GAP = 1_000_000
"""Four hours at 60 Hz: a larger jump means that a new count has begun."""

_COMPARED = 5
"""Every fifth row and column tells whether images are alike; being odd, it meets every colour of a mosaic."""


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedPair:
    """What both cameras took at one trigger, and what the daemon made of it."""

    # the frames, each with its own exposure time and gain; `right` is None in a rig with one camera. Their host and
    # arrival times are from the daemon's machine; the pixels are read-only
    left: Frame
    right: Frame | None
    stamp_ns: int  # the middle of the left frame's exposure, CLOCK_REALTIME, unless `publish.stamp` says otherwise
    trigger: int  # the daemon's number for the trigger
    sequence: int  # number of the pair among those that the daemon sent
    decision: Decision | None  # what the daemon decided on this pair
    received_ns: int  # when the pair became complete in this process, CLOCK_MONOTONIC
    # the response function of each camera, if the client was opened with `normalised`
    responses: Mapping[Side, ResponseFunction] = field(default_factory=dict)
    # the vignetting of each camera for which it was measured, along with the responses
    vignettings: Mapping[Side, Vignetting] = field(default_factory=dict)

    @property
    def stereo(self) -> StereoPair:
        """The pair as control and drivers know it."""
        frames: dict[Side, Frame] = {"left": self.left}
        if self.right is not None:
            frames["right"] = self.right
        return StereoPair(self.trigger, frames)

    @property
    def level(self) -> float:
        """Exposure level of the brighter exposed frame, stops."""
        return max(frame.setting.level for frame in self.stereo.frames.values())

    def normalised(
        self, reference: float | None = None, bits: Bits = 8, *, dither: bool = False, flat: bool = False
    ) -> NormalisedPair:
        """The frames as if taken with the exposure level `reference` (stops); None: that of the brighter exposed one.

        Scales, marks and `dither` are those of `imaging.normalised.normalised`. With `flat` vignetting is
        divided out: the light is as it is at the brightest place of the lens.

        Raises ConfigurationError if the responses are not known, or with `flat` the vignetting.
        """
        reference = self.level if reference is None else reference
        images: dict[Side, Pixels] = {}
        for side, frame in self.stereo.frames.items():
            if side not in self.responses:
                raise ConfigurationError(
                    f"the response of the {side} camera is not known: open StereoClient with normalised=True"
                )
            light = self._relative_light(side, frame) if flat else None
            images[side] = normalised(frame, self.responses[side], reference, bits, dither=dither, relative_light=light)
        return NormalisedPair(images["left"], images.get("right"), reference)

    def _relative_light(self, side: Side, frame: Frame) -> NDArray[np.float32]:
        if side not in self.vignettings:
            raise ConfigurationError(
                f"the vignetting of the {side} camera is not known: name its file as cameras.{side}.vignetting in the "
                "daemon's configuration"
            )
        height, width = frame.pixels.shape[:2]
        self.vignettings[side].check_size((width, height), f"the {side} camera")
        return _full_light(self.vignettings[side])


@lru_cache(maxsize=4)
def _full_light(vignetting: Vignetting) -> NDArray[np.float32]:
    return vignetting.relative_light(vignetting.height, vignetting.width)


@dataclass(frozen=True, slots=True, eq=False)
class NormalisedPair:
    """The images of a pair at the exposure level `reference` (stops); `right` is None in a rig with one camera."""

    left: Pixels
    right: Pixels | None
    reference: float


def alike(*pairs: ReceivedPair, bits: Bits = 8, dither: bool = False, flat: bool = False) -> list[NormalisedPair]:
    """Pairs of one rig in one photometric scale: each as if taken with the brightest of their exposures.

    At that level all are saturated alike: what is saturated in the brightest frame is not shown by any other either.
    If the left images differ less as they were taken, the exposure has followed the light: then each pair keeps its own
    exposure, and `reference` differs. `flat` is that of `ReceivedPair.normalised`.

    Raises ConfigurationError if the responses are not known, or with `flat` the vignetting.
    """
    brightest = max(pair.level for pair in pairs)
    brought = [pair.normalised(brightest, bits, dither=dither, flat=flat) for pair in pairs]
    if all(pair.level == brightest for pair in pairs):
        return brought
    own = [pair.normalised(pair.level, bits, dither=dither, flat=flat) for pair in pairs]
    return min(brought, own, key=_difference)


def _difference(pairs: Sequence[NormalisedPair]) -> float:
    """How much successive left images differ from pixel to pixel, as a share of their light.

    Pixels count that are saturated in none of them; without any it is 0.
    """
    images: NDArray[Any] = np.stack([pair.left[::_COMPARED, ::_COMPARED] for pair in pairs])
    known = (images < np.iinfo(images.dtype).max).all(axis=0)
    light = (images * known).astype(np.int64)
    return float(np.abs(np.diff(light, axis=0)).sum() / max(light.sum(), 1))


@dataclass(slots=True)
class _Parts:
    infos: dict[Side, Any] = field(default_factory=dict)
    images: dict[Side, ReceivedImage] = field(default_factory=dict)

    def whole(self) -> bool:
        """Whether every camera's image and exposure have arrived."""
        info = self.infos.get("left")
        sides = SIDES[: info.cameras] if info is not None else ()
        return bool(sides) and all(side in self.infos and side in self.images for side in sides)


class _Sequence:
    """Counts gaps in the daemon's sequence in `tally.lost`.

    The cameras' messages come by two routes, each in order: a lone frame may overtake the end of an earlier pair.
    """

    def __init__(self, tally: ConsumerTally) -> None:
        self._tally = tally
        self._last: int | None = None
        self._alone: list[int] = []  # later than `_last`, in order

    def pair(self, sequence: int) -> None:
        """Note a complete pair; pairs come in order."""
        self._restart_if_before(sequence)
        while self._alone and self._alone[0] < sequence:
            self._advance(self._alone.pop(0))
        self._advance(sequence)

    def alone(self, sequence: int) -> None:
        """Note a lone frame."""
        self._restart_if_before(sequence)
        bisect.insort(self._alone, sequence)
        if len(self._alone) > _KEPT_STAMPS:
            self._advance(self._alone.pop(0))

    def _restart_if_before(self, sequence: int) -> None:
        """A new daemon counts from 0."""
        if self._last is not None and sequence <= self._last:
            self._last = None
            self._alone.clear()

    def _advance(self, sequence: int) -> None:
        if self._last is not None:
            self._tally.lost += _gap(self._last, sequence)
        self._last = sequence


def _gap(last: int, number: int) -> int:
    """How many are missing between two numbers of one count; 0 where it began again."""
    gap = number - last - 1
    return gap if 0 <= gap <= _LONGEST_GAP else 0


class PairAssembler:
    """Joins messages by their stamp, and counts pairs that never become complete in `tally.lost`."""

    def __init__(self, tally: ConsumerTally) -> None:
        self._tally = tally
        self._parts: dict[int, _Parts] = {}
        self._kept_bytes = 0
        self._sequence = _Sequence(tally)

    def exposure(self, side: Side, data: bytes, now_ns: int) -> ReceivedPair | None:
        """Take an ExposureInfo; returns the pair that it completes. Raises `DamagedMessageError`."""
        info = read_exposure_info(data)
        if info.alone:
            self._tally.alone += 1
            self._sequence.alone(info.sequence)
            return None
        stamp = stamp_ns(info)
        self._of(stamp).infos[side] = info
        return self._completed(stamp, now_ns)

    def image(self, side: Side, data: bytes, now_ns: int) -> ReceivedPair | None:
        """Take an Image; returns the pair that it completes. Raises `DamagedMessageError`."""
        stamp, image = read_image(data)
        waiting = self._of(stamp).images
        self._kept_bytes += image.pixels.nbytes - (waiting[side].pixels.nbytes if side in waiting else 0)
        waiting[side] = image
        pair = self._completed(stamp, now_ns)
        while self._kept_bytes > _KEPT_BYTES:
            self._forget(next(iter(self._parts)))
        return pair

    def _of(self, stamp: int) -> _Parts:
        parts = self._parts.setdefault(stamp, _Parts())
        while len(self._parts) > _KEPT_STAMPS:
            self._forget(next(iter(self._parts)))
        return parts

    def _forget(self, stamp: int) -> None:
        self._kept_bytes -= sum(image.pixels.nbytes for image in self._parts.pop(stamp).images.values())

    def _completed(self, stamp: int, now_ns: int) -> ReceivedPair | None:
        parts = self._parts[stamp]
        if not parts.whole():
            return None
        for older in [other for other in self._parts if other <= stamp]:
            self._forget(older)
        info = parts.infos["left"]
        frames = [frame_of(parts.infos[side], parts.images[side]) for side in SIDES[: info.cameras]]
        right = frames[1] if len(frames) > 1 else None
        decision = decision_of(info)
        self._sequence.pair(info.sequence)  # after what may refuse the pair, which then counts as lost
        return ReceivedPair(frames[0], right, stamp, info.trigger, info.sequence, decision, now_ns)


class PairQueue:
    """Complete pairs on their way to the consumer: a few of the newest; older ones are dropped and counted.

    Gaps in the left camera's frame id between pairs handed out are counted in `tally.missed`.
    """

    def __init__(self, tally: ConsumerTally, length: int) -> None:
        self._tally = tally
        self._length = length
        self._pairs: deque[ReceivedPair] = deque()
        self._frame_id: int | None = None

    def __len__(self) -> int:
        return len(self._pairs)

    def put(self, pair: ReceivedPair) -> None:
        """Add the newest pair."""
        if len(self._pairs) == self._length:
            self._pairs.popleft()
            self._tally.too_slow += 1
        self._pairs.append(pair)

    def take(self) -> ReceivedPair:
        """Remove and return the oldest pair; raises IndexError when the queue is empty."""
        pair = self._pairs.popleft()
        frame_id = pair.left.frame_id
        if self._frame_id is not None and frame_id > self._frame_id:  # else the camera was opened again
            self._tally.missed += _gap(self._frame_id, frame_id)
        self._frame_id = frame_id
        self._tally.pairs += 1
        return pair
