"""How many frames a write takes to show: writes just after exposures start, and the brightness of the frames."""

from __future__ import annotations

import itertools
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Literal

import numpy as np

from calibration.document import Finding
from calibration.session import Session
from drivers.genicam.metadata import FRAMES_AFTER
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.frames import Frame
from imaging.pixels import Pixels, light_samples

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
class TrialFrame:
    """One frame around a write."""

    frame_id: int  # the camera's counter
    start_ns: int  # when its exposure started (CLOCK_MONOTONIC)
    grey: float  # its median grey level
    # whether its metadata say that it was taken with what was written; None when they do not say
    says_new: bool | None = None


@dataclass(frozen=True, slots=True)
class WriteTrial:
    """One write, begun and read back at these times (CLOCK_MONOTONIC), with the frames from before it until it shows.

    The frames are in order; the last two show the effect, if there is any.
    """

    started_ns: int
    finished_ns: int
    frames: tuple[TrialFrame, ...]


@dataclass(frozen=True, slots=True)
class WriteEffect:
    """How long a write takes to show."""

    quantity: WrittenQuantity  # what was written
    # number of writes by the frames from the exposure under way at the write (0) to the first that shows it: 1 is the
    # very next exposure
    frames: dict[int, int]
    # writes for which that is unknown: two exposures met them, a frame was lost, or the light did not show them
    unclear: int
    # between these times after a write an exposure must start to show it, as (longest seen too early, shortest seen
    # late enough); if the first is above the second, time alone does not decide
    delay_us: tuple[float, float] | None
    lead_us: float | None  # how long after the start of an exposure the writes were made, as a median
    findings: tuple[Finding, ...]  # reasons not to trust it

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


def write_effect(quantity: WrittenQuantity, trials: Sequence[WriteTrial]) -> WriteEffect:
    """The distribution over many writes, and what is wrong with it."""
    effects = [effect for effect in map(_effect, trials) if effect is not None]
    counts = dict(sorted(Counter(effect.frames for effect in effects).items()))
    delay_us = lead_us = None
    if effects:
        delay_us = max(effect.early_ns for effect in effects) * 1e-3, min(effect.late_ns for effect in effects) * 1e-3
        lead_us = float(np.median([effect.lead_ns for effect in effects])) * 1e-3
    unclear = len(trials) - len(effects)
    return WriteEffect(quantity, counts, unclear, delay_us, lead_us, tuple(_findings(quantity, effects, unclear)))


def _effect(trial: WriteTrial) -> _Effect | None:
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
        text = (
            f"only {len(effects)} of {len(effects) + unclear} writes of {quantity} showed in the images: use steady "
            "light, neither dark nor saturated"
        )
        yield Finding("refused", "too_few_writes", text)
        return
    counts = Counter(effect.frames for effect in effects)
    mode, most = counts.most_common(1)[0]
    if most < REGULAR * len(effects):
        spread = ", ".join(f"{count} times {frames}" for frames, count in sorted(counts.items()))
        text = (
            f"a write of {quantity} takes no fixed number of frames to show ({spread}): lower the frame rate, or look "
            "for traffic that delays writes"
        )
        yield Finding("warned", "irregular", text)
    if unclear > UNCLEAR * (len(effects) + unclear):
        text = (
            f"{unclear} of {len(effects) + unclear} writes of {quantity} did not show clearly in the images: use "
            "steady light, and look for lost frames"
        )
        yield Finding("warned", "unclear", text)
    said = Counter(effect.said_frames for effect in effects if effect.said_frames is not None)
    if said and said.most_common(1)[0][0] != mode:
        text = (
            f"frames claim a new {quantity} {said.most_common(1)[0][0]} frames after its write, but show it after "
            f"{mode}: do not trust what this camera's chunks say"
        )
        yield Finding("warned", "metadata_off", text)


TRIALS = 100
"""Writes of each quantity: enough to distinguish 95 % from less, in a dozen seconds at 60 Hz."""
TRIES = 2
"""Up to this many times as many writes are made, if a busy computer makes some of them useless."""
LONGEST_PART = 0.6
"""Part of a frame period: the camera must keep its rate with the longer exposure, followed by readout."""
LEAD = 0.1
"""Part of a frame period after the start of an exposure at which it is written: shortly after, within clock errors."""
STEP_STOPS = 1.0
DARK, BRIGHT = 0.15, 0.6
"""Median grey of the brighter setting, as parts of full scale, between which one stop less is easy to see."""
TARGET = 0.35
SEARCH_STEPS = 8
SPARSE = 4
"""Every fourth row and column are enough to see the brightness change."""

Progress = Callable[[int, int], None]
Alternatives = tuple[ExposureSetting, ExposureSetting]


