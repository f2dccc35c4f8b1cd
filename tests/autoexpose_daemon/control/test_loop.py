from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.metrics.gradient import GradientMetric
from autoexpose_daemon.control.parameters import BalanceId, ControlParameters, MotionId
from autoexpose_daemon.control.picture.image import ImagePreparation, Rectangle, Region
from autoexpose_daemon.control.picture.motion import FarnebackMotion, Motion, TileMotion
from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY, POLICY_IDS
from autoexpose_daemon.control.policy import Observation
from autoexpose_daemon.control.step import StepInputs
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Frame, Side, StereoPair
from imaging.response import ResponseFunction
from imaging.vignetting import Vignetting

from .scene import LIMITS, NOTHING_GIVEN, at_time, expose, radiance, run

LINEAR = ResponseFunction.linear()
START = ExposureSetting(1000.0, 0.0)
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


def test_begin_finds_the_maximum_of_the_metric() -> None:
    scene = radiance(1, 0.7)
    levels = run(make("begin2022"), [11.0] * 80, START, scene=scene)
    assert max(levels[-10:]) - min(levels[-10:]) < 0.1

    def metric(level: float) -> float:
        return GradientMetric().measure(_prepared(scene, level, 11.0))

    best = max(metric(level) for level in np.arange(7, 16, 0.125))
    assert metric(levels[-1]) >= 0.95 * best
    assert metric(START.level) < 0.95 * best  # it had to find it


def _prepared(scene: NDArray[np.float64], level: float, half_scale_level: float) -> NDArray[np.uint8]:
    frame = expose(scene, ExposureSetting(float(2**level), 0.0), half_scale_level)
    return ImagePreparation().prepare(frame.grey8())


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


@pytest.mark.parametrize("policy_id", POLICY_IDS)
def test_black_and_white_frames_are_survived_within_bounds(policy_id: str) -> None:
    limits = ExposureLimits(20.0, 7500.0, 0.0, 30.0, time_step_us=7.0, gain_step_db=0.1)

    def check(decision: Decision) -> None:
        time_us, gain_db = decision.setting.exposure_time_us, decision.setting.gain_db
        assert limits.min_time_us <= time_us <= limits.max_time_us
        assert limits.min_gain_db <= gain_db <= limits.max_gain_db
        assert (time_us - 20) / 7 == pytest.approx(round((time_us - 20) / 7), abs=1e-6)
        assert gain_db / 0.1 == pytest.approx(round(gain_db / 0.1), abs=1e-6)
        time_rounding = 7 / 2 / time_us / np.log(2)
        at_gain_bound = gain_db in (limits.min_gain_db, limits.max_gain_db)
        # the gain takes what the time could not provide, if there is gain left
        assert abs(decision.setting.level - decision.level) < (time_rounding + 1e-3 if at_gain_bound else 0.02)
        assert decision.metric is not None and np.isfinite([decision.metric, decision.motion_px, decision.level]).all()

    loop = make(policy_id, limits)
    loop.metric_asked = True
    run(loop, [40.0] * 30 + [-20.0] * 30 + [11.0] * 30, START, watch=check)


def test_the_reason_names_a_limit() -> None:
    decisions: list[Decision] = []
    run(make("neves2009"), [40.0] * 30, START, watch=decisions.append)
    assert decisions[-1].reason == "mean below target; held: at upper limit"
    assert decisions[-1].level == LIMITS.brightest.level
    assert decisions[-1].black_share == 1


def test_feedback_compares_with_the_frame_whose_decision_is_realised() -> None:
    scene, loop = radiance(3, 0.7), make("begin2022")
    first = loop.step(StereoPair(0, {"left": at_time(expose(scene, START, 14.0), 0)}))
    loop.step(StereoPair(1, {"left": at_time(expose(scene, START, 8.0), 1)}))  # brighter now: another decision
    shown = Observation(loop._seen, first.setting, None, 0.0, 0.0, 0.0, LIMITS, NOTHING_GIVEN, loop._past)
    past = shown.realised
    assert past is not None
    assert past.metric == first.metric
    assert past.setting == first.setting
    rounded = ExposureSetting(first.setting.exposure_time_us * 1.005, first.setting.gain_db + 0.04)
    assert replace(shown, setting=rounded).realised is past
    assert replace(shown, setting=ExposureSetting(20.0, 0.0)).realised is None


def test_frames_in_flight_are_not_corrected_twice() -> None:
    loop, scene = make("neves2009"), radiance(4, 0.3)
    frame = expose(scene, START, 12.0)
    targets = [loop.step(StereoPair(i, {"left": at_time(frame, i)})).level for i in range(4)]
    assert np.ptp(targets) < 1e-6


@pytest.mark.parametrize("policy_id", ["begin2022", "neves2009"])
def test_deeper_pixels_give_the_same_decision(policy_id: str) -> None:
    rng = np.random.default_rng(6)
    deep = rng.integers(0, 4096, (136, 180)).astype(np.uint16)

    def decide(frame: Frame) -> Decision:
        return make(policy_id).step(StereoPair(0, {"left": frame}))

    eight = decide(Frame((deep >> 4).astype(np.uint8), 8, 0, 0, 0, 0, START))
    assert decide(Frame(deep, 12, 0, 0, 0, 0, START)) == eight
    assert decide(Frame(deep << np.uint16(4), 16, 0, 0, 0, 0, START)) == eight


