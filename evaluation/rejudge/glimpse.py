"""What is noted of each pair when a drive is read first: enough to know the light, and what stands still."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from autoexpose_daemon.control.decision import Decision
from evaluation.arrays import Floats32, Greys
from imaging.exposure import ExposureSetting
from imaging.frames import Side, StereoPair
from imaging.response import GREY_LEVELS, ResponseFunction

# Stillness is looked for at this size: noise averages out, and what moves by a pixel of it is far from still.
SMALL = (90, 68)
FAINT, BRIGHT = 0.02, 0.9  # Shares of full scale between which light is known
# In nine of ten places, light of a still picture differs by less from a cycle to the next: 0.08 with the noise of a dim
# room. An edge of two stops that moves by a pixel changes its place by twice as much.
STILL_STOPS = 0.12
COMPARED = 0.1  # Share of full scale above which places are compared: below, a grey level is too large a step


@dataclass(frozen=True, slots=True, eq=False)
class Glimpse:
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
    """Notes glimpses of the pairs of a drive, in order.

    `responses`: of the cameras. `cycle`: pairs in a cycle of the bracket.
    """

    def __init__(self, responses: Mapping[Side, ResponseFunction], cycle: int) -> None:
        greys = np.arange(GREY_LEVELS, dtype=np.float64)
        self._shares = {side: response.light(greys) for side, response in responses.items()}
        self._full = {side: response.saturation for side, response in responses.items()}
        self._before: deque[tuple[float, dict[Side, Floats32]]] = deque(maxlen=cycle)

    def look(self, pair: StereoPair, decision: Decision, time_s: float) -> Glimpse:
        """The glimpse of the next pair, of a time."""
        assert decision.metric is not None, "brackets measure it"
        shares = {side: self._seen(side, frame.grey8()) for side, frame in pair.frames.items()}
        level = pair.reference.setting.level
        repeats = None
        if len(self._before) == self._before.maxlen:
            before_level, before = self._before[0]
            repeats = _all(_alike(share, before.get(side), level - before_level) for side, share in shares.items())
        self._before.append((level, shares))
        pixels = {side: self._shares[side][frame.sparse_grey8()].ravel() for side, frame in pair.frames.items()}
        everything = np.concatenate(list(pixels.values()))
        counts = np.bincount((everything * GREY_LEVELS).astype(np.int64), minlength=GREY_LEVELS + 1)
        above = np.cumsum(counts[::-1])[::-1] / everything.size
        frame = pair.reference
        return Glimpse(
            pair.trigger,
            time_s,
            frame.setting,
            decision.motion_px,
            decision.metric,
            decision.setting,
            above.astype(np.float32),
            float(np.median(pixels[pair.reference_side])),
            repeats,
        )

    def _seen(self, side: Side, grey: Greys) -> Floats32:
        """Share of full scale by place, float32; saturated where any pixel of a place is."""
        share = np.asarray(self._shares[side][cv2.resize(grey, SMALL, interpolation=cv2.INTER_AREA)], np.float32)
        _, full = cv2.threshold(grey, self._full[side] - 1, 255, cv2.THRESH_BINARY)
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


def delay_frames(glimpses: Iterable[Glimpse], longest: int = 8) -> int:
    """How many pairs after the one that it was decided on a setting showed, most often; 2 where nothing tells."""
    seen = list(glimpses)
    agreed = [
        sum(later.setting.agrees_with(earlier.decided) for earlier, later in zip(seen, seen[by:], strict=False))
        for by in range(1, longest + 1)
    ]
    return 1 + int(np.argmax(agreed)) if any(agreed) else 2
