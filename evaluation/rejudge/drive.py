"""A drive recorded in brackets, never held in memory as a whole, and which shots show the light at each instant."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import cv2
import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import REFERENCE_RATE_HZ
from autoexpose_daemon.control.setup import ControlSetup
from evaluation.arrays import Floats32, Greys
from imaging.errors import AutoexposeError
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet
from imaging.geometry import CameraGeometry
from imaging.pixels import plane_shape
from imaging.python310 import exp2
from imaging.response import GREY_LEVELS, ResponseFunction

# Stillness is looked for at this size: noise averages out, and what moves by a pixel of it is far from still.
SMALL = (90, 68)
FAINT, BRIGHT = 0.02, 0.9  # Shares of full scale between which light is known
# In nine of ten places, light of a still picture differs by less from a cycle to the next: 0.08 with the noise of a dim
# room. An edge of two stops that moves by a pixel changes its place by twice as much.
STILL_STOPS = 0.12
COMPARED = 0.1  # Share of full scale above which places are compared: below, a grey level is too large a step


@dataclass(frozen=True, slots=True, eq=False)
class ShotGlimpse:
    """One pair of a drive."""

    trigger: int  # its trigger
    time_s: float  # when it was taken, seconds
    setting: ExposureSetting  # of the reference frame
    motion_px: float  # speed of the image as the recorder saw it, pixels per 1/60 s
    metric: float  # M_g of the reference frame
    decided: ExposureSetting  # the setting that was decided on it
    # Share of all pixels with at least each share of full scale: ``above[i]`` for that of grey level i; float32, shape
    # (257,).
    above: Floats32
    median_share: float  # that of the median pixel of the reference frame
    repeats: bool | None  # whether it shows the light that the pair a cycle earlier shows; None where nothing tells

    @property
    def level(self) -> float:
        """Exposure level, stops."""
        return self.setting.level

    @property
    def middle_stops(self) -> float | None:
        """Light of the median pixel, stops at level 0; None where it is black or saturated."""
        if not FAINT <= self.median_share <= BRIGHT:
            return None
        return float(np.log2(self.median_share)) - self.level

    def share_above(self, share: float) -> float:
        """Share of the pixels with at least this share of full scale, for linear steps of it."""
        return float(self.above[min(int(np.ceil(share * GREY_LEVELS)), GREY_LEVELS)])


class Watcher:
    """Notes glimpses of the pairs of a drive, in order. `cycle`: pairs in a cycle of the bracket."""

    def __init__(self, responses: Mapping[CameraName, ResponseFunction], cycle: int) -> None:
        greys = np.arange(GREY_LEVELS, dtype=np.float64)
        self._shares = {camera: response.light(greys) for camera, response in responses.items()}
        self._full = {camera: response.saturation for camera, response in responses.items()}
        self._before: deque[tuple[float, dict[CameraName, Floats32]]] = deque(maxlen=cycle)

    def look(self, pair: FrameSet, decision: Decision, time_s: float) -> ShotGlimpse:
        """The glimpse of the next pair, of a time."""
        assert decision.metric is not None, "brackets measure it"
        shares = {camera: self._seen(camera, frame.grey8()) for camera, frame in pair.frames.items()}
        level = pair.reference.setting.level
        repeats = None
        if len(self._before) == self._before.maxlen:
            before_level, before = self._before[0]
            repeats = _all(_alike(share, before.get(camera), level - before_level) for camera, share in shares.items())
        self._before.append((level, shares))
        pixels = {camera: self._shares[camera][frame.sparse_grey8()].ravel() for camera, frame in pair.frames.items()}
        everything = np.concatenate(list(pixels.values()))
        counts = np.bincount((everything * GREY_LEVELS).astype(np.int64), minlength=GREY_LEVELS + 1)
        above = np.cumsum(counts[::-1])[::-1] / everything.size
        frame = pair.reference
        return ShotGlimpse(
            pair.trigger, time_s, frame.setting, decision.motion_px, decision.metric, decision.setting,
            above.astype(np.float32), float(np.median(pixels[pair.reference_camera])), repeats,
        )  # fmt: skip

    def _seen(self, camera: CameraName, grey: Greys) -> Floats32:
        """Share of full scale by place, float32; saturated where any pixel of a place is."""
        share = np.asarray(self._shares[camera][cv2.resize(grey, SMALL, interpolation=cv2.INTER_AREA)], np.float32)
        _, full = cv2.threshold(grey, self._full[camera] - 1, 255, cv2.THRESH_BINARY)
        share[cv2.resize(full, SMALL, interpolation=cv2.INTER_AREA) > 0] = 1.0
        return share


def _alike(share: Floats32, before: Floats32 | None, stops: float) -> bool | None:
    """Whether two pictures show the same light, the first with so many stops more; None where no place tells."""
    if before is None:
        return False
    known = (share > COMPARED) & (share < BRIGHT) & (before > COMPARED) & (before < BRIGHT)
    if not known.any():
        return None
    apart = np.abs(np.log2(share[known] / before[known]) - stops)
    return float(np.quantile(apart, 0.9)) < STILL_STOPS


def _all(answers: Iterable[bool | None]) -> bool | None:
    """False if one is False, else None if none is known."""
    known = [answer for answer in answers if answer is not None]
    return all(known) if known else None


def delay_frames(glimpses: Iterable[ShotGlimpse], longest: int = 8) -> int:
    """How many pairs after the one that it was decided on a setting showed, most often; 2 where nothing tells."""
    seen = list(glimpses)
    agreed = [
        sum(later.setting.agrees_with(earlier.decided) for earlier, later in zip(seen, seen[by:], strict=False))
        for by in range(1, longest + 1)
    ]
    return 1 + int(np.argmax(agreed)) if any(agreed) else 2


# Cycles before and after an instant from which a shot may stand for it: the ladder needs one to follow a jump of the
# light, and all shots of that cycle may be saturated.
REACH = 2
EMPTY = 0.98  # A shot with a larger share of saturated places shows nothing
# A larger change of the light of the median pixel, from one shot to the next that knows it, is a jump of the light.
JUMP_STOPS = 1.0
STOPS_PER_FRAME = 0.05  # What a shot is farther off in time counts against this much off in level
# What a brighter shot saturates that the wanted exposure would not: a hundredth of the picture counts like a fifth of a
# stop.
STOPS_PER_CLIPPED = 20.0


@dataclass(frozen=True, slots=True)
class Timeline:
    """The glimpses of a drive, by their numbers, and what follows from all of them."""

    glimpses: Sequence[ShotGlimpse]  # in order
    cycle: int  # pairs in a cycle of the bracket
    sections: Sequence[int]  # for each, the number of jumps of the light before it
    # For each, whether nothing moves or changes from half a cycle before it to half a cycle after it.
    still: Sequence[bool]

    @classmethod
    def of(cls, glimpses: Sequence[ShotGlimpse], cycle: int) -> Timeline:
        """Of a whole drive."""
        sections = _sections(glimpses)
        return cls(glimpses, cycle, sections, list(_still(glimpses, cycle, sections)))

    def near(self, number: int) -> range:
        """The shots that may stand for an instant: those of some cycles before and after it, in the same light."""
        first, last = max(number - REACH * self.cycle, 0), min(number + REACH * self.cycle, len(self.glimpses) - 1)
        while self.sections[first] != self.sections[number]:
            first += 1
        while self.sections[last] != self.sections[number]:
            last -= 1
        return range(first, last + 1)

    def around(self, number: int) -> Sequence[int]:
        """A cycle's worth of shots nearest to an instant, for fusion, and the darkest of all that may stand for it.
        Those that show nothing are there only if no others are."""
        near = self.near(number)
        by_use = sorted(near, key=lambda shot: (self.glimpses[shot].share_above(1.0) > EMPTY, abs(shot - number)))
        darkest = min(near, key=lambda shot: self.glimpses[shot].level)
        return sorted({*by_use[: self.cycle], darkest})

    def nearest(self, number: int, level: float) -> int:
        """The shot from which an exposure level is best made at an instant in motion. It is near in level and time, and
        does not saturate what the wanted exposure would not."""
        near = self.near(number)
        darker = [shot for shot in near if self.glimpses[shot].level <= level]
        wanted_clipped = 1.0
        if darker:
            best = max(darker, key=lambda shot: self.glimpses[shot].level)
            wanted_clipped = self.glimpses[best].share_above(exp2(self.glimpses[best].level - level))

        def cost(shot: int) -> float:
            glimpse = self.glimpses[shot]
            off = abs(glimpse.level - level) + STOPS_PER_FRAME * abs(shot - number)
            if glimpse.level <= level:
                return off
            return off + STOPS_PER_CLIPPED * max(glimpse.share_above(1.0) - wanted_clipped, 0.0)

        return min(near, key=cost)

    def motion_px(self, number: int) -> float:
        """Speed of the image at an instant: flow between unlike exposures is rough, so its median over a cycle."""
        if self.still[number]:
            return 0.0
        return float(np.median([self.glimpses[shot].motion_px for shot in self.around(number)]))

    @property
    def cycle_motion_px(self) -> float | None:
        """By how much the image moves in a cycle, in the median of the time in motion; None: it never moves."""
        moving = [glimpse.motion_px for glimpse, still in zip(self.glimpses, self.still, strict=True) if not still]
        return REFERENCE_RATE_HZ * self.cycle_s * float(np.median(moving)) if moving else None

    @property
    def cycle_s(self) -> float:
        """How often the bracket shows what a policy wants."""
        seconds = self.glimpses[-1].time_s - self.glimpses[0].time_s
        return seconds * self.cycle / (len(self.glimpses) - 1)


def _still(glimpses: Sequence[ShotGlimpse], cycle: int, sections: Sequence[int]) -> Iterator[bool]:
    """For each shot, whether those of half a cycle before and after it repeat what others of their light show."""
    half, last = cycle // 2, len(glimpses) - 1

    def repeats(shot: int) -> bool | None:
        return glimpses[shot].repeats if shot >= cycle and sections[shot - cycle] == sections[shot] else None

    for number, section in enumerate(sections):
        around = range(max(number - half, 0), min(number + half, last) + 1)
        same = [shot for shot in around if sections[shot] == section]
        answers = {repeats(shot) for shot in same} | {repeats(min(shot + cycle, last)) for shot in same}
        yield True in answers and False not in answers


def _sections(glimpses: Sequence[ShotGlimpse]) -> list[int]:
    """For each shot, the number of jumps of the light before it."""
    known = [number for number, glimpse in enumerate(glimpses) if glimpse.middle_stops is not None]
    starts = [0] * len(glimpses)
    for before, after in pairwise(known):
        first, second = glimpses[before].middle_stops, glimpses[after].middle_stops
        assert first is not None
        assert second is not None
        if abs(second - first) > JUMP_STOPS:
            starts[_jump_between(glimpses, before, after, first, second)] = 1
    return list(accumulate(starts))


def _jump_between(glimpses: Sequence[ShotGlimpse], before: int, after: int, first: float, second: float) -> int:
    """The first shot in the new light, by what the shots in between saturate or leave black."""
    for number in range(before + 1, after):
        glimpse = glimpses[number]
        if not _explains(first, glimpse) and _explains(second, glimpse):
            return number
    unlike = [number for number in range(before + 1, after) if not _explains(second, glimpses[number])]
    return max(unlike, default=before) + 1


def _explains(middle_stops: float, glimpse: ShotGlimpse) -> bool:
    """Whether a light makes the median pixel of a shot as black or saturated as it is."""
    share = exp2(middle_stops + glimpse.level)
    return share >= BRIGHT if glimpse.median_share > BRIGHT else share <= FAINT


FEWEST_CYCLES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What is known of a drive after it has been read once."""

    name: str  # for people
    setup: ControlSetup  # what control was built from, with `ControlParameters.bracket`
    # Reads its complete pairs from the first to the last; pickles, if it is to go to other processes.
    source: Callable[[], Iterator[FrameSet]]
    timeline: Timeline  # of these pairs
    geometries: Mapping[CameraName, CameraGeometry]  # of the calibrated cameras
    shape: tuple[int, int]  # (height, width) of what `Frame.grey8` gives
    delay_frames: int  # a decision showed this many pairs later
    missing: int  # triggers without a complete pair, from the first to the last one

    @property
    def seconds(self) -> float:
        """From the first pair to the last."""
        return self.timeline.glimpses[-1].time_s - self.timeline.glimpses[0].time_s

    def pairs(self) -> Iterator[tuple[int, Callable[[int], FrameSet]]]:
        """Each instant, with a function that gives the pairs that may stand for it, `Timeline.near`."""
        reach = REACH * self.timeline.cycle
        kept: deque[tuple[int, FrameSet]] = deque(maxlen=2 * reach + 1)
        ahead = enumerate(self.source())

        def pair_at(number: int) -> FrameSet:
            return kept[number - kept[0][0]][1]

        for number in range(len(self.timeline.glimpses)):
            while not kept or kept[-1][0] < number + reach:
                entry = next(ahead, None)
                if entry is None:
                    break
                kept.append(entry)
            yield number, pair_at


