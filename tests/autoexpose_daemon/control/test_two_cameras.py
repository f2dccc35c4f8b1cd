"""Each camera has its own region, response and history; a faulty one does not spoil the exposure of the other."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.picture.image import ImagePreparation, Region
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
from imaging.response import ResponseFunction

from .scene import FRAME_NS, LIMITS, LINEAR, START, at_time, drive, expose, radiance

POLICY = "belief"
"""The one that looks at both cameras."""

SEARCHES = ["lu2010", "kim2018", "shin2019"]
"""Those that compare the frames of one."""

LOST = "held: a camera's frame is lost"
SHAPE = (136, 180)
SCENES: dict[CameraName, NDArray[np.float32]] = {
    "left": radiance(1, 1.2, SHAPE).astype(np.float32),
    "right": radiance(2, 1.0, SHAPE).astype(np.float32),
}

NOISE = np.random.default_rng(3).standard_normal((31, *SHAPE), np.float32)
"""The cameras take them in turn: an odd number, so that it is long until both are where they were."""

BRIGHTEST = ExposureSetting(7500.0, 24.0)
LIGHT = 11.0
DELAY = 2
FRAMES = 60
SETTLED = 45
"""From here on everything must be in order; a camera that is white is given half a second before that."""

CLOCKS_NS: dict[CameraName, int] = {"left": 0, "right": 40_000_000_000}
"""Each camera has its own clock, which began when it got power."""

Image = NDArray[np.uint8]
Fault = Callable[[Image, Image], Image]
"""What a faulty camera sends, from its first and its present image."""

FAULTS: dict[str, Fault] = {
    "black": lambda first, now: np.zeros_like(now),
    "white": lambda first, now: np.full_like(now, 255),
    "frozen": lambda first, now: first,
}


class Rig:
    """Two noisy linear cameras and a loop that decides for both."""

    def __init__(self, policy_id: str, moving: bool, start: ExposureSetting = START) -> None:
        self.loop = ControlLoop(policy_id, ResponseFunction.linear(), LIMITS, start)
        self.loop.metric_asked = True
        self.decisions: list[Decision] = []
        self.images: dict[CameraName, list[Image]] = {camera: [] for camera in SIDES}
        self.settings = [start] * DELAY
        self._speed_px = 3 if moving else 0
        self._preparation, self._metric = ImagePreparation(), GradientMetric()

    def run(
        self,
        frames: int,
        camera: CameraName = "right",
        *,
        fault: Fault = lambda first, now: now,
        darker: float = 0.0,
        light: float = LIGHT,
        only: CameraName | None = None,
    ) -> None:
        """So many frames with a fault of one camera, or one that sees everything so many stops darker."""
        for _ in range(frames):
            number = len(self.decisions)
            setting = self.settings[number]
            pair = {}
            for each in SIDES:
                image = self._expose(each, setting, light + darker * (each == camera), number)
                self.images[each].append(image)
                pixels = fault(self.images[each][0], image) if each == camera else image
                if only in (None, each):
                    pair[each] = Frame(pixels, 8, number, number * FRAME_NS + CLOCKS_NS[each], 0, 0, setting)
            self.decisions.append(self.loop.step(FrameSet(number, pair)))
            self.settings.append(self.decisions[-1].setting)

    def metrics(self, camera: CameraName, since: int, until: int | None = None) -> list[float]:
        """M_g of what a camera saw, whether or not that is what it sent, in some of the frames."""
        images = self.images[camera][since:until]
        return [self._metric.measure(self._preparation.prepare(image)) for image in images]

    def _expose(self, camera: CameraName, setting: ExposureSetting, light: float, number: int) -> Image:
        grey = np.roll(SCENES[camera], self._speed_px * number, axis=1) * (127.5 * 2.0 ** (setting.level - light))
        noise = NOISE[(2 * number + SIDES.index(camera)) % len(NOISE)] * (0.5 + 0.1 * 10 ** (setting.gain_db / 20))
        return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


def other_of(camera: CameraName) -> CameraName:
    return "left" if camera == "right" else "right"


@cache
def healthy(moving: bool, light: float = LIGHT, only: CameraName | None = None) -> Rig:
    """A rig without a fault, settled; or one camera of it."""
    rig = Rig(POLICY, moving)
    rig.run(30, light=light, only=only)
    return rig


@cache
def healthy_metric(camera: CameraName, moving: bool, light: float = LIGHT) -> float:
    """M_g of a camera in a healthy pair; or alone, if that is less, since it is not what the policy goes by."""
    rigs = (healthy(moving, light, only) for only in (None, camera))
    return min(float(np.mean(rig.metrics(camera, -10))) for rig in rigs)


moving_or_still = pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])


@moving_or_still
@pytest.mark.parametrize("camera", SIDES)
@pytest.mark.parametrize("fault", FAULTS)
def test_the_good_camera_is_exposed_as_beside_a_healthy_one_and_follows_steps_of_light_alone(
    fault: str, camera: CameraName, moving: bool
) -> None:
    good = other_of(camera)
    wanted = 0.9 * healthy_metric(good, moving)
    rig = Rig(POLICY, moving, BRIGHTEST if moving else START)
    rig.run(FRAMES, camera, fault=FAULTS[fault])
    assert np.mean(rig.metrics(good, SETTLED)) > wanted
    assert np.mean(rig.metrics(good, 8, 28)) > wanted
    for light in (LIGHT + 4.0, LIGHT - 3.0):
        rig.run(20, camera, fault=FAULTS[fault], light=light)
        assert np.mean(rig.metrics(good, -5)) > 0.9 * healthy_metric(good, moving, light)


@moving_or_still
@pytest.mark.parametrize("camera", SIDES)
def test_of_two_cameras_8_stops_apart_the_brighter_is_exposed_well(camera: CameraName, moving: bool) -> None:
    """From any start: from above, the brighter one is white at first, and the other well exposed."""
    good = other_of(camera)
    wanted = 0.9 * healthy_metric(good, moving)
    for start in (START, BRIGHTEST):
        rig = Rig(POLICY, moving, start)
        rig.run(FRAMES, camera, darker=8.0)
        assert np.mean(rig.metrics(good, SETTLED)) > wanted


@moving_or_still
@pytest.mark.parametrize("camera", SIDES)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_camera_that_recovers_is_counted_again_and_disturbs_nothing(
    fault: str, camera: CameraName, moving: bool
) -> None:
    rig, good = Rig(POLICY, moving), other_of(camera)
    rig.run(10)
    rig.run(FRAMES, camera, fault=FAULTS[fault])
    if fault == "frozen":  # found when exposure moves
        rig.run(20, camera, fault=FAULTS[fault], light=LIGHT - 1.0)
    assert set(rig.loop.uncounted) == {camera}
    assert f"{camera} camera" in rig.decisions[-1].reason
    before = len(rig.decisions)
    wanted = 0.9 * np.mean(rig.metrics(good, -5))
    rig.run(33, light=LIGHT - 1.0 if fault == "frozen" else LIGHT)
    assert rig.loop.uncounted == {}
    assert rig.decisions[-1].reason.count("camera") == 0
    assert min(rig.metrics(good, before)) > wanted


@moving_or_still
def test_in_a_dark_room_both_cameras_count_and_find_out(moving: bool) -> None:
    rig = Rig(POLICY, moving, ExposureSetting(20.0, 0.0))
    rig.run(16, light=14.0)
    assert rig.loop.uncounted == {}
    assert min(rig.metrics("left", -5)) > 0.9 * healthy_metric("left", moving, 14.0)


def test_a_dead_reference_gives_its_place_to_the_other_camera() -> None:
    """Its frames would hide the motion: the exposure time is that of a rig whose cameras both see it."""
    motion_px = healthy(moving=True).decisions[-1].motion_px
    rig = Rig(POLICY, moving=True)
    rig.run(30, "left", fault=FAULTS["black"])
    assert motion_px > 2.0
    assert rig.decisions[-1].motion_px == pytest.approx(motion_px, rel=0.2)
    assert rig.decisions[-1].metric == pytest.approx(rig.metrics("right", -1)[0])


@pytest.mark.parametrize("only", SIDES)
def test_lone_frames_in_between_change_nothing(only: CameraName) -> None:
    rig = Rig(POLICY, moving=False)
    rig.run(20, "right", fault=FAULTS["black"])
    rig.run(5, "right", fault=FAULTS["black"], only=only)
    rig.run(10, "right", fault=FAULTS["black"])
    assert np.ptp([setting.level for setting in rig.settings[18:]]) < 0.3


@moving_or_still
@pytest.mark.parametrize("only", SIDES)
def test_a_lost_frame_of_one_camera_moves_nothing(only: CameraName, moving: bool) -> None:
    """What is known of that camera is as good as before; nothing is looked at again."""
    rig, undisturbed = Rig(POLICY, moving), Rig(POLICY, moving)
    undisturbed.run(70)
    rig.run(50)
    rig.run(1, only=only)
    rig.run(19)
    assert rig.decisions[50].reason.startswith("held")
    levels, wanted = ([decision.level for decision in each.decisions[50:]] for each in (rig, undisturbed))
    assert np.abs(np.subtract(levels, wanted)).max() < (0.5 if moving else 0.1)


@pytest.mark.parametrize("only", SIDES)
def test_a_camera_that_is_gone_is_not_waited_for(only: CameraName) -> None:
    rig = Rig(POLICY, moving=False)
    rig.run(20)
    rig.run(40, light=LIGHT + 3.0, only=only)
    assert np.mean(rig.metrics(only, -10)) > 0.9 * healthy_metric(only, False, LIGHT + 3.0)


@pytest.mark.parametrize("policy_id", SEARCHES)
def test_a_search_that_rests_goes_on_resting_when_frames_of_its_camera_are_lost(policy_id: str) -> None:
    rig, undisturbed = Rig(policy_id, moving=False), Rig(policy_id, moving=False)
    undisturbed.run(140)
    rig.run(100)
    rig.run(3, only="right")
    rig.run(37)
    assert [decision.reason for decision in rig.decisions[100:103]] == [LOST] * 3
    assert rig.settings == undisturbed.settings


@pytest.mark.parametrize("policy_id", SEARCHES)
def test_a_search_learns_nothing_from_a_frame_of_the_other_camera(policy_id: str) -> None:
    rig = Rig(policy_id, moving=False)
    rig.run(6)
    before = rig.loop.state()["policy"]
    rig.run(1, only="right")
    after = rig.loop.state()["policy"]
    assert isinstance(before, dict) and isinstance(after, dict)
    assert after == {**before, "reference": {"camera": "left", "missed": 1}}
    assert rig.settings[-1] == rig.settings[-2]


@pytest.mark.parametrize("policy_id", SEARCHES)
def test_a_search_goes_on_with_the_camera_that_is_left(policy_id: str) -> None:
    rig = Rig(policy_id, moving=False)
    rig.run(100)
    rig.run(12, light=LIGHT + 3.0, only="right")
    assert rig.decisions[-1].reason == LOST
    rig.run(120, light=LIGHT + 3.0, only="right")
    assert all(decision.reason != LOST for decision in rig.decisions[112:])
    assert rig.settings[-1].level - rig.settings[101].level == pytest.approx(3.0, abs=1.2)
    rig.run(1, light=LIGHT + 3.0)
    assert rig.decisions[-1].reason != LOST


GAMMA = ResponseFunction(2.0 * np.log2(np.arange(256).clip(1) / 255), 16, 255)
"""Grey levels follow the root of the light, above a black level of 16."""


def half_masked(camera: CameraName, columns: slice, shape: tuple[int, int] = SHAPE) -> Region:
    mask = np.zeros(shape, np.uint8)
    mask[:, columns] = 255
    return Region(f"control.roi.{camera}", mask=mask)


def test_a_lone_right_frame_is_judged_in_its_own_region() -> None:
    """The left camera looks at the left half only, the right one at the right half, where nothing is saturated."""
    regions: dict[CameraName, Region] = {
        "left": half_masked("left", slice(0, 80)),
        "right": half_masked("right", slice(100, 180)),
    }
    loop = ControlLoop("belief", LINEAR, LIMITS, START, regions=regions)
    light = radiance(1, 0.8, SHAPE)
    light[:, :90] = 1000.0
    alone = loop.step(FrameSet(0, {"right": expose(light, START, START.level)}))
    assert alone.saturated_share < 0.1
    assert alone.setting.level > START.level - 2.0


def test_a_lone_right_frame_may_have_another_size_than_the_left_mask() -> None:
    regions: dict[CameraName, Region] = {"left": half_masked("left", slice(0, 80), (270, 360))}
    loop = ControlLoop("belief", LINEAR, LIMITS, START, regions=regions)
    loop.step(FrameSet(0, {"right": expose(radiance(1), START, START.level)}))


def test_motion_is_not_measured_between_two_cameras() -> None:
    """Left and right see different things: flow between them would be large, and the exposure time cut."""
    loop = ControlLoop("belief", LINEAR, LIMITS, START)
    scenes: dict[CameraName, Frame] = {
        "left": expose(radiance(1), START, START.level),
        "right": expose(radiance(2), START, START.level),
    }
    shown: list[tuple[CameraName, ...]] = [("left", "right")] * 6 + [("right",), ("right",), ("left",)]
    for index, cameras in enumerate(shown):
        pair = FrameSet(index, {camera: at_time(scenes[camera], index) for camera in cameras})
        assert loop.step(pair).motion_px < 1


def test_a_camera_that_takes_over_inherits_the_last_speed() -> None:
    loop, scene = ControlLoop("belief", LINEAR, LIMITS, START), radiance(3, 1.0, SHAPE)

    def speed_px(index: int, *cameras: CameraName) -> float:
        moved = at_time(expose(np.roll(scene, 2 * index, axis=1), START, START.level), index)
        return loop.step(FrameSet(index, dict.fromkeys(cameras, moved))).motion_px

    speeds_px = [speed_px(index, "left", "right") for index in range(5)]
    assert speeds_px[0] == 0.0 and speeds_px[4] > 1.0
    assert speed_px(5, "right") == speeds_px[4]


@pytest.mark.parametrize("policy_id", ["belief", "begin2022", "majer2018-full"])
def test_a_lone_right_frame_is_predicted_by_its_own_response(policy_id: str) -> None:
    frame = expose(radiance(1, 1.5, SHAPE), START, START.level + 1.5)

    def decide(responses: dict[CameraName, ResponseFunction], camera: CameraName) -> float:
        return ControlLoop(policy_id, responses, LIMITS, START).step(FrameSet(0, {camera: frame})).level

    other: dict[CameraName, ResponseFunction] = {"left": GAMMA, "right": LINEAR}
    assert decide(other, "right") == decide({"left": LINEAR, "right": LINEAR}, "left")
    assert decide(other, "left") == decide({"left": GAMMA, "right": GAMMA}, "right")
    assert decide(other, "left") != decide(other, "right")


def test_in_a_pair_the_right_frame_is_predicted_by_its_own_response() -> None:
    dim = radiance(1, 1.5, SHAPE) / 4

    def decide(response: ResponseFunction) -> float:
        loop = ControlLoop("belief", {"left": LINEAR, "right": response}, LIMITS, START)
        left, right = (expose(light, START, START.level) for light in (dim * 2, dim))
        return loop.step(FrameSet(0, {"left": left, "right": right})).level

    assert decide(LINEAR) != decide(GAMMA)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_equal_frames_lead_to_equal_decisions_whichever_camera_took_them(policy_id: str) -> None:
    scene, settings = radiance(4, 1.0, SHAPE), []
    for camera in SIDES:

        def take(index: int, setting: ExposureSetting, camera: CameraName = camera) -> FrameSet:
            frame = expose(np.roll(scene, 2 * index, axis=1), setting, START.level + 2.0)
            return FrameSet(index, {camera: at_time(frame, index)})

        decisions = drive(ControlLoop(policy_id, LINEAR, LIMITS, START), 12, take, delay=1)
        settings.append([decision.setting for decision in decisions])
    assert settings[0] == settings[1]
