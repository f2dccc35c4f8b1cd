"""The policy `belief`: what it remembers, what it plans, and what a reader of docs/understand/policy.md may rely on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.contrast import SensorNoise, contrast
from autoexpose_daemon.control.policies.belief.forecast import Cadence
from autoexpose_daemon.control.policies.belief.policy import BRIGHTNESS_LOSS, Prospects
from autoexpose_daemon.control.policies.belief.scene_belief import BIN, NOTHING, Optics, Outlook, SceneBelief
from evaluation.stage.oracle import Information
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import FrameSet

from .scene import FRAME_NS, LIMITS, LINEAR, START, alike, at_time, drive, expose, radiance, run

NOISE = SensorNoise(10_500.0, 3.0)
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


@pytest.mark.parametrize(("half_scale_level", "least"), [(6.0, 0.8), (10.0, 0.9), (12.0, 0.95), (15.0, 0.95)])
@pytest.mark.parametrize("delay", [1, 3])
def test_it_settles_within_a_few_frames_and_stays(half_scale_level: float, least: float, delay: int) -> None:
    lights = [half_scale_level] * 60
    levels = run(make(), lights, START, delay=delay, scene=SCENE)
    assert np.ptp(levels[20:]) == 0
    assert shares_of_best(levels, lights)[20:].min() > least


def test_limits_may_leave_a_single_exposure() -> None:
    loop = ControlLoop("belief", LINEAR, ExposureLimits(1000.0, 1000.0, 0.0, 0.0), START)
    levels = run(loop, [9.0 + 0.3 * frame for frame in range(10)], START, scene=SCENE)
    assert set(levels) == {START.level}


def test_each_camera_is_seen_with_its_own_setting() -> None:
    """The right one's frame has another exposure: it is no other scene for that."""
    loop, same = make(), make()
    other = ExposureSetting(4000.0, 0.0)
    for index in range(4):
        left, right = (at_time(expose(SCENE, setting, 10.0), index) for setting in (START, other))
        decision = loop.step(FrameSet(index, {"left": left, "right": right}))
        expected = same.step(FrameSet(index, {"left": left, "right": left}))
    assert decision.setting.level == pytest.approx(expected.setting.level, abs=0.6)


def test_light_is_measured_by_the_camera_whose_frame_before_was_not_lost() -> None:
    loop = make()
    belief: Any = loop._policy
    both = ("left", "right")
    for index, cameras in enumerate([both, both, both, ("right",), both, ("left",), both]):
        frame = at_time(expose(SCENE, START, 10.0 - 0.25 * index), index)
        loop.step(FrameSet(index, dict.fromkeys(cameras, frame)))
    assert list(belief.forecast.changes)[-6:] == pytest.approx([0.25] * 6, abs=0.03)


def test_light_is_measured_by_a_camera_at_its_own_setting() -> None:
    """The left one's frame is lost while the right one has another exposure: that is no change of light."""
    loop = make()
    belief: Any = loop._policy
    darker = ExposureSetting(START.exposure_time_us / 2.0, START.gain_db)
    for index, cameras in enumerate(["both", "both", "right", "both"]):
        frames = {
            camera: at_time(expose(SCENE, setting, 10.0), index)
            for camera, setting in (("left", START), ("right", darker))
            if cameras in ("both", camera)
        }
        loop.step(FrameSet(index, frames))
    assert list(belief.forecast.changes)[-3:] == pytest.approx([0.0] * 3, abs=0.03)


X150 = float(np.log2(150))
INFORMATION = Information(LINEAR)


def make() -> ControlLoop:
    return ControlLoop("belief", LINEAR, LIMITS, START)


def worth(level: float, half_scale_level: float, scene: NDArray[np.float64] = SCENE) -> float:
    """Information of a frame."""
    frame = expose(scene, ExposureSetting(float(2.0**level), 0.0), half_scale_level)
    return INFORMATION.measure(contrast(frame.grey8(), INFORMATION.bins), 1.0, 1.0)


@cache
def curve_of_scene() -> tuple[list[float], list[float]]:
    offsets = np.arange(-9, 9, 0.125).tolist()
    return offsets, [worth(11.0 + offset, 11.0) for offset in offsets]


def shares_of_best(levels: list[float], lights: list[float]) -> NDArray[np.float64]:
    """Worth of each frame of `SCENE` as a share of the best possible; a picture depends only on level - light."""
    offsets, values = curve_of_scene()
    return np.asarray(np.interp(np.array(levels) - np.array(lights), offsets, values) / max(values))


def best_worth(light: float, scene: NDArray[np.float64]) -> float:
    """What a frame may be worth at best."""
    return max(worth(level, light, scene) for level in np.arange(light - 9, light + 6, 0.125).tolist())


def settle(shares: NDArray[np.float64]) -> int:
    """The first of ten frames in a row of at least 0.9."""
    return next(index for index in range(len(shares) - 9) if (shares[index : index + 10] >= 0.9).all())


@pytest.mark.parametrize(
    ("light", "reason"),
    [(22.0, "held at the brightest limit"), (-4.0, "held at the darkest limit"), (11.0, "held: the best of the plan")],
)
def test_the_reason_at_a_limit_is_the_limit(light: float, reason: str) -> None:
    decisions: list[Decision] = []
    run(make(), [light] * 60, START, watch=decisions.append)
    assert decisions[-1].reason == reason


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("light", ["up", "down"])
def test_a_step_of_150_is_settled_in_a_few_delays(light: str, delay: int) -> None:
    dim, bright = 15.5, 15.5 - X150
    before, after = (dim, bright) if light == "up" else (bright, dim)
    lights = [before] * 30 + [after] * 40
    levels = run(make(), lights, START, delay=delay, scene=SCENE)
    assert settle(shares_of_best(levels, lights)[30:]) <= 3 * delay + 2