def check_long_enough(name: str, pairs: int, cycle: int) -> None:
    """Raise AutoexposeError for a drive of too few pairs."""
    needed = FEWEST_CYCLES * cycle
    if pairs < needed:
        raise AutoexposeError(f"{name}: has {pairs} complete pairs: give at least {needed}, {FEWEST_CYCLES} cycles")


def watched(
    name: str,
    setup: ControlSetup,
    seen: Iterable[tuple[FrameSet, Decision, float]],
    source: Callable[[], Iterator[FrameSet]],
    geometries: Mapping[CameraName, CameraGeometry],
) -> Drive:
    """A drive that is read for the first time. `name`, `setup`, `source`, `geometries`: as in `Drive`. `seen`: what
    `source` reads, what was decided on each pair, and when it was taken (s). Raises AutoexposeError for a drive that is
    too short, or of a pixel format that cannot be exposed again."""
    bracket = setup.parameters.bracket
    assert bracket is not None, "a drive in brackets"
    cycle = bracket.exposures + bracket.keep
    watcher, glimpses, shape = Watcher(setup.responses, cycle), [], (0, 0)
    for pair, decision, time_s in seen:
        frame = pair.reference
        if frame.layout == "YUYV":
            raise AutoexposeError(f"{name}: frames of YUV422_8 cannot be exposed again: record Mono, Bayer or RGB8")
        glimpses.append(watcher.look(pair, decision, time_s))
        shape = plane_shape((frame.pixels.shape[0], frame.pixels.shape[1]), frame.layout)
    check_long_enough(name, len(glimpses), cycle)
    missing = glimpses[-1].trigger - glimpses[0].trigger + 1 - len(glimpses)
    timeline = Timeline.of(glimpses, cycle)
    return Drive(name, setup, source, timeline, geometries, shape, delay_frames(glimpses), max(missing, 0))
