"""What a loop tells of itself: its state, from which another continues, and what a decision rests on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import get_type_hints

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision, Grounds, SceneHistogram
from autoexpose_daemon.control.loop import STATE_FORMAT, ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.picture.image import Rectangle, Region
from autoexpose_daemon.control.policies.belief.scene_belief import DARK_DN
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.control.snapshot import Plain, Stateful, parse, plain, state_names
from autoexpose_daemon.recording.file import from_json, to_json
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, FrameSet
from imaging.geometry import SIDES
from imaging.response import ResponseFunction

from .scene import LIMITS, LINEAR, START, alike, at_time, drive, expose, radiance, run

STEPPED = ExposureLimits(20.0, 7500.0, 0.0, 30.0, 1.0, 0.1)
REGION = Region("control.roi.left", (Rectangle(0, 0, 160, 100, 0.5), Rectangle(8, 8, 100, 80, 1.0)), 0.1)


def regions_for(shape: tuple[int, int]) -> dict[CameraName, Region]:
    mask = np.full(shape, 200, np.uint8)
    mask[:, :40] = 0
    return {"left": REGION, "right": Region("control.roi.right", (), 0.0, mask)}


def through_json(data: Plain) -> Plain:
    text = to_json(data)
    again: Plain = from_json(text)
    assert to_json(again) == text
    return again


@dataclass(frozen=True)
class Course:
    """What a loop goes through, and after how many steps its state is taken."""

    seed: int
    before: int = 0
    moving: bool = True
    region: bool = False
    parameters: ControlParameters = field(default_factory=ControlParameters)
    shape: tuple[int, int] = (136, 180)

    def takes(self) -> Callable[[int, ExposureSetting], FrameSet]:
        """Pairs of a scene whose light and place change."""
        rng = np.random.default_rng(self.seed)
        scenes = {camera: radiance(self.seed + i, 1.2 - 0.4 * i, self.shape) for i, camera in enumerate(SIDES)}
        light = float(rng.uniform(8, 18))

        def take(index: int, setting: ExposureSetting) -> FrameSet:
            nonlocal light
            light += float(rng.choice([0.0, 0.0, 0.0, 0.15, rng.normal(0, 2)]))
            shift = index * 3 if self.moving else 0
            frames = {
                camera: at_time(expose(np.roll(scene, shift, axis=1), setting, light), index)
                for camera, scene in scenes.items()
            }
            if rng.random() < 0.1:
                del frames["right"]
            return FrameSet(index, frames)

        return take


PARAMETERS = st.builds(
    ControlParameters,
    motion=st.sampled_from(["tiles", "farneback"]),
    flicker_hz=st.sampled_from([100.0, None]),
    bracket=st.sampled_from([None, None, Bracketing(4, 4.0, keep=True)]),
)
COURSES = st.builds(
    Course,
    seed=st.integers(0, 1000),
    before=st.integers(0, 40),
    moving=st.booleans(),
    region=st.booleans(),
    parameters=PARAMETERS,
    shape=st.sampled_from([(136, 180), (101, 403)]),
)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
@settings(max_examples=4, deadline=None)
@given(course=COURSES)
def test_a_restored_loop_decides_bit_for_bit_the_same(policy_id: str, course: Course) -> None:
    regions, take = regions_for(course.shape) if course.region else {}, course.takes()
    loop = ControlLoop(policy_id, ResponseFunction.linear(2), STEPPED, START, course.parameters, regions=regions)
    other = ControlLoop(parse(through_json(plain(loop.setup)), ControlSetup))
    shown: list[FrameSet] = []

    def show(index: int, setting: ExposureSetting) -> FrameSet:
        if index == course.before:
            other.restore(through_json(loop.state()))
        shown.append(take(index, setting))
        return shown[-1]

    decisions = drive(loop, course.before + 30, show)
    assert [other.step(pair) for pair in shown[course.before :]] == decisions[course.before :]
    assert to_json(other.state()) == to_json(loop.state())


def stateful_in(holder: Stateful) -> Iterator[Stateful]:
    """An object and all whose states are part of its own."""
    yield holder
    for name in state_names(type(holder)):
        value = getattr(holder, name)
        for inside in value.values() if isinstance(value, dict) else (value,):
            if isinstance(inside, Stateful):
                yield from stateful_in(inside)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_nothing_is_replaced_but_the_state_and_what_is_said_to_be_none(policy_id: str) -> None:
    """A name that is not annotated would be missing from snapshots."""
    parameters = ControlParameters(flicker_hz=None, bracket=Bracketing(2, 2.0, keep=True))
    loop = ControlLoop(policy_id, ResponseFunction.linear(), STEPPED, START, parameters)

    def others() -> list[dict[str, object]]:
        return [
            {
                name: value
                for name, value in getattr(each, "__dict__", {}).items()
                if name not in get_type_hints(type(each))
            }
            for each in stateful_in(loop)
        ]

    before = others()
    drive(loop, 12, Course(3).takes())
    for made, now in zip(before, others(), strict=True):
        assert now.keys() == made.keys() and all(now[name] is made[name] for name in made)


def test_a_state_once_taken_does_not_change() -> None:
    loop = ControlLoop("belief", ResponseFunction.linear(), STEPPED, START)
    taken: list[tuple[Plain, str]] = []
    drive(loop, 30, Course(3).takes(), watch=lambda _: taken.append((state := loop.state(), to_json(state))))
    assert all(to_json(state) == text for state, text in taken)


def test_the_state_is_what_its_format_says() -> None:
    """A change here changes what a recording holds: give `STATE_FORMAT` another number."""
    states = {policy_id: ControlLoop(policy_id, ResponseFunction.linear(), STEPPED, START) for policy_id in POLICY_IDS}
    names = {policy_id: sorted(state) for policy_id, loop in states.items() if (state := _policy_state(loop))}
    assert STATE_FORMAT == "autoexpose-control/15"
    assert set(states["fixed"].state()) == {"past", "motions", "motion_camera", "motion_px", "policy", "flicker"}
    assert names == {
        "neves2009": ["previous_error"],
        "lu2010": ["best_level", "best_value", "held", "query", "reference", "step", "turned"],
        "kim2018": ["held", "levels", "query", "reference", "values"],
        "shin2019": ["held", "queries", "query", "reference", "search"],
        "begin2022-code": ["scores"],
        "majer2018-standard": ["frames", "level"],
        "majer2018-full": ["frames", "level"],
        "berthold2013": ["past", "target"],
        "tomasi2021": ["past", "target"],
        "zhang2024": ["past", "target"],
        "belief": ["beliefs", "cadence", "forecast", "foresight", "latency", "registrations", "seen_ns"],
    }


def _policy_state(loop: ControlLoop) -> dict[str, Plain]:
    state = loop.state()["policy"]
    assert isinstance(state, dict)
    return state


@pytest.mark.parametrize(
    ("key", "value", "complaint"),
    [
        ("held", 3, "Held needs target, expected, value, mean, not 3"),
        ("levels", [1.0, "two"], "'two' is no float"),
        ("levels", {"a": 1.0}, "a dict is no list"),
        ("query", {"level": 1.0}, "Target needs level, reason, predicted_metric, exposure_time_us, not level"),
        ("surprise", 1, "Kim2018 needs query, held, reference, levels, values, not .*surprise"),
    ],
)
def test_a_state_that_does_not_fit_is_refused(key: str, value: Plain, complaint: str) -> None:
    loop = ControlLoop("kim2018", ResponseFunction.linear(), STEPPED, START)
    state = loop.state()
    policy = state["policy"]
    assert isinstance(policy, dict)
    policy[key] = value
    with pytest.raises(ValueError, match=complaint):
        loop.restore(state)


@given(st.text() | st.recursive(st.none() | st.integers() | st.floats() | st.text(), st.lists).map(to_json))
def test_any_other_text_is_refused_or_parsed_as_data(text: str) -> None:
    try:
        data = from_json(text)
        parse(data, ControlSetup)
    except ValueError:
        return
    raise AssertionError(f"{text!r} passed for the setup of a loop")


HALF_SCALE = 10.0
WINDOW = radiance(1, 0.5)

WINDOW[:, 100:] *= 2.0**6

RAMP = np.tile(np.exp2(np.linspace(-5.0, 3.0, WINDOW.shape[1])), (WINDOW.shape[0], 1))
"""From dark to bright, without edges, at which pixels are mixtures."""


def loop_of(policy_id: str = "belief") -> ControlLoop:
    return ControlLoop(policy_id, LINEAR, LIMITS, START)


def asked(loop: ControlLoop) -> Grounds:
    grounds = loop.grounds
    assert grounds is not None
    return grounds


def seen(*settings: ExposureSetting) -> tuple[SceneHistogram, NDArray[np.generic]]:
    """What frames of the ramp leave, and the pixels of the last."""
    loop = loop_of()
    for index, setting in enumerate(settings):
        frame = expose(RAMP, setting, HALF_SCALE)
        loop.step(alike(frame, index))
    return asked(loop).scenes["left"], frame.pixels


def middles(scene: SceneHistogram) -> NDArray[np.float64]:
    return scene.start + scene.bin_stops * (np.arange(len(scene.known)) + 0.5)


@pytest.mark.parametrize("time_us", [30.0, 300.0, 1000.0, 7000.0])
def test_what_is_known_and_guessed_is_the_whole_picture(time_us: float) -> None:
    scene, grey = seen(ExposureSetting(time_us, 0.0))
    clipped = np.mean((grey <= DARK_DN) | (grey == 255))
    assert sum(scene.known) + sum(scene.guessed) == pytest.approx(1.0, abs=0.05)
    assert sum(scene.guessed) == pytest.approx(clipped, abs=0.05)
    assert sum(scene.contrast) == pytest.approx(1.0, abs=1e-3)
    assert len(scene.known) == len(scene.guessed) == len(scene.contrast)


def test_a_frame_is_white_from_its_level_on_and_knows_what_lies_below() -> None:
    """Its grey levels tell the same: a pixel at half scale lies one stop below white."""
    setting = ExposureSetting(1000.0, 6.0)
    scene, grey = seen(setting)
    assert scene.white == pytest.approx(-setting.level, abs=0.05)
    assert 6.0 < scene.white - scene.black < 9.0
    known, places = np.array(scene.known), middles(scene)
    inside = (places > scene.black - scene.bin_stops) & (places < scene.white + scene.bin_stops)
    assert known[inside].sum() == pytest.approx(known.sum())
    bright = places > scene.white - 1.0
    assert known[bright].sum() == pytest.approx(np.mean((grey > 127) & (grey < 255)), abs=0.05)
    beyond = np.array(scene.guessed)[places > scene.white].sum()
    assert beyond == pytest.approx(np.mean(grey == 255), abs=0.05)


def test_frames_of_several_exposures_together_know_the_light_of_the_scene() -> None:
    """As its painter knows it: the distribution of log radiance over the picture."""
    scene, _ = seen(*(ExposureSetting(time_us, 0.0) for time_us in (30.0, 400.0, 6000.0)))
    painted = np.log2(RAMP / 2.0) - HALF_SCALE
    below = middles(scene) + scene.bin_stops / 2
    shares = [np.mean(painted < bound) for bound in below]
    assert np.cumsum(scene.known) == pytest.approx(shares, abs=0.05)


def test_what_is_decided_is_the_best_of_the_values_and_a_look_fills_the_histogram() -> None:
    loop = loop_of()
    guessed: list[float] = []

    def watch(decision: Decision) -> None:
        grounds = asked(loop)
        assert grounds.best_level == pytest.approx(decision.level)
        assert max(grounds.value) == grounds.value[grounds.levels.index(grounds.best_level)]
        assert 0.0 <= min(grounds.worth) <= max(grounds.worth) <= 1.0 + 1e-9
        guessed.append(sum(grounds.scenes["left"].guessed))

    levels = run(loop, [HALF_SCALE] * 12, ExposureSetting(2000.0, 0.0), scene=WINDOW, watch=watch)
    assert guessed[0] > 0.4
    assert guessed[-1] < 0.1
    assert min(levels) < levels[0] - 2.0
    assert asked(loop).level == levels[-1]


def test_asking_changes_no_decision() -> None:
    lights = [*[HALF_SCALE] * 6, *[HALF_SCALE + 4.0] * 6]
    quiet, watched = loop_of(), loop_of()
    alone = run(quiet, lights, START, scene=WINDOW)
    assert run(watched, lights, START, scene=WINDOW, watch=lambda _: watched.grounds and None) == alone


def test_other_policies_have_none_and_the_belief_none_before_its_first_decision() -> None:
    loop = loop_of("neves2009")
    run(loop, [HALF_SCALE], START)
    assert loop.grounds is None
    assert loop_of().grounds is None
