"""How many frames after a write exposures show it, judged by the brightness of the frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from calibration.findings import Finding

WrittenQuantity = Literal["exposure", "gain"]

CLEAR_CHANGE = 0.25
"""Relative change of grey by which a trial must end; a stop gives 50 to 100 %, less what light and clipping take."""
TORN = 0.2
"""A frame that lies farther than this part of the change from both its ends was taken with something in between."""
MIN_TRIALS = 5
REGULAR = 0.95
UNCLEAR = 0.2
"""Part of the trials that may be lost to traffic or light without a finding."""


@dataclass(frozen=True, slots=True)
class SeenFrame:
    """One frame around a write.

    Attributes
    ----------
    frame_id
        The camera's counter.
    start_ns
        When its exposure started (CLOCK_MONOTONIC).
    grey
        Its median grey level.
    says_new
        Whether its metadata say that it was taken with what was written; None when they do not say.
    """

    frame_id: int
    start_ns: int
    grey: float
    says_new: bool | None = None


@dataclass(frozen=True, slots=True)
class Trial:
    """One write, begun and read back at these times (CLOCK_MONOTONIC), with the frames from before it until it shows.

    The frames are in order; the last two show the effect, if there is any.
    """

    started_ns: int
    finished_ns: int
    frames: tuple[SeenFrame, ...]


@dataclass(frozen=True, slots=True)
class WriteEffect:
    """How long a write takes to show.

    Attributes
    ----------
    quantity
        What was written.
    frames
        Number of writes by the frames from the exposure under way at the write (0) to the first that shows it: 1 is the
        very next exposure.
    unclear
        Writes for which that is unknown: two exposures met them, a frame was lost, or the light did not show them.
    delay_us
        Between these times after a write an exposure must start to show it, as (longest seen too early, shortest seen
        late enough); if the first is above the second, time alone does not decide.
    lead_us
        How long after the start of an exposure the writes were made, as a median.
    findings
        Reasons not to trust it.
    """

    quantity: WrittenQuantity
    frames: dict[int, int]
    unclear: int
    delay_us: tuple[float, float] | None
    lead_us: float | None
    findings: tuple[Finding, ...]

    @property
    def mode(self) -> int | None:
        """The most frequent number of frames; None when no write was clear."""
        return max(self.frames, key=lambda count: self.frames[count]) if self.frames else None


@dataclass(frozen=True, slots=True)
class _Effect:
    """One write: frames to its effect, by light and by metadata; delays of the frames around the change."""

    frames: int
    said_frames: int | None
    early_ns: int
    late_ns: int
    lead_ns: int


def is_clear(trial: Trial) -> bool:
    """Whether a write lay within one exposure, no frame around its effect was lost, and the light shows it."""
    return _effect(trial) is not None


def write_effect(quantity: WrittenQuantity, trials: Sequence[Trial]) -> WriteEffect:
    """The distribution over many writes, and what is wrong with it."""
    effects = [effect for effect in map(_effect, trials) if effect is not None]
    counts = dict(sorted(Counter(effect.frames for effect in effects).items()))
    delay_us = lead_us = None
    if effects:
        delay_us = max(effect.early_ns for effect in effects) * 1e-3, min(effect.late_ns for effect in effects) * 1e-3
        lead_us = float(np.median([effect.lead_ns for effect in effects])) * 1e-3
    unclear = len(trials) - len(effects)
    return WriteEffect(quantity, counts, unclear, delay_us, lead_us, tuple(_findings(quantity, effects, unclear)))


def _effect(trial: Trial) -> _Effect | None:
    """What one write did; None when that is unclear."""
    under_way = [index for index, frame in enumerate(trial.frames) if frame.start_ns <= trial.started_ns]
    if not under_way or len(trial.frames) < under_way[-1] + 3:
        return None
    first = trial.frames[under_way[-1]]
    following = trial.frames[under_way[-1] + 1]
    if following.start_ns <= trial.finished_ns or following.frame_id != first.frame_id + 1:
        return None
    shown = _first_shown([frame.grey for frame in trial.frames], under_way[-1])
    if shown is None or any(
        later.frame_id != frame.frame_id + 1 for frame, later in pairwise(trial.frames[: shown + 1])
    ):
        return None
    said = [frame.frame_id for frame in trial.frames if frame.says_new]
    return _Effect(
        frames=trial.frames[shown].frame_id - first.frame_id,
        said_frames=said[0] - first.frame_id if said else None,
        early_ns=trial.frames[shown - 1].start_ns - trial.finished_ns,
        late_ns=trial.frames[shown].start_ns - trial.finished_ns,
        lead_ns=trial.finished_ns - first.start_ns,
    )


def _first_shown(greys: list[float], under_way: int) -> int | None:
    """Index of the first frame after the write that shows it; None when there is no clear step from old to new."""
    old, new = float(np.mean(greys[: under_way + 1])), float(np.mean(greys[-2:]))
    if abs(new - old) < CLEAR_CHANGE * max(min(old, new), 1.0):
        return None
    way = (np.array(greys) - old) / (new - old)
    if (np.minimum(np.abs(way), np.abs(way - 1.0)) > TORN).any():
        return None
    shown = way > 0.5
    first = int(np.argmax(shown))
    return first if first > 0 and shown[first:].all() else None


def _findings(quantity: WrittenQuantity, effects: list[_Effect], unclear: int) -> Iterator[Finding]:
    if len(effects) < MIN_TRIALS:
        yield Finding(
            "refused",
            "too_few_writes",
            f"only {len(effects)} of {len(effects) + unclear} writes of {quantity} showed in the images: use steady "
            "light, neither dark nor saturated",
        )
        return
    counts = Counter(effect.frames for effect in effects)
    mode, most = counts.most_common(1)[0]
    if most < REGULAR * len(effects):
        spread = ", ".join(f"{count} times {frames}" for frames, count in sorted(counts.items()))
        yield Finding(
            "warned",
            "irregular",
            f"a write of {quantity} takes no fixed number of frames to show ({spread}): lower the frame rate, or look "
            "for traffic that delays writes",
        )
    if unclear > UNCLEAR * (len(effects) + unclear):
        yield Finding(
            "warned",
            "unclear",
            f"{unclear} of {len(effects) + unclear} writes of {quantity} did not show clearly in the images: use "
            "steady light, and look for lost frames",
        )
    said = Counter(effect.said_frames for effect in effects if effect.said_frames is not None)
    if said and said.most_common(1)[0][0] != mode:
        yield Finding(
            "warned",
            "metadata_off",
            f"frames claim a new {quantity} {said.most_common(1)[0][0]} frames after its write, but show it after "
            f"{mode}: do not trust what this camera's chunks say",
        )
