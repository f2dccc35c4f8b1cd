"""The policy `belief`: what it remembers of a scene, what it plans, and both in closed loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import SensorNoise, contrast
from autoexpose_daemon.control.policies.belief.forecast import Cadence
from autoexpose_daemon.control.policies.belief.policy import BRIGHTNESS_LOSS, Belief, Prospects
from autoexpose_daemon.control.policies.belief.scene_belief import BIN, NOTHING, Optics, Outlook, SceneBelief
from evaluation.stage.oracle import Information
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import StereoPair
from imaging.response import ResponseFunction

from .scene import FRAME_NS, LIMITS, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
START = ExposureSetting(1000.0, 0.0)
SCENE = radiance(1, 1.0)
MIDDLE = 11.0


def frame_at(level: float) -> NDArray[np.uint8]:
    """The scene's frame at an exposure level."""
    return expose(SCENE, ExposureSetting(2.0**level, 0.0), MIDDLE).pixels.astype(np.uint8)


def belief_after(*levels: float, relative_light: NDArray[np.float64] | None = None) -> SceneBelief:
    belief = SceneBelief(Optics(LINEAR, NOISE))
    for level in levels:
        belief.pass_time(FRAME_NS * 1e-9, 0.0, 0.0)
        belief.see(contrast(frame_at(level), belief.optics.bins), level, 1.0, 1.0, relative_light)
    return belief