def test_the_left_frame_decides_even_if_the_right_one_differs() -> None:
    left = expose(radiance(7), START, 12.0)
    right = expose(radiance(8), ExposureSetting(30.0, 20.0), 5.0)
    both, alone = StereoPair(0, {"left": left, "right": right}), StereoPair(0, {"left": left})
    assert make("begin2022").step(both) == make("begin2022").step(alone)


def test_an_unknown_policy_is_refused_with_the_choices() -> None:
    with pytest.raises(ConfigurationError, match="no policy 'begin2023'; did you mean begin2022"):
        make("begin2023")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("metric_delta", 1.0),
        ("balance_weight", 0.0),
        ("mean_target", float("nan")),
        ("flicker_hz", 0.0),
        ("focal_length_px", -1.0),
    ],
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
    decision = loop.step(StereoPair(0, {"left": black}))
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
        assert loop.step(StereoPair(index, {"left": frame})).motion_px == pytest.approx(speed or 0.0, rel=1e-6)


def test_an_angular_rate_replaces_the_flow() -> None:
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(focal_length_px=860.0))
    frame = expose(radiance(5), START, 11.0)
    # 30 degrees a second at a focal length of 860 pixels: 450 pixels a second
    assert loop.step(StepInputs(StereoPair(0, {"left": frame}), -np.pi / 6)).motion_px == pytest.approx(7.505, abs=1e-3)
    for rate in (float("nan"), 101.0):
        with pytest.raises(ConfigurationError, match="give at most 100 rad/s"):
            loop.step(StepInputs(StereoPair(2, {"left": frame}), rate))
    with pytest.raises(ConfigurationError, match="focal_length_px"):
        make("begin2022").step(StepInputs(StereoPair(0, {"left": frame}), 0.5))


@pytest.mark.parametrize("before", [0, 2])
def test_where_flow_takes_over_from_angular_rates_the_last_speed_holds_for_a_frame(before: int) -> None:
    """However near the last frame that flow has seen: across fast frames in between it would measure too little."""
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, ControlParameters(focal_length_px=600.0))
    scene = radiance(5, 1.0, (540, 720))
    rates = [*[None] * before, 2.0, 1.5, None, None]
    speeds_px = [
        loop.step(
            StepInputs(StereoPair(i, {"left": at_time(expose(np.roll(scene, 8 * i, 1), START, 11.0), i)}), rate)
        ).motion_px
        for i, rate in enumerate(rates)
    ]
    assert speeds_px[before : before + 3] == [20.0, 15.0, 15.0]
    assert speeds_px[-1] == pytest.approx(8, rel=0.1)
    if before:
        assert speeds_px[:2] == [0.0, pytest.approx(8, rel=0.1)]


@pytest.mark.parametrize("regions", [{}, {"left": Region("roi", (Rectangle(0, 0, 720, 270, 0.5),), 0.1)}])
def test_the_steady_state_allocates_no_image(regions: dict[Side, Region]) -> None:
    loop = ControlLoop("begin2022", LINEAR, LIMITS, START, regions=regions)
    frame = expose(radiance(9, 1.0, (540, 720)), START, 11.0)
    for index in range(3):
        loop.step(StereoPair(index, {"left": at_time(frame, index)}))
    tracemalloc.start()
    try:
        for index in range(3, 6):
            loop.step(StereoPair(index, {"left": at_time(frame, index)}))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 360 * 270 / 2  # half of the smallest image


def test_a_vignetting_of_another_size_is_refused() -> None:
    frame = expose(radiance(1, 1.0), START, 11.0)
    lens = Vignetting(640, 480, (319.5, 239.5), (-0.5,))
    loop = ControlLoop(DEFAULT_POLICY, LINEAR, LIMITS, START, vignettings={"left": lens})
    with pytest.raises(
        ConfigurationError, match="the vignetting is for frames of 640x480 pixels, but the left camera sends 180x136"
    ):
        loop.step(StereoPair(1, {"left": frame}))


def test_policies_from_papers_do_not_know_of_vignetting() -> None:
    frame, lens = expose(radiance(1, 1.0), START, 11.0), Vignetting(180, 136, (89.5, 67.5), (-0.5,))
    for policy in ("neves2009", "begin2022", "belief"):
        loops = (ControlLoop(policy, LINEAR, LIMITS, START, vignettings=each) for each in ({}, {"left": lens}))
        one, other = (loop.step(StereoPair(1, {"left": frame})) for loop in loops)
        assert one == other


def test_m_g_is_measured_only_for_those_who_ask() -> None:
    """Asking changes no decision."""
    decisions: dict[bool, list[Decision]] = {False: [], True: []}
    for asked, watched in decisions.items():
        loop = ControlLoop("belief", ResponseFunction.linear(), LIMITS, ExposureSetting(1000.0, 0.0))
        loop.metric_asked = asked
        run(loop, [10.0] * 4, ExposureSetting(1000.0, 0.0), watch=watched.append)
    assert all(decision.metric is None for decision in decisions[False])
    assert all(decision.metric is not None and decision.metric > 0.0 for decision in decisions[True])
    assert [replace(decision, metric=None) for decision in decisions[True]] == decisions[False]
