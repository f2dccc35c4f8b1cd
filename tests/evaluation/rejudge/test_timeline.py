from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.decision import Decision
from evaluation.rejudge.drive import ShotGlimpse, Timeline, Watcher, delay_frames
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, StereoPair
from imaging.response import ResponseFunction

LEVELS = (8.0, 10.4, 12.8, 14.0, 11.6, 9.2)
CYCLE = len(LEVELS)


LIGHT = 2.0**-13


def glimpse(
    number: int, median_share: float | None = None, *, repeats: bool | None = None, clipped: float = 0.0
) -> ShotGlimpse:
    setting = ExposureSetting(2.0 ** LEVELS[number % CYCLE], 0.0)
    above = np.full(257, clipped, np.float32)
    median = seen(LIGHT, number) if median_share is None else median_share
    return ShotGlimpse(number, number / 60, setting, 3.0, 0.2, setting, above, median, repeats)


def seen(light: float, number: int) -> float:
    """What the median pixel of a shot is in a light, as a share of full scale."""
    return float(np.clip(light * 2.0 ** LEVELS[number % CYCLE], 0.0, 1.0))


@given(st.integers(2, 40), st.sampled_from([2.0**5, 2.0**-5, 2.0**2, 2.0**-2]))
def test_a_jump_of_the_light_is_found_where_it_is(at: int, factor: float) -> None:
    light = [1e-4 * (factor if number >= at else 1.0) for number in range(60)]
    timeline = Timeline.of([glimpse(number, seen(light[number], number)) for number in range(60)], CYCLE)
    jumps = [number for number in range(1, 60) if timeline.sections[number] != timeline.sections[number - 1]]
    assert len(jumps) == 1
    assert abs(jumps[0] - at) <= 2  # shots in between that both lights explain may belong to either
    for number in range(60):
        assert all(timeline.sections[shot] == timeline.sections[number] for shot in timeline.near(number))
        assert number in timeline.near(number)


def test_a_light_that_only_drifts_has_no_jump() -> None:
    light = 1e-4 * 2.0 ** np.linspace(0.0, 4.0, 120)
    timeline = Timeline.of([glimpse(number, seen(light[number], number)) for number in range(120)], CYCLE)
    assert set(timeline.sections) == {0}


def test_in_motion_the_nearest_shot_stands_for_an_exposure() -> None:
    timeline = Timeline.of([glimpse(number) for number in range(36)], CYCLE)
    assert timeline.nearest(18, 10.3) == 19  # level 10.4, a frame later
    assert timeline.nearest(18, 5.0) == 18  # darker than all: the darkest, near in time
    assert timeline.glimpses[timeline.nearest(18, 20.0)].level == 14.0


def test_a_brighter_shot_that_saturates_more_than_wanted_does_not() -> None:
    clipped = {14.0: 0.3, 12.8: 0.2}
    glimpses = [glimpse(number, clipped=clipped.get(LEVELS[number % CYCLE], 0.0)) for number in range(36)]
    timeline = Timeline.of(glimpses, CYCLE)
    assert timeline.glimpses[timeline.nearest(18, 12.6)].level == 11.6


def test_only_what_repeats_for_a_cycle_is_still() -> None:
    repeats = [None] * CYCLE + [True] * 30 + [False] * 3 + [True] * 30
    timeline = Timeline.of([glimpse(number, repeats=answer) for number, answer in enumerate(repeats)], CYCLE)
    assert all(timeline.still[:20])
    assert not any(timeline.still[CYCLE + 24 : CYCLE + 36])
    assert timeline.motion_px(3) == 0.0
    assert timeline.motion_px(CYCLE + 31) == 3.0


def test_glimpses_tell_still_from_moving_pictures() -> None:
    rng = np.random.default_rng(1)
    scene = np.kron(rng.uniform(1e-5, 9e-5, (60, 80)), np.ones((9, 9)))
    decision = Decision(ExposureSetting(1000.0, 0.0), 10.0, "", 0.1, 0.0, 0.0, 0.0)

    def watch(shift_px: int) -> list[bool | None]:
        watcher = Watcher({"left": ResponseFunction.linear()}, 2)
        answers = []
        for number in range(8):
            setting = ExposureSetting((4000.0, 9000.0)[number % 2], 0.0)
            light = np.roll(scene, shift_px * number, axis=1) * 2.0**setting.level
            grey = np.clip(255 * light + rng.normal(0, 1, light.shape), 0, 255).astype(np.uint8)
            frame = Frame(grey, 8, number, 0, 0, 0, setting)
            answers.append(watcher.look(StereoPair(number, {"left": frame}), decision, number / 60).repeats)
        return answers

    assert watch(0) == [None, None, *[True] * 6]
    assert watch(3) == [None, None, *[False] * 6]


def test_the_delay_is_found_from_settings() -> None:
    settings = [ExposureSetting(100.0 * 1.3 ** (number % CYCLE), 0.0) for number in range(40)]
    for delay in (1, 2, 3):
        glimpses = [
            ShotGlimpse(n, n / 60, settings[n], 0.0, 0.1, settings[n + delay], np.zeros(257, np.float32), 0.3, None)
            for n in range(30)
        ]
        assert delay_frames(glimpses) == delay
