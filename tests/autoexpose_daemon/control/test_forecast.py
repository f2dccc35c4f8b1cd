"""Light that follows a pattern, the delay of the loop, and what an earlier drive foretells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.inputs import UNPROVEN, WINDOW_FRAMES, LightAhead
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import ControlParameters
from autoexpose_daemon.control.policies.belief.forecast import (
    FORGOTTEN_FRAMES,
    LEAST_BELIEF,
    LEAST_CHANGE,
    LEAST_FRAMES,
    MOST_BELIEF,
    RESIDUE,
    Forecast,
    Foresight,
    LoopDelay,
)
from autoexpose_daemon.control.step import StepInputs
from imaging.exposure import ExposureSetting
from imaging.frames import FrameSet
from imaging.response import ResponseFunction

from .scene import LIMITS, run


def ahead(forecast: Forecast, frames: int, *, steady: bool) -> float:
    (stops,) = forecast.path([frames], steady)
    return stops


def test_a_ramp_goes_on() -> None:
    forecast = Forecast()
    for _ in range(30):
        forecast.add(0.13)
    assert forecast.period() is None
    assert ahead(forecast, 2, steady=True) == pytest.approx(0.26)
    assert ahead(forecast, 2, steady=False) == 0
    forecast.add(-0.13)
    assert ahead(forecast, 2, steady=True) == 0


@pytest.mark.parametrize("cycle", [[0.0, 2.0, -2.0], [0.0] * 14 + [3.0] + [0.0] * 14 + [-3.0]])
@pytest.mark.parametrize("delay", [1, 2, 3, 5])
def test_a_periodic_change_is_expected_again(cycle: list[float], delay: int) -> None:
    forecast, rng = Forecast(), np.random.default_rng(1)
    coming = cycle * 40
    for change in coming[:90]:
        forecast.add(change + rng.normal(0.0, 0.02))
    assert forecast.period() == len(cycle)
    assert ahead(forecast, delay, steady=False) == pytest.approx(sum(coming[90 : 90 + delay]), abs=0.2)


def test_light_swings_by_what_it_rises_and_falls_again() -> None:
    forecast = Forecast()
    for _ in range(20):
        forecast.add(0.5)
    assert forecast.swing() == pytest.approx(0.0)
    for change in [2.0, -1.0, -0.5] * 4:
        forecast.add(change)
    assert forecast.swing() == pytest.approx(4 * 3.5 - 4 * 0.5)


def test_random_changes_have_no_period() -> None:
    forecast, rng = Forecast(), np.random.default_rng(2)
    for change in rng.normal(0.0, 0.5, 96):
        forecast.add(change)
    assert forecast.period() is None


def slow_period(changes: list[float], slack: float) -> int | None:
    """The shortest lag, of at least two periods, at which the newest changes are large and recur, or almost."""
    for lag in range(2, len(changes) // 2 + 1):
        seen = np.array(changes)[-max(2 * lag, LEAST_FRAMES + lag) :]
        large = len(seen) >= LEAST_FRAMES + 2 and np.var(seen) >= slack * LEAST_CHANGE**2
        if large and np.mean((seen[lag:] - seen[:-lag]) ** 2) < 2 * RESIDUE * np.var(seen) / slack:
            return lag
    return None


@given(
    length=st.integers(0, 96),
    cycle=st.lists(st.sampled_from([0.0, 0.0, 0.1, 0.2, 1.0, -1.0, -0.2]), min_size=1, max_size=50),
    noise=st.sampled_from([0.0, 0.02, 0.05, 0.1, 0.3]),
    still_frames=st.integers(0, 96),
    seed=st.integers(0, 99),
)
def test_the_shortest_period_is_found(
    length: int, cycle: list[float], noise: float, still_frames: int, seed: int
) -> None:
    changes = (np.resize(cycle, length) + np.random.default_rng(seed).normal(0.0, noise, length)).tolist()
    forecast = Forecast()
    for change in [0.0] * still_frames + changes:
        forecast.add(change)
    assert forecast.period() in {slow_period(list(forecast.changes), slack) for slack in (1 - 1e-9, 1 + 1e-9)}


@pytest.mark.parametrize("delay", [1, 2, 3, 6])
def test_the_delay_is_found_in_the_settings_of_frames(delay: int) -> None:
    latency, asked, targets = LoopDelay(), [10.0] * delay, list[float]()
    for index in range(30):
        latency.see(asked[index], targets)
        target = 10.0 if index < 12 else 13.0
        targets.append(target)
        asked.append(target)
    assert latency.frames == delay


def test_a_frame_that_is_lost_on_the_way_does_not_change_the_delay() -> None:
    latency, asked, targets = LoopDelay(), [10.0] * 4, list[float]()
    for index in range(48):
        if index != 42:  # one that follows a change
            latency.see(asked[index], targets)
            targets.append(10.0 + 3.0 * (index // 10 % 2))
        asked.append(targets[-1])
    assert latency.frames == 4


BEHIND, TO_MOUTH = 100, 8
STILL = [0.0] * WINDOW_FRAMES


def followed(levels: NDArray[np.float64], now: int, spread_frames: float) -> LightAhead:
    """A drive on which only the light changed."""
    return LightAhead(tuple(levels.tolist()), tuple((-levels).tolist()), now, spread_frames)


def tunnel(in_frames: int, spread_frames: float = 2.0) -> LightAhead:
    """A series whose light falls by 6 stops `in_frames` from now, for good."""
    return followed(np.where(np.arange(200) < BEHIND + in_frames, 8.0, 14.0), BEHIND, spread_frames)


def expected(
    foresight: Foresight, ahead: LightAhead, changes: list[float], frames: int, otherwise: float = 0.0
) -> float:
    """By how much the light will rise within so many frames, or `otherwise` if the series is wrong."""
    share = foresight.weigh(ahead, changes)
    assert 0.0 <= share <= 1.0 and foresight.places.sum() == pytest.approx(1.0) and (foresight.places >= 0.0).all()
    return (1.0 - share) * otherwise + share * float(foresight.places @ rises_of(foresight, ahead, frames))


def rises_of(foresight: Foresight, ahead: LightAhead, frames: int) -> NDArray[np.float64]:
    """Of the light within so many frames, from each place where the rig may be."""
    now, then = (np.array(ahead.risen).take(foresight.here + shift, mode="clip") for shift in (0, frames))
    return np.asarray(then - now)


def test_a_believed_mouth_is_expected_when_the_frame_to_come_lies_beyond_it() -> None:
    far, near = Foresight(MOST_BELIEF), Foresight(MOST_BELIEF)
    assert expected(far, tunnel(30), STILL, 2) == pytest.approx(0.0, abs=0.01)
    assert expected(near, tunnel(8), STILL, 16) == pytest.approx(-6.0 * MOST_BELIEF, abs=0.2)


def test_where_the_mouth_may_lie_on_either_side_both_are_expected() -> None:
    foresight, ahead = Foresight(MOST_BELIEF), tunnel(8, spread_frames=4.0)
    share = foresight.weigh(ahead, STILL)
    rises = rises_of(foresight, ahead, 8)
    assert set(rises.tolist()) == {-6.0, 0.0}
    assert share * foresight.places[rises < 0.0].sum() == pytest.approx(MOST_BELIEF / 2, abs=0.1)


def test_light_that_fell_already_is_not_expected_to_fall_again() -> None:
    """The mouth came three frames early."""
    fell = [*STILL[:-1], -6.0]
    assert expected(Foresight(MOST_BELIEF), tunnel(3), fell, 8) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("late_frames", [-4, 0, 4])
def test_a_change_on_the_way_tells_where_the_rig_is(late_frames: int) -> None:
    """A shade, half a second before the mouth."""
    levels = np.full(200, 8.0)
    levels[BEHIND - 24 : BEHIND - 14] = 10.0
    levels[BEHIND + 8 :] = 14.0
    changes = np.zeros(WINDOW_FRAMES)
    changes[[-25 + late_frames, -15 + late_frames]] = -2.0, 2.0
    ahead = followed(levels, BEHIND, 3.0)
    for frames in (4, 6, 10, 12):
        rise = expected(Foresight(MOST_BELIEF), ahead, changes.tolist(), frames)
        assert (rise < -3.0) == (frames >= 8 + late_frames), (frames, rise)


def test_what_has_foretold_nothing_yet_is_believed_less_than_a_half() -> None:
    assert expected(Foresight(), tunnel(8), STILL, 16) == pytest.approx(-6.0 * UNPROVEN, abs=0.2)


def test_a_series_that_is_wrong_leaves_the_forecast_as_it_is() -> None:
    long_past = tunnel(-20)  # the light should have fallen a third of a second ago
    assert expected(Foresight(MOST_BELIEF), long_past, STILL, 2, otherwise=0.5) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("fell", "belief"), [(-6.0, MOST_BELIEF), (0.0, LEAST_BELIEF)])
def test_belief_is_earned_and_lost_by_changes_that_come_or_do_not(fell: float, belief: float) -> None:
    foresight, changes = Foresight(), list(STILL)
    for frame in range(-30, 90):
        changes = [*changes[1:], fell if frame == 0 else 0.0]
        foresight.weigh(tunnel(-frame), changes)
    assert foresight.belief == pytest.approx(belief, abs=0.02)


def test_what_a_drive_has_proven_is_forgotten_once_it_has_ended() -> None:
    foresight = Foresight(MOST_BELIEF)
    for _ in range(FORGOTTEN_FRAMES - 1):
        foresight.rest()
    assert foresight.belief == MOST_BELIEF
    foresight.rest()
    assert foresight.belief == UNPROVEN


def test_a_series_that_begins_here_says_what_comes_and_is_not_judged() -> None:
    short = followed(np.array([8.0] * 6 + [14.0] * 60), 0, 0.5)
    foresight = Foresight(MOST_BELIEF)
    assert expected(foresight, short, [*STILL[:-1], 3.0], 16) == pytest.approx(-6.0 * MOST_BELIEF, abs=0.3)
    assert foresight.belief == pytest.approx(MOST_BELIEF, abs=0.01)


def test_a_series_without_changes_proves_nothing() -> None:
    foresight, even = Foresight(), followed(np.full(200, 9.0), BEHIND, 2.0)
    for change in (0.0, 2.0, -3.0):
        assert expected(foresight, even, [change] * 4, 2, otherwise=0.25) == pytest.approx(0.25 * (1 - UNPROVEN))
    assert foresight.belief == pytest.approx(UNPROVEN)


class ToldLoop(ControlLoop):
    """Is told with every frame what light it drives through, and how wrong by so many frames."""

    off_frames = 0

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        pair = StepInputs.of(inputs).pair
        now = pair.trigger + self.off_frames
        there = np.clip(np.arange(now - 70, now + 50), 0, len(WAY) - 1)
        return super().step(StepInputs(pair, light_ahead=followed(np.array(WAY)[there], 70, 2.0)))


START = ExposureSetting(300.0, 0.0)
WAY = [8.0] * 70 + [10.0] * 30 + [8.0] * 40 + [14.0] * 60 + [8.0] * 60
"""Levels at which half scale lies: into shade and out of it, then into a tunnel and out of it."""

TUNNEL = 120
"""Frame before its mouth, after the shade, in which nobody knows yet whether to believe what is foretold."""


def bad_frames(loop: ControlLoop, first: int = 60) -> int:
    """Frames more than two stops from half scale, with a camera that shows a decision 8 frames later."""
    levels = run(loop, WAY, START, delay=8)
    return sum(abs(level - light) > 2.0 for level, light in zip(levels[first:], WAY[first:], strict=True))


@pytest.mark.parametrize("off_frames", [-2, 0, 2])
def test_on_a_second_lap_less_than_half_the_frames_are_lost_at_the_mouths(off_frames: int) -> None:
    responses = ResponseFunction.linear()
    told = ToldLoop("belief", responses, LIMITS, START)
    told.off_frames = off_frames
    untold = bad_frames(ControlLoop("belief", responses, LIMITS, START), TUNNEL)
    assert untold >= 16
    assert bad_frames(told, TUNNEL) < 0.5 * untold


def test_to_be_told_of_another_place_costs_no_frame_before_it_was_right_somewhere() -> None:
    responses = ResponseFunction.linear()
    told = ToldLoop("belief", responses, LIMITS, START)
    told.off_frames = 200
    assert bad_frames(told) <= bad_frames(ControlLoop("belief", responses, LIMITS, START))


class TurningLoop(ControlLoop):
    """Turns by 26 pixels in 1/60 s, and is told nothing."""

    def step(self, inputs: StepInputs | FrameSet) -> Decision:
        return super().step(replace(StepInputs.of(inputs), angular_rate_rad_s=3.0))


class ToldTurningLoop(ToldLoop, TurningLoop):
    """Turns as fast, and is told."""


def test_a_turning_camera_believes_no_light_ahead() -> None:
    """What comes into its view looked like a rise of the light on the earlier drive, too."""
    parameters = ControlParameters(focal_length_px=520.0)
    told, untold = (
        run(kind("belief", ResponseFunction.linear(), LIMITS, START, parameters), WAY, START, delay=8)
        for kind in (ToldTurningLoop, TurningLoop)
    )
    assert told == untold


@given(
    levels=st.lists(st.floats(-100, 100), min_size=1, max_size=40),
    spread=st.floats(0, 32),
    changes=st.lists(st.floats(-30, 30), max_size=96),
    frames=st.integers(1, 32),
    belief=st.sampled_from([LEAST_BELIEF, UNPROVEN, MOST_BELIEF]),
)
def test_any_series_and_any_light_give_probabilities(
    levels: list[float], spread: float, changes: list[float], frames: int, belief: float
) -> None:
    foresight = Foresight(belief)
    expected(foresight, followed(np.array(levels), len(levels) // 2, spread), changes, frames)
    assert LEAST_BELIEF <= foresight.belief <= MOST_BELIEF


@pytest.mark.parametrize(
    ("levels", "risen", "now", "spread"),
    [
        ((), (), 0, 1.0),
        ((1.0,), (1.0,), 1, 1.0),
        ((1.0,), (1.0,), 0, float("nan")),
        ((float("inf"),), (0.0,), 0, 1.0),
        ((0.0,), (float("nan"),), 0, 1.0),
        ((0.0,), (0.0, 0.0), 0, 1.0),
    ],
)
def test_a_series_that_makes_no_sense_is_refused(
    levels: tuple[float, ...], risen: tuple[float, ...], now: int, spread: float
) -> None:
    with pytest.raises(ValueError, match=r"frame|spread|level"):
        LightAhead(levels, risen, now, spread)
