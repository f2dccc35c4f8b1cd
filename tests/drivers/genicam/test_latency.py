from __future__ import annotations

import random

import pytest

from drivers.genicam.metadata import WriteLatency

PERIOD_NS = 16_666_667


def run(latency_ns: int, changes_stops: list[float], seed: int = 1, light: float = 0.0) -> WriteLatency:
    """A camera that shows a write `latency_ns` later, written at random phases, a change every 12 frames."""
    numbers = random.Random(seed)
    measured = WriteLatency()
    level, shown, due_ns = 5.0, 5.0, 0
    for frame in range(12 * (len(changes_stops) + 1)):
        start_ns = frame * PERIOD_NS
        if frame and frame % 12 == 0:
            written_ns = start_ns - numbers.randrange(1, PERIOD_NS)
            change = changes_stops[frame // 12 - 1]
            level += change
            due_ns = written_ns + latency_ns
            measured.write(written_ns, change)
        shown = level if start_ns > due_ns else shown
        measured.frame(start_ns, 2.0 ** (shown + light * numbers.uniform(-1, 1)))
    return measured


@pytest.mark.parametrize("periods", [0, 1, 2])
def test_it_finds_the_delay_of_a_camera_in_whole_frames(periods: int) -> None:
    measured = run(periods * PERIOD_NS, [1.0, -1.0] * 4, light=0.05)
    assert measured.latency_ns <= periods * PERIOD_NS
    assert measured.latency_ns > (periods - 0.4) * PERIOD_NS


def test_the_latency_is_zero_until_a_change_was_seen() -> None:
    assert WriteLatency().latency_ns == 0
    assert run(2 * PERIOD_NS, [0.2, -0.2]).latency_ns == 0


def test_changes_in_quick_succession_are_skipped() -> None:
    measured = WriteLatency()
    level = 5.0
    for frame in range(60):
        measured.frame(frame * PERIOD_NS, 2.0**level)
        level += 1.0 if frame % 2 else -1.0
        measured.write(frame * PERIOD_NS + 1, 1.0 if frame % 2 else -1.0)
    assert measured.latency_ns == 0
