"""From a series in seconds to one in frames, while it is fresh."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.inputs import WIDEST_SPREAD_FRAMES, WINDOW_FRAMES, LightSeries
from autoexpose_daemon.runtime.inputs import OLDEST_LIGHT_S, ForetoldLight

RATE_HZ = 50.0
CAME_NS = 7_000_000_000
MOUTH_S = 0.3


class Clock:
    now_ns = CAME_NS

    def __call__(self) -> int:
        return self.now_ns


def told(clock: Clock, spread_s: float = 0.05) -> ForetoldLight:
    """Light that falls by 6 stops `MOUTH_S` after the series came."""
    light = ForetoldLight(RATE_HZ, clock)
    times_s = (np.arange(221) - 120) * 0.02
    fallen = np.where(times_s < MOUTH_S, 0.0, 6.0)
    light.take(LightSeries(8.0 + fallen, -fallen, 120, 0.02, spread_s))
    return light


@pytest.mark.parametrize(("taken_s", "frames"), [(0.0, 15), (0.2, 5), (-0.1, 20), (0.4, -5)])
def test_the_mouth_is_as_many_frames_ahead_as_fit_into_the_time_to_it(taken_s: float, frames: int) -> None:
    clock = Clock()
    light = told(clock)
    clock.now_ns = CAME_NS + round(0.41e9)
    ahead = light(CAME_NS + round(taken_s * 1e9))
    assert ahead is not None and ahead.spread_frames == pytest.approx(0.05 * RATE_HZ)
    assert ahead.now >= WINDOW_FRAMES
    mouth = next(index for index, level in enumerate(ahead.levels) if level > 11.0)
    assert mouth - ahead.now == pytest.approx(frames, abs=1)
    assert ahead.risen == tuple(8.0 - level for level in ahead.levels)


def test_what_is_old_or_vague_or_was_never_told_is_not_used() -> None:
    clock = Clock()
    assert ForetoldLight(RATE_HZ, clock)(CAME_NS) is None
    assert told(clock, spread_s=1.01 * WIDEST_SPREAD_FRAMES / RATE_HZ)(CAME_NS) is None
    light = told(clock)
    clock.now_ns = CAME_NS + round(OLDEST_LIGHT_S * 1e9)
    assert light(clock.now_ns) is not None
    clock.now_ns += 1
    assert light(clock.now_ns) is None


def test_at_a_low_rate_the_series_reaches_as_far_back_as_it_was_told() -> None:
    slow = LightSeries(np.full(221, 8.0), np.zeros(221), 120, 0.02, 0.05).in_frames(0.0, 10.0)
    assert slow is not None and slow.now == 24