def foretold(belief: SceneBelief, levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Expected information at levels, at a gain of 1."""
    outlook = Outlook.of_levels(levels.size)
    belief.look_out(levels, np.ones(levels.size), None, outlook)
    return outlook.probability @ outlook.information


def test_what_is_remembered_of_a_frame_foretells_what_darker_frames_show() -> None:
    """As the evaluation measures it, which shares no code. These frames have no noise, so somewhat less is foretold."""
    belief, levels, information = belief_after(10.0), np.linspace(8.0, 10.0, 9), Information(LINEAR, NOISE)
    shown = [information.measure(contrast(frame_at(level), information.bins), 1.0, 1.0) for level in levels.tolist()]
    assert foretold(belief, levels) == pytest.approx(shown, rel=0.2)


def test_contrast_that_the_lens_took_counts_as_if_it_were_back() -> None:
    """Half the light through a lens that passes half: front ends see it divided out."""
    plain, darker, divided = (
        foretold(belief_after(level, relative_light=lens), np.array([level]))[0]
        for level, lens in ((9.0, None), (8.0, None), (8.0, np.full(64, 0.5)))
    )
    assert divided == pytest.approx(plain, rel=0.1)
    assert darker < 0.6 * plain


def test_frames_of_two_exposures_are_remembered_together() -> None:
    """Neither alone knows both ends of the scene; what is true is what a frame of that level shows."""
    levels = np.array([7.0, 9.0, 11.0])
    truth = np.array([foretold(belief_after(level), np.array([level]))[0] for level in levels])
    both = foretold(belief_after(12.5, 7.0), levels)
    assert both == pytest.approx(truth, rel=0.15)


@given(st.floats(-8.0, 8.0))
def test_a_change_of_light_moves_what_is_believed_and_changes_nothing_else(stops: float) -> None:
    before, after = belief_after(10.0), belief_after(10.0)
    after.pass_time(0.0, 0.0, stops)
    levels = np.array([9.0, 10.0, 11.0])
    assert abs(after.drift) <= BIN / 2 + 1e-9
    assert foretold(after, levels - stops) == pytest.approx(foretold(before, levels), rel=0.03)


def test_contrast_that_is_there_no_longer_is_soon_not_believed_in() -> None:
    """As when a lamp goes on that one camera sees: what the other one measures says nothing of that."""
    belief, levels = belief_after(*[10.0] * 100), np.array([10.0])
    before = foretold(belief, levels)
    flat = contrast(np.full_like(frame_at(10.0), 128), belief.optics.bins)
    for _ in range(15):
        belief.see(flat, 10.0, 1.0, 1.0)
    assert foretold(belief, levels) < 0.2 * before


def test_mass_is_neither_made_nor_lost() -> None:
    for level in (4.0, 9.0, 14.0, 19.0):
        belief = belief_after(9.0, level)
        assert belief.mass.sum(axis=0) + belief.hidden.sum(axis=0) == pytest.approx(belief.by_cell, rel=0.05, abs=2.0)


def test_looks_that_find_nothing_make_it_unlikely_that_there_is_something() -> None:
    belief = SceneBelief(Optics(LINEAR, NOISE))
    for level in (9.0, 12.0, 15.0, 18.0):
        belief.see(contrast(np.zeros(SCENE.shape, np.uint8), belief.optics.bins), level, 1.0, 1.0)
    assert belief.nothing > 2 * NOTHING
    outlook = Outlook.of_levels(1)
    belief.look_out(np.array([9.0]), np.ones(1), None, outlook)
    assert outlook.probability.sum() == pytest.approx(1.0)


def prospects(worth: NDArray[np.float64], before: float, light: float = 0.0) -> NDArray[np.float64]:
    beyond, rises = 8, light * np.arange(9.0)[None]
    levels = np.arange(-beyond, float(worth.size + beyond))
    no_look = np.zeros(levels.size)
    return Prospects(levels, 1.0, beyond, np.pad(worth, beyond, "edge"), no_look, rises, np.ones(1), before).values()[0]


def test_a_plan_leaps_and_does_not_climb() -> None:
    worth = np.array([0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.0, 0.8])
    assert prospects(worth, before=1.0).argmax() == 6


def test_a_plan_stays_where_little_is_to_be_gained() -> None:
    worth = np.array([0.9, 0.94, 0.97, 0.98, 1.0])
    assert prospects(worth, before=3.0).argmax() in {3, 4}
    assert 1.0 - np.exp(-BRIGHTNESS_LOSS) > 0.4


def test_a_plan_follows_a_ramp_of_light() -> None:
    worth = np.exp(-((np.arange(12.0) - 6.0) ** 2) / 8.0)
    assert prospects(worth, before=6.0, light=-0.5).argmax() > prospects(worth, before=6.0, light=0.5).argmax()


def test_lost_frames_are_counted_by_their_stamps() -> None:
    cadence = Cadence()
    assert [cadence.frames(interval) for interval in (0.02, 0.02, 0.0201, 0.06, 0.0199, 0.04)] == [1, 1, 1, 3, 1, 2]
    assert cadence.frames(0.0) == 1


@pytest.mark.parametrize("half_scale_level", [6.0, 10.0, 15.0])
@pytest.mark.parametrize("delay", [1, 3])
def test_it_settles_within_a_few_frames_and_stays(half_scale_level: float, delay: int) -> None:
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    levels = run(loop, [half_scale_level] * 40, START, delay=delay, scene=SCENE)
    assert np.ptp(levels[20:]) <= 0.3
    assert abs(levels[-1] - half_scale_level) < 1.5


def test_limits_may_leave_a_single_exposure() -> None:
    loop = ControlLoop("belief", LINEAR, ExposureLimits(1000.0, 1000.0, 0.0, 0.0), START)
    levels = run(loop, [9.0 + 0.3 * frame for frame in range(10)], START, scene=SCENE)
    assert set(levels) == {START.level}


def test_each_camera_is_seen_with_its_own_setting() -> None:
    """The right one's frame has another exposure: it is no other scene for that."""
    loop, same = (ControlLoop("belief", LINEAR, LIMITS, START) for _ in range(2))
    other = ExposureSetting(4000.0, 0.0)
    for index in range(4):
        left, right = (at_time(expose(SCENE, setting, 10.0), index) for setting in (START, other))
        decision = loop.step(StereoPair(index, {"left": left, "right": right}))
        expected = same.step(StereoPair(index, {"left": left, "right": left}))
    assert decision.setting.level == pytest.approx(expected.setting.level, abs=0.6)


def test_light_is_measured_by_the_camera_whose_frame_before_was_not_lost() -> None:
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    belief = loop._policy
    assert isinstance(belief, Belief)
    both = ("left", "right")
    for index, sides in enumerate([both, both, both, ("right",), both, ("left",), both]):
        frame = at_time(expose(SCENE, START, 10.0 - 0.25 * index), index)
        loop.step(StereoPair(index, dict.fromkeys(sides, frame)))
    assert list(belief.forecast.changes)[-6:] == pytest.approx([0.25] * 6, abs=0.03)


def test_light_is_measured_by_a_camera_at_its_own_setting() -> None:
    """The left one's frame is lost while the right one has another exposure: that is no change of light."""
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    belief = loop._policy
    assert isinstance(belief, Belief)
    darker = ExposureSetting(START.exposure_time_us / 2.0, START.gain_db)
    for index, sides in enumerate(["both", "both", "right", "both"]):
        frames = {
            side: at_time(expose(SCENE, setting, 10.0), index)
            for side, setting in (("left", START), ("right", darker))
            if sides in ("both", side)
        }
        loop.step(StereoPair(index, frames))
    assert list(belief.forecast.changes)[-3:] == pytest.approx([0.0] * 3, abs=0.03)