@pytest.mark.parametrize(("begin", "end", "frames", "least"), [(8.0, 15.0, 60, 0.8), (11.0, 14.0, 240, 0.9)])
def test_ramps_and_dusk_are_followed_before_the_picture_suffers(
    begin: float, end: float, frames: int, least: float
) -> None:
    """Dusk, a stop in 1.3 s, is too slow to be led as a ramp, and never enough in one frame to be a change."""
    lights = [begin] * 20 + list(np.linspace(begin, end, frames))
    levels = run(make(), lights, START, scene=SCENE)
    assert shares_of_best(levels, lights)[25:].min() > least


def test_flicker_is_followed_in_phase() -> None:
    lights = [12.0, 12.0, 14.5] * 30
    levels = run(make(), lights, START, scene=SCENE)
    assert shares_of_best(levels, lights)[60:].mean() > 0.9
    assert np.ptp(levels[-3:]) > 1.5


def flash(frame: int, exposure_time_us: float) -> float:
    """Mean light of a lamp that goes out 100 times a second, over an exposure at 60 frames per second, 0 to 1."""
    start = 2 * np.pi * 100 * frame / 60
    swept = 2 * np.pi * 100 * exposure_time_us * 1e-6
    return float(0.5 * (1 - (np.sin(start + swept) - np.sin(start)) / swept))


@pytest.mark.parametrize(("scene", "half_scale_level"), [(1, 9.5), (2, 10.5)])
@pytest.mark.parametrize("delay", [2, 3])
def test_in_light_that_beats_with_the_frames_each_phase_finds_its_exposure(
    scene: int, half_scale_level: float, delay: int
) -> None:
    """Exposures of milliseconds see another part of the flash when they get longer."""
    picture, exposed = radiance(scene, 1.0), []

    def take(index: int, setting: ExposureSetting) -> FrameSet:
        needed = half_scale_level - np.log2(flash(index, setting.exposure_time_us))
        exposed.append(setting.level - needed)
        return alike(expose(picture, setting, needed), index)

    drive(make(), 150, take, delay)
    assert np.mean(np.abs(exposed[90:]) < 1.0) > 0.95


def test_the_maximum_found_is_the_global_one() -> None:
    """Two hills: from the one, the other lies beyond white."""
    scene = radiance(2, 0.4)
    scene[:, 60:] *= 2.0**6
    best = best_worth(14.0, scene)
    levels = run(make(), [14.0] * 50, ExposureSetting(7500.0, 6.0), scene=scene)
    assert worth(levels[-1], 14.0, scene) > 0.95 * best


@pytest.mark.parametrize("below", [6.0, 8.0, 10.0])
def test_a_room_far_below_a_window_is_found_though_it_begins_black(below: float) -> None:
    scene = np.where(np.arange(180) < 50, radiance(1, 1.0), 2.0**-below * radiance(2, 1.0))
    best = best_worth(9.0, scene)
    levels = run(make(), [9.0] * 20, ExposureSetting(512.0, 0.0), scene=scene)
    assert worth(levels[-1], 9.0, scene) > 0.9 * best


def test_a_wall_that_stays_white_is_looked_at_and_then_left_alone() -> None:
    scene = radiance(5, 0.5)
    scene[:, 130:] = 2.0**5
    levels = run(make(), [12.0] * 60, START, scene=scene)
    assert np.ptp(levels[30:]) <= 0.3


def test_the_dark_is_left_even_if_all_was_white_at_the_lowest_exposure_before() -> None:
    """By how much the light has fallen is unknown."""
    lights = [8.0] * 20 + [-3.0] * 20 + [16.0] * 20
    levels = run(make(), lights, START, scene=SCENE)
    assert levels[39] == pytest.approx(LIMITS.darkest.level, abs=0.3)
    assert abs(levels[-1] - 16.0) < 1.5


def test_what_is_decided_refers_to_the_exposure_of_the_frame_itself() -> None:
    """Not to the newest setting: a frame in flight during a write would get the wrong correction."""
    image = expose(SCENE, START, 11.0)
    brighter = replace(image, setting=ExposureSetting(4 * START.exposure_time_us, START.gain_db))
    target = make().step(FrameSet(0, {"left": image})).level
    assert make().step(FrameSet(0, {"left": brighter})).level == pytest.approx(target + 2.0, abs=0.3)


def _last_level(right: NDArray[np.float64]) -> float:
    def take(index: int, setting: ExposureSetting) -> FrameSet:
        left_frame, right_frame = (at_time(expose(scene, setting, 12.0), index) for scene in (SCENE, right))
        return FrameSet(index, {"left": left_frame, "right": right_frame})

    return drive(make(), 30, take, delay=1)[-1].setting.level


def test_a_lamp_in_one_camera_does_not_ruin_the_other() -> None:
    lit = SCENE.copy()
    lit[:60, :90] = 2.0**12
    assert shares_of_best([_last_level(lit)], [12.0])[0] > 0.85


def test_the_needs_of_the_right_camera_count_too() -> None:
    assert _last_level(SCENE / 2.0**1.5) > _last_level(SCENE) + 0.2
