"""One step after another: what any policy gets, and what leaves the loop."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import BalanceId, ControlParameters, MotionId
from autoexpose_daemon.control.picture.image import ImagePreparation, Rectangle, Region
from autoexpose_daemon.control.picture.motion import FarnebackMotion, Motion, TileMotion
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from autoexpose_daemon.control.step import StepInputs
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

from .scene import FRAME_NS, LIMITS, LINEAR, START, alike, at_time, expose, radiance, run

X150 = float(np.log2(150))


def make(policy_id: str, limits: ExposureLimits = LIMITS) -> ControlLoop:
    return ControlLoop(policy_id, LINEAR, limits, START)


@pytest.mark.parametrize("delay", [1, 2, 3])
@pytest.mark.parametrize("light", ["up", "down"])
def test_neves_settles_x150_within_a_second_without_swinging(light: str, delay: int) -> None:
    dim, bright = 15.0, 15.0 - X150  # level of half scale
    before, after = (dim, bright) if light == "up" else (bright, dim)
    levels = run(make("neves2009"), [before] * 90 + [after] * 90, START, delay=delay)
    was, end = levels[89], levels[-1]
    assert abs(end - was) == pytest.approx(X150, abs=0.3)
    settled = levels[90 + 60 - 10 :]
    assert max(settled) - min(settled) < 0.25
    overshoot = max(levels[90:]) - end if end > was else end - min(levels[90:])
    assert overshoot < 0.25


@pytest.mark.parametrize("policy_id", ["majer2018-standard", "majer2018-full"])
def test_majer_converges_to_half_brightness(policy_id: str) -> None:
    levels = run(make(policy_id), [14.0] * 100, START, scene=radiance(2, 0.3))
    assert np.ptp(levels[-20:]) < 0.05
    assert levels[-1] == pytest.approx(14.0, abs=0.3)


@pytest.mark.parametrize("policy_id", ["fixed", "majer2018-fixed"])
def test_fixed_never_moves(policy_id: str) -> None:
    decisions: list[Decision] = []
    start = ExposureSetting(1000.0, 5.0)
    loop = ControlLoop(policy_id, LINEAR, LIMITS, start)
    run(loop, [15.0] * 10 + [8.0] * 10, start, watch=decisions.append)
    for decision in decisions:
        assert decision.setting.exposure_time_us == pytest.approx(1000.0)
        assert decision.setting.gain_db == pytest.approx(5.0)


def test_the_reason_names_a_limit() -> None:
    decisions: list[Decision] = []
    run(make("neves2009"), [40.0] * 30, START, watch=decisions.append)
    assert decisions[-1].reason == "mean below target; held at the brightest limit"
    assert decisions[-1].level == LIMITS.brightest.level
    assert decisions[-1].black_share == 1


@pytest.mark.parametrize("policy_id", ["begin2022", "neves2009"])
def test_deeper_pixels_give_the_same_decision(policy_id: str) -> None:
    rng = np.random.default_rng(6)
    deep = rng.integers(0, 4096, (136, 180)).astype(np.uint16)

    def decide(frame: Frame) -> Decision:
        return make(policy_id).step(FrameSet(0, {"left": frame}))

    eight = decide(Frame((deep >> 4).astype(np.uint8), 8, 0, 0, 0, 0, START))
    assert decide(Frame(deep, 12, 0, 0, 0, 0, START)) == eight
    assert decide(Frame(deep << np.uint16(4), 16, 0, 0, 0, 0, START)) == eight


@pytest.mark.parametrize(("policy_id", "stops"), [("neves2009", 1e-6), ("belief", 0.6)])
def test_frames_in_flight_are_not_corrected_twice(policy_id: str, stops: float) -> None:
    loop, frame = make(policy_id), expose(radiance(4, 0.3), START, 12.0)
    assert np.ptp([loop.step(alike(frame, index)).level for index in range(4)]) < stops


def test_the_left_frame_decides_even_if_the_right_one_differs() -> None:
    left = expose(radiance(7), START, 12.0)
    right = expose(radiance(8), ExposureSetting(30.0, 20.0), 5.0)
    both, alone = FrameSet(0, {"left": left, "right": right}), FrameSet(0, {"left": left})
    assert make("begin2022").step(both) == make("begin2022").step(alone)


@pytest.mark.parametrize(
    ("name", "value"),
    [("metric_delta", 1.0), ("balance_weight", 0.0), ("mean_target", math.nan), ("flicker_hz", 0.0)],
)
def test_a_parameter_out_of_bounds_is_named(name: str, value: float) -> None:
    with pytest.raises(ConfigurationError, match=name):
        ControlParameters(**{name: value})


@pytest.mark.parametrize(
    ("balance", "gain_db"),
    [("exposure_priority", 0.0), ("blur_noise", 26.02), ("fixed_ratio", 9.36), ("policy", 26.02)],
)
def test_the_balance_can_be_chosen(balance: BalanceId, gain_db: float) -> None:
    setting = ExposureSetting(2.0**11, 0.0)
    loop = ControlLoop("begin2022", LINEAR, LIMITS, setting, ControlParameters(balance=balance))
    black = Frame(np.zeros((136, 180), np.uint8), 8, 0, 0, 0, 0, setting)
    decision = loop.step(FrameSet(0, {"left": black}))
    assert decision.level == pytest.approx(11)
    assert decision.setting.gain_db == pytest.approx(gain_db, abs=0.1)


@pytest.mark.parametrize(
    ("policy_id", "motion", "flow"),
    [
        ("begin2022", "policy", FarnebackMotion),
        ("neves2009", "policy", TileMotion),
        ("belief", "policy", TileMotion),
        ("begin2022", "tiles", TileMotion),
        ("neves2009", "farneback", FarnebackMotion),
    ],
)
def test_the_flow_can_be_chosen(policy_id: str, motion: MotionId, flow: type[Motion]) -> None:
    frames = [at_time(expose(np.roll(radiance(5, 1.0, (540, 720)), 6 * i, 1), START, 11.0), i) for i in range(2)]
    loop = ControlLoop(policy_id, LINEAR, LIMITS, START, ControlParameters(motion=motion))
    expected, preparation = flow(LINEAR), ImagePreparation()
    for index, frame in enumerate(frames):
        speed = expected.measure(
            preparation.prepare(frame.grey8(), filtered=policy_id != "belief"), 720, START.level, frame.device_time_ns
        )
        assert loop.step(FrameSet(index, {"left": frame})).motion_px == pytest.approx(speed or 0.0, rel=1e-6)


def test_an_angular_rate_replaces_the_flow() -> None:
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(focal_length_px=860.0))
    frame = expose(radiance(5), START, 11.0)
    # 30 degrees a second at a focal length of 860 pixels: 450 pixels a second
    assert loop.step(StepInputs(FrameSet(0, {"left": frame}), -np.pi / 6)).motion_px == pytest.approx(7.505, abs=1e-3)
    for rate in (float("nan"), 101.0):
        with pytest.raises(ConfigurationError, match="give at most 100 rad/s"):
            loop.step(StepInputs(FrameSet(2, {"left": frame}), rate))
    with pytest.raises(ConfigurationError, match="focal_length_px"):
        make("begin2022").step(StepInputs(FrameSet(0, {"left": frame}), 0.5))


@pytest.mark.parametrize("before", [0, 2])
def test_where_flow_takes_over_from_angular_rates_the_last_speed_holds_for_a_frame(before: int) -> None:
    """However near the last frame that flow has seen: across fast frames in between it would measure too little."""
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(focal_length_px=600.0))
    scene = radiance(5, 1.0, (540, 720))
    rates = [*[None] * before, 2.0, 1.5, None, None]
    frames = (expose(np.roll(scene, 8 * index, 1), START, 11.0) for index in range(len(rates)))
    pairs = (alike(frame, index) for index, frame in enumerate(frames))
    speeds_px = [loop.step(StepInputs(*inputs)).motion_px for inputs in zip(pairs, rates, strict=True)]
    assert speeds_px[before : before + 3] == [20.0, 15.0, 15.0]
    assert speeds_px[-1] == pytest.approx(8, rel=0.1)
    if before:
        assert speeds_px[:2] == [0.0, pytest.approx(8, rel=0.1)]


@pytest.mark.parametrize("regions", [{}, {"left": Region("roi", (Rectangle(0, 0, 720, 270, 0.5),), 0.1)}])
def test_the_steady_state_allocates_no_image(regions: dict[CameraName, Region]) -> None:
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, regions=regions)
    frame = expose(radiance(9, 1.0, (540, 720)), START, 11.0)
    for index in range(3):
        loop.step(FrameSet(index, {"left": at_time(frame, index)}))
    tracemalloc.start()
    try:
        for index in range(3, 6):
            loop.step(FrameSet(index, {"left": at_time(frame, index)}))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 360 * 270 / 2  # half of the smallest image


def test_a_vignetting_of_another_size_is_refused() -> None:
    frame = expose(radiance(1, 1.0), START, 11.0)
    lens = Vignetting(640, 480, (319.5, 239.5), (-0.5,))
    loop = ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START, vignettings={"left": lens})
    with pytest.raises(ConfigurationError, match="640x480 pixels, but the left camera sends 180x136"):
        loop.step(FrameSet(1, {"left": frame}))


def test_policies_from_papers_do_not_know_of_vignetting() -> None:
    frame, lens = expose(radiance(1, 1.0), START, 11.0), Vignetting(180, 136, (89.5, 67.5), (-0.5,))
    for policy in ("neves2009", "begin2022", "belief"):
        loops = (ControlLoop(policy, LINEAR, LIMITS, START, vignettings=each) for each in ({}, {"left": lens}))
        one, other = (loop.step(FrameSet(1, {"left": frame})) for loop in loops)
        assert one == other


def test_m_g_is_measured_only_for_those_who_ask() -> None:
    """Asking changes no decision."""
    decisions: dict[bool, list[Decision]] = {False: [], True: []}
    for asked, watched in decisions.items():
        loop = make("belief")
        loop.metric_asked = asked
        run(loop, [10.0] * 4, START, watch=watched.append)
    assert all(decision.metric is None for decision in decisions[False])
    assert all(decision.metric is not None and decision.metric > 0.0 for decision in decisions[True])
    assert [replace(decision, metric=None) for decision in decisions[True]] == decisions[False]


SHAPE = (136, 180)
STEPS = 24


def even(grey: int) -> NDArray[np.uint8]:
    return np.full(SHAPE, grey, np.uint8)


def halves() -> NDArray[np.uint8]:
    image = even(0)
    image[:, 90:] = 255
    return image


IMAGES: dict[str, list[NDArray[np.uint8]]] = {
    "black": [even(0)],
    "white": [even(255)],
    "grey": [even(128)],
    "black and white in turn": [even(0), even(255)],
    "half black, half white": [halves()],
    "one grey level apart": [even(17), even(18)],
}


@pytest.mark.parametrize("policy_id", POLICY_IDS)
@pytest.mark.parametrize("images", IMAGES.values(), ids=IMAGES)
def test_every_decision_is_finite_and_within_the_limits(policy_id: str, images: list[NDArray[np.uint8]]) -> None:
    """Warnings are errors, divisions by zero included."""
    limits, setting = ExposureLimits(20.0, 7500.0, 0.0, 30.0, 7.0, 0.1), ExposureSetting(1000.0, 6.0)
    loop = make(policy_id, limits)
    loop.metric_asked = True
    for step in range(STEPS):
        time_ns = step * FRAME_NS if step != STEPS // 2 else 0  # including a clock that went back
        left, right = (
            Frame(images[(step + apart) % len(images)], 8, step, time_ns, time_ns, time_ns, setting) for apart in (0, 1)
        )
        decision = loop.step(FrameSet(step, {"left": left, "right": right} if step % 5 else {"left": left}))
        setting = decision.setting
        assert limits.contain(setting)
        steps = np.array([(setting.exposure_time_us - 20.0) / 7.0, setting.gain_db / 0.1])
        assert steps == pytest.approx(np.round(steps), abs=1e-6)
        # The gain takes what the time could not provide, if there is gain left.
        rounded = 3.5 / setting.exposure_time_us / math.log(2) + 1e-3 if setting.gain_db in {0.0, 30.0} else 0.02
        assert abs(setting.level - decision.level) < rounded
        numbers = (decision.level, decision.metric, decision.motion_px, decision.saturated_share, decision.black_share)
        assert all(number is not None and math.isfinite(number) for number in numbers)


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_a_region_that_sees_only_black_is_not_an_error(policy_id: str) -> None:
    setting = ExposureSetting(1000.0, 6.0)
    mask = np.zeros(SHAPE, np.uint8)
    mask[:, :90] = 255
    loop = ControlLoop(
        policy_id, ResponseFunction.linear(), LIMITS, setting, regions={"left": Region("left", mask=mask)}
    )
    for step in range(4):
        frame = Frame(halves(), 8, 0, 0, 0, 0, setting)
        assert LIMITS.contain(loop.step(alike(frame, step)).setting)
