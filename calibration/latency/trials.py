"""Writing to a camera just after exposures start, and watching in which frame it shows."""

from __future__ import annotations

import itertools
import math
import time
from collections import deque
from collections.abc import Callable
from statistics import median

import numpy as np

from calibration.findings import Finding
from calibration.latency.write_effect import SeenFrame, Trial, WriteEffect, WrittenQuantity, is_clear, write_effect
from calibration.sources.session import Session
from drivers.genicam.metadata import FRAMES_AFTER
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.frames import Frame
from imaging.pixels import Pixels, light_samples

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

    def follow(self, started_ns: int, finished_ns: int, old: ExposureSetting, new: ExposureSetting) -> Trial:
        """Take frames until a write has shown, or should have, and return everything seen of it."""
        while sum(self._start_ns(frame) > finished_ns for frame in self._recent) < FRAMES_AFTER + 2:
            self.next_frame()
        return Trial(started_ns, finished_ns, tuple(self._seen(frame, old, new) for frame in self._recent))

    def _seen(self, frame: Frame, old: ExposureSetting, new: ExposureSetting) -> SeenFrame:
        says_new = None
        if frame.setting_source == "chunk":
            says_new = frame.setting.agrees_with(new) and not frame.setting.agrees_with(old)
        return SeenFrame(
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
    """Measure how many frames a write of exposure time, and one of gain, takes to show.

    Parameters
    ----------
    session
        A camera that runs freely at `rate_hz`, in front of a static scene in steady light.
    trials
        Clear writes of each quantity to aim for.
    progress
        Called with the number of clear writes so far, and the number aimed for.

    Returns
    -------
    One for the exposure, and one for the gain if the camera has a gain in dB. A scene that is too dark or too bright
    at this rate gives no clear write, and the finding that says so.
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


def _trials(session: Session, settings: Alternatives, count: int, progress: Callable[[], None]) -> list[Trial]:
    session.take(settings[1], 1)
    old = session.write(settings[1])
    watch = _Watch(session, settings)
    for _ in range(FRAMES_AFTER):
        watch.next_frame()
    trials: list[Trial] = []
    clear = 0
    while clear < count and len(trials) < TRIES * count:
        watch.forget()
        started_ns, finished_ns, new = watch.write_just_after_a_start(settings[len(trials) % 2])
        trials.append(watch.follow(started_ns, finished_ns, old, new))
        old = new
        if is_clear(trials[-1]):
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