class _Watch:
    """The camera's frames while it is written to, and when its next exposure starts.

    `settings` are those written to it.
    """

    def __init__(self, session: Session, settings: Alternatives) -> None:
        self._session = session
        self._shortest_us = min(setting.exposure_time_us for setting in settings)
        self._recent: deque[Frame] = deque(maxlen=4 * FRAMES_AFTER)

    def next_frame(self) -> None:
        """Wait for one more frame."""
        self._recent.append(self._session.next_frame())

    def forget(self) -> None:
        """Forget all but the last two frames, which show the state before the next write."""
        while len(self._recent) > 2:
            self._recent.popleft()

    def write_just_after_a_start(self, setting: ExposureSetting) -> tuple[int, int, ExposureSetting]:
        """Wait until an exposure has just started, and write; returns start and end of the write, and what it took."""
        starts = [(frame.frame_id, self._start_ns(frame)) for frame in self._recent]
        period_ns = median(
            (late - early) / (later - earlier) for (earlier, early), (later, late) in itertools.pairwise(starts)
        )
        since_ns = starts[-1][1] + LEAD * period_ns
        ahead = math.ceil(max(time.monotonic_ns() - since_ns, 0.0) / period_ns)
        self._recent.extend(self._session.frames_until(int(since_ns + ahead * period_ns)))
        started_ns = time.monotonic_ns()
        taken = self._session.write(setting)
        return started_ns, time.monotonic_ns(), taken

    def follow(self, started_ns: int, finished_ns: int, old: ExposureSetting, new: ExposureSetting) -> WriteTrial:
        """Take frames until a write has shown, or should have, and return everything seen of it."""
        while sum(self._start_ns(frame) > finished_ns for frame in self._recent) < FRAMES_AFTER + 2:
            self.next_frame()
        return WriteTrial(started_ns, finished_ns, tuple(self._seen(frame, old, new) for frame in self._recent))

    def _seen(self, frame: Frame, old: ExposureSetting, new: ExposureSetting) -> TrialFrame:
        says_new = None
        if frame.setting_source == "chunk":
            says_new = frame.setting.agrees_with(new) and not frame.setting.agrees_with(old)
        return TrialFrame(
            frame.frame_id, self._start_ns(frame), _grey(light_samples(frame.pixels, frame.layout)), says_new
        )

    def _start_ns(self, frame: Frame) -> int:
        """When the exposure started: no later than its own length before the frame arrived, whatever its stamp says."""
        known = frame.setting_source == "chunk"
        exposure_us = frame.setting.exposure_time_us if known else self._shortest_us
        return min(frame.host_time_ns, frame.arrival_time_ns - round(exposure_us * 1e3))


def capture_latency(
    session: Session, rate_hz: float, trials: int = TRIALS, progress: Progress = lambda done, total: None
) -> list[WriteEffect]:
    """Measure how many frames a write of exposure time, and one of gain if the camera has one in dB, takes to show.

    The camera runs freely at `rate_hz`, in front of a static scene in steady light; one that is too dark or too bright
    at this rate gives no clear write, and the finding that says so. `trials` clear writes of each quantity are aimed
    for; `progress` is called with the number of clear writes so far, and the number aimed for. Raises CameraError when
    the camera fails.
    """
    session.latch_clock()
    bright, finding = _bright_setting(session, LONGEST_PART * 1e6 / rate_hz)
    alternatives = _alternatives(bright, session.limits)
    if finding is not None:
        return [WriteEffect(quantity, {}, 0, None, None, (finding,)) for quantity in alternatives]
    total = len(alternatives) * trials
    done = itertools.count(1)
    return [
        write_effect(quantity, _trials(session, settings, trials, lambda: progress(next(done), total)))
        for quantity, settings in alternatives.items()
    ]


def _alternatives(bright: ExposureSetting, limits: ExposureLimits) -> dict[WrittenQuantity, Alternatives]:
    """What is written in turn: exposure times, and gains if the camera has any, that differ by a stop."""
    short_us = bright.exposure_time_us / 2.0**STEP_STOPS
    found: dict[WrittenQuantity, Alternatives] = {"exposure": (ExposureSetting(short_us, bright.gain_db), bright)}
    step_db = STEP_STOPS * DB_PER_STOP
    high_db = min(bright.gain_db + step_db, limits.max_gain_db)
    low_db = max(high_db - step_db, limits.min_gain_db)
    if high_db - low_db > step_db / 2.0:
        found["gain"] = ExposureSetting(short_us, low_db), ExposureSetting(short_us, high_db)
    return found


def _trials(session: Session, settings: Alternatives, count: int, progress: Callable[[], None]) -> list[WriteTrial]:
    session.take(settings[1], 1)
    old = session.write(settings[1])
    watch = _Watch(session, settings)
    for _ in range(FRAMES_AFTER):
        watch.next_frame()
    trials: list[WriteTrial] = []
    clear = 0
    while clear < count and len(trials) < TRIES * count:
        watch.forget()
        started_ns, finished_ns, new = watch.write_just_after_a_start(settings[len(trials) % 2])
        trials.append(watch.follow(started_ns, finished_ns, old, new))
        old = new
        if _effect(trials[-1]) is not None:
            clear += 1
            progress()
    return trials


def _bright_setting(session: Session, longest_us: float) -> tuple[ExposureSetting, Finding | None]:
    """A setting that shows the scene at middle brightness, at the lowest gain that can; and why there is none."""
    limits = session.limits
    longest_us = min(longest_us, limits.max_time_us)
    setting = limits.realise(math.log2(longest_us / 2.0), longest_us / 2.0)
    for _ in range(SEARCH_STEPS):
        (shot,) = session.take(setting, 1)
        part = _grey(shot.pixels) / (2**shot.bit_depth - 1)
        if DARK < part < BRIGHT:
            return setting, None
        level = setting.level + min(max(math.log2(TARGET / max(part, 1e-3)), -3.0), 3.0)
        wanted_us = min(max(2.0 ** (level - limits.min_gain_db / DB_PER_STOP), limits.min_time_us), longest_us)
        following = limits.realise(level, wanted_us)
        if following == setting:
            break
        setting = following
    if part < DARK:
        text = f"the scene is too dark: it gives {part:.0%} of full scale at {setting}: add light, or lower --rate-hz"
        return setting, Finding("refused", "too_dark", text)
    text = f"the scene is too bright: it gives {part:.0%} of full scale at {setting}: take light away, close the iris"
    return setting, Finding("refused", "too_bright", text)


def _grey(pixels: Pixels) -> float:
    """The median grey level: a window or a lamp in the picture, saturated whatever is set, does not decide it."""
    return float(np.median(pixels[::SPARSE, ::SPARSE]))
