"""From single messages to complete sets, and a count of those that never became complete. No transport here."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import islice
from typing import Any, ClassVar, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import (
    ReceivedImage,
    decision_of,
    frame_of,
    read_exposure_info,
    read_image,
    stamp_ns,
)
from imaging.errors import ConfigurationError
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
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


@dataclass(frozen=True, eq=False)
class ReceivedSet:
    """What the cameras of a rig took at one trigger, and what the daemon made of it."""

    MOST: ClassVar[int | None] = None  # how many cameras it can have

    # the frames by camera, each with its own exposure time and gain, in the order of the names that a client asked for.
    # Their host and arrival times are from the daemon's machine; the pixels are read-only
    frames: Mapping[CameraName, Frame]
    stamp_ns: int  # the middle of the first camera's exposure, CLOCK_REALTIME, unless `publish.stamp` says otherwise
    trigger: int  # the daemon's number for the trigger
    sequence: int  # number of the set among those that the daemon sent
    decision: Decision | None  # what the daemon decided on this set, for the first camera
    received_ns: int  # when the set became complete in this process, CLOCK_MONOTONIC
    # the response function of each camera, if the client was opened with `normalised`
    responses: Mapping[CameraName, ResponseFunction] = field(default_factory=dict)
    # the vignetting of each camera for which it was measured, along with the responses
    vignettings: Mapping[CameraName, Vignetting] = field(default_factory=dict)
    # the decision for each camera: they differ where not all are exposed together
    decisions: Mapping[CameraName, Decision] = field(default_factory=dict)

    @property
    def frame_set(self) -> FrameSet:
        """The set as control and drivers know it."""
        return FrameSet(self.trigger, self.frames)

    @property
    def reference(self) -> Frame:
        """The first frame."""
        return next(iter(self.frames.values()))

    @property
    def level(self) -> float:
        """Exposure level of the brightest exposed frame, stops."""
        return max(frame.setting.level for frame in self.frames.values())

    def normalised(
        self, reference: float | None = None, bits: Bits = 8, *, dither: bool = False, flat: bool = False
    ) -> NormalisedSet:
        """The frames as if taken with the exposure level `reference` (stops); None: that of the brightest exposed one.

        Scales, marks and `dither` are those of `imaging.normalised.normalised`. With `flat` vignetting is
        divided out: the light is as it is at the brightest place of the lens.

        Raises ConfigurationError if the responses are not known, or with `flat` the vignetting.
        """
        return NormalisedSet(*self._normalised(reference, bits, dither, flat))

    def _normalised(
        self, reference: float | None, bits: Bits, dither: bool, flat: bool
    ) -> tuple[dict[CameraName, Pixels], float]:
        level = self.level if reference is None else reference
        images: dict[CameraName, Pixels] = {}
        for camera, frame in self.frames.items():
            if camera not in self.responses:
                raise ConfigurationError(
                    f"the response of the {camera} camera is not known: open the client with normalised=True"
                )
            light = self._relative_light(camera, frame) if flat else None
            images[camera] = normalised(frame, self.responses[camera], level, bits, dither=dither, relative_light=light)
        return images, level

    def _relative_light(self, camera: CameraName, frame: Frame) -> NDArray[np.float32]:
        if camera not in self.vignettings:
            raise ConfigurationError(
                f"the vignetting of the {camera} camera is not known: name its file as cameras.{camera}.vignetting in "
                "the daemon's configuration"
            )
        height, width = frame.pixels.shape[:2]
        self.vignettings[camera].check_size((width, height), f"the {camera} camera")
        return _full_light(self.vignettings[camera])


class ReceivedPair(ReceivedSet):
    """A set of a stereo pair, or of a rig with one camera, whose frame is then the left one."""

    MOST = 2

    @property
    def left(self) -> Frame:
        """The left frame."""
        return self.reference

    @property
    def right(self) -> Frame | None:
        """The right frame; None in a rig with one camera."""
        return next(islice(self.frames.values(), 1, None), None)

    @property
    def stereo(self) -> FrameSet:
        """The pair as control and drivers know it."""
        return self.frame_set

    def normalised(
        self, reference: float | None = None, bits: Bits = 8, *, dither: bool = False, flat: bool = False
    ) -> NormalisedPair:
        """See `ReceivedSet.normalised`."""
        return NormalisedPair(*self._normalised(reference, bits, dither, flat))


@lru_cache(maxsize=4)
def _full_light(vignetting: Vignetting) -> NDArray[np.float32]:
    return vignetting.relative_light(vignetting.height, vignetting.width)


@dataclass(frozen=True, eq=False)
class NormalisedSet:
    """The images of a set, by camera, at the exposure level `reference` (stops)."""

    images: Mapping[CameraName, Pixels]
    reference: float


class NormalisedPair(NormalisedSet):
    """Those of a stereo pair."""

    @property
    def left(self) -> Pixels:
        """The left image."""
        return next(iter(self.images.values()))

    @property
    def right(self) -> Pixels | None:
        """The right image; None in a rig with one camera."""
        return next(islice(self.images.values(), 1, None), None)


@overload
def alike(
    *pairs: ReceivedPair, bits: Bits = 8, dither: bool = False, flat: bool = False
) -> Sequence[NormalisedPair]: ...
@overload
def alike(*sets: ReceivedSet, bits: Bits = 8, dither: bool = False, flat: bool = False) -> Sequence[NormalisedSet]: ...
def alike(*sets: ReceivedSet, bits: Bits = 8, dither: bool = False, flat: bool = False) -> Sequence[NormalisedSet]:
    """Sets of one rig in one photometric scale: each as if taken with the brightest of their exposures.

    At that level all are saturated alike: what is saturated in the brightest frame is not shown by any other either.
    If the first camera's images differ less as they were taken, the exposure has followed the light: then each set
    keeps its own exposure, and `reference` differs. `flat` is that of `ReceivedSet.normalised`.

    Raises ConfigurationError if the responses are not known, or with `flat` the vignetting.
    """
    brightest = max(each.level for each in sets)
    brought = [each.normalised(brightest, bits, dither=dither, flat=flat) for each in sets]
    if all(each.level == brightest for each in sets):
        return brought
    own = [each.normalised(each.level, bits, dither=dither, flat=flat) for each in sets]
    return min(brought, own, key=_difference)


def _difference(sets: Sequence[NormalisedSet]) -> float:
    """How much successive images of the first camera differ from pixel to pixel, as a share of their light.

    Pixels count that are saturated in none of them; without any it is 0.
    """
    firsts = [next(iter(each.images.values())) for each in sets]
    images: NDArray[Any] = np.stack([first[::_COMPARED, ::_COMPARED] for first in firsts])
    known = (images < np.iinfo(images.dtype).max).all(axis=0)
    light = (images * known).astype(np.int64)
    return float(np.abs(np.diff(light, axis=0)).sum() / max(light.sum(), 1))


@dataclass(slots=True)
class _Parts:
    infos: dict[CameraName, Any] = field(default_factory=dict)
    images: dict[CameraName, ReceivedImage] = field(default_factory=dict)

    def whole(self, cameras: Sequence[CameraName] | None) -> Sequence[CameraName]:
        """These cameras, or None: all of the rig, if the image and exposure of each have arrived; else none."""
        complete = self.infos.keys() & self.images.keys()
        if cameras is not None:
            return cameras if complete.issuperset(cameras) else ()
        known = next(iter(self.infos.values()), None)
        return sorted(complete) if known is not None and len(complete) == known.cameras else ()


class _Sequence:
    """Counts what is not handed out: gaps in the daemon's sequence in `tally.lost`, sets without a camera in `alone`.

    The cameras' messages come by routes of their own, each in order: what one says of a set may overtake the end of an
    earlier one, and lag behind the end of its own.
    """

    def __init__(self, tally: ConsumerTally) -> None:
        self._tally = tally
        self._last: int | None = None
        self._alone: list[int] = []  # sent without a camera, later than `_last`, in order

    def whole(self, sequence: int) -> None:
        """Note a complete set; they come in order."""
        self._restart_if_before(sequence)
        while self._alone and self._alone[0] < sequence:
            self._pass_over_first()
        if self._alone and self._alone[0] == sequence:  # it had all that were asked for
            self._alone.pop(0)
        self._advance(sequence)

    def alone(self, sequence: int, *, awaited: bool) -> None:
        """Note what a camera says: its set was sent without another one. Not all cameras are `awaited`."""
        if awaited:
            self._restart_if_before(sequence)
        if sequence in self._alone or (self._last is not None and sequence <= self._last):
            return
        bisect.insort(self._alone, sequence)
        if len(self._alone) > _KEPT_STAMPS:
            self._pass_over_first()

    def _pass_over_first(self) -> None:
        self._tally.alone += 1
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


Received = TypeVar("Received", bound=ReceivedSet)


class SetAssembler(Generic[Received]):
    """Joins messages by their stamp, and counts sets that never become complete in `tally.lost`.

    `kind` is made of what is complete: the frames of `cameras`, or None: of all that the rig has.
    """

    def __init__(self, kind: type[Received], tally: ConsumerTally, cameras: Sequence[CameraName] | None = None) -> None:
        self._kind, self._tally, self._cameras = kind, tally, cameras
        self._parts: dict[int, _Parts] = {}
        self._kept_bytes = 0
        self._sequence = _Sequence(tally)

    def exposure(self, camera: CameraName, data: bytes, now_ns: int) -> Received | None:
        """Take an ExposureInfo; returns the set that it completes. Raises `DamagedMessageError`."""
        info = read_exposure_info(data)
        if self._cameras is None and self._kind.MOST is not None:
            _check_stereo(camera, info.cameras, self._kind.MOST)
        awaited = self._cameras is None or camera in self._cameras
        if info.alone:
            self._sequence.alone(info.sequence, awaited=awaited)
        if not awaited or (info.alone and self._cameras is None):
            return None
        stamp = stamp_ns(info)
        self._of(stamp).infos[camera] = info
        return self._completed(stamp, now_ns)

    def image(self, camera: CameraName, data: bytes, now_ns: int) -> Received | None:
        """Take an Image; returns the set that it completes. Raises `DamagedMessageError`."""
        if self._cameras is not None and camera not in self._cameras:
            return None
        stamp, image = read_image(data)
        waiting = self._of(stamp).images
        self._kept_bytes += image.pixels.nbytes - (waiting[camera].pixels.nbytes if camera in waiting else 0)
        waiting[camera] = image
        received = self._completed(stamp, now_ns)
        while self._kept_bytes > _KEPT_BYTES:
            self._forget(next(iter(self._parts)))
        return received

    def _of(self, stamp: int) -> _Parts:
        parts = self._parts.setdefault(stamp, _Parts())
        while len(self._parts) > _KEPT_STAMPS:
            self._forget(next(iter(self._parts)))
        return parts

    def _forget(self, stamp: int) -> None:
        self._kept_bytes -= sum(image.pixels.nbytes for image in self._parts.pop(stamp).images.values())

    def _completed(self, stamp: int, now_ns: int) -> Received | None:
        parts = self._parts[stamp]
        cameras = parts.whole(self._cameras)
        if not cameras:
            return None
        for older in [other for other in self._parts if other <= stamp]:
            self._forget(older)
        info = parts.infos[cameras[0]]
        frames = {camera: frame_of(parts.infos[camera], parts.images[camera]) for camera in cameras}
        found = {camera: decision_of(parts.infos[camera]) for camera in cameras}
        decisions = {camera: decision for camera, decision in found.items() if decision is not None}
        self._sequence.whole(info.sequence)  # after what may refuse the set, which then counts as lost
        return self._kind(frames, stamp, info.trigger, info.sequence, found[cameras[0]], now_ns, decisions=decisions)


def _check_stereo(camera: CameraName, cameras: int, most: int) -> None:
    if cameras > most:
        raise DamagedMessageError(f"the rig has {cameras} cameras: give StereoClient the names of two of them")
    if cameras == most and camera not in SIDES:
        raise DamagedMessageError(f"the rig has a camera named {camera}: tell StereoClient which is left, which right")


class SetQueue(Generic[Received]):
    """Complete sets on their way to the consumer: a few of the newest; older ones are dropped and counted.

    Gaps in the first camera's frame id between sets handed out are counted in `tally.missed`.
    """

    def __init__(self, tally: ConsumerTally, length: int) -> None:
        self._tally = tally
        self._length = length
        self._sets: deque[Received] = deque()
        self._frame_id: int | None = None

    def __len__(self) -> int:
        return len(self._sets)

    def put(self, received: Received) -> None:
        """Add the newest set."""
        if len(self._sets) == self._length:
            self._sets.popleft()
            self._tally.too_slow += 1
        self._sets.append(received)

    def take(self) -> Received:
        """Remove and return the oldest set; raises IndexError when the queue is empty."""
        received = self._sets.popleft()
        frame_id = received.reference.frame_id
        if self._frame_id is not None and frame_id > self._frame_id:  # else the camera was opened again
            self._tally.missed += _gap(self._frame_id, frame_id)
        self._frame_id = frame_id
        self._tally.pairs += 1
        return received
