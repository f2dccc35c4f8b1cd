"""The oracle against trying everything, and the information by which it judges."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from autoexpose_daemon.control.balance import Balance, BlurNoiseBalance, ExposurePriority, FixedGain, FixedRatio
from autoexpose_daemon.control.metrics.contrast import Contrast, GreyBins, SensorNoise, contrast
from evaluation.arena.race import course_of, race
from evaluation.arrays import Floats, Greys
from evaluation.scenes.scenarios import SCENARIOS
from evaluation.stage.camera import LIMITS, Entrant
from evaluation.stage.oracle import FRONT_END_DN, LEVELS, QUANTISATION, Information, Oracle, rounded_motion
from evaluation.stage.rendering import Stage
from fake_camera.world.simulation import Side
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction


@cache
def stage_at(scenario: str, scene: str, seed: int, frame: int) -> Stage:
    stage, _ = course_of(scenario, scene, seed)
    stage.go_to(frame)
    return stage


@pytest.mark.parametrize(
    ("scenario", "scene", "seed", "frame"),
    [
        ("step_down", "street", 1003, 80),  # hills so narrow that a coarser grid misses the best one
        ("pan", "leaves", 6, 75),
        ("lowlight_fast", "shelves", 4, 50),
        ("flicker", "street", 7, 61),
        ("tunnel", "room", 5, 100),
    ],
)
@pytest.mark.parametrize("balance", [ExposurePriority(), BlurNoiseBalance(0.02, 8.0), FixedRatio()])
def test_search_finds_what_trying_everything_finds(
    scenario: str, scene: str, seed: int, frame: int, balance: Balance
) -> None:
    stage = stage_at(scenario, scene, seed, frame)
    quick = Oracle(stage).best(balance, 7.3)
    exhaustive = Oracle(stage, exhaustive=True).best(balance, 7.3)
    assert quick is not None and exhaustive is not None
    assert quick.metrics[0] == pytest.approx(exhaustive.metrics[0], rel=0.005)
    assert quick.level == pytest.approx(exhaustive.level, abs=0.3)


def test_no_split_is_better_than_the_best_of_all() -> None:
    oracle = Oracle(stage_at("pan", "room", 3, 100))
    best = oracle.best_of_all()
    assert best is not None
    balances = (ExposurePriority(), BlurNoiseBalance(0.02, 8.0), FixedRatio(), FixedGain(12.0))
    splits = [oracle.best(balance, 7.3) for balance in balances]
    shares = [split.metrics[0] / best.metrics[0] for split in splits if split is not None]
    assert len(shares) == 4 and max(shares) <= 1.005
    assert min(shares) < 0.9  # a poor split costs


def test_two_cameras_share_one_exposure() -> None:
    stage, _ = course_of("lamp_right", "leaves", 6)
    stage.go_to(50)
    sides: tuple[Side, Side] = ("left", "right")
    balance = ExposurePriority()
    quick, exhaustive = (Oracle(stage, sides, exhaustive=flag).best(balance, 0.0) for flag in (False, True))
    assert quick is not None and exhaustive is not None
    assert quick.joint == pytest.approx(exhaustive.joint, rel=0.005)
    assert quick.joint < 0.99
    judge = Oracle(stage, sides)
    ratios = []
    for level in LEVELS:
        setting = LIMITS.realise(float(level), balance.exposure_time_us(float(level), 0.0, LIMITS))
        ratios.append(np.mean(np.divide(judge.judge(setting), exhaustive.metrics)) / exhaustive.joint)
    assert max(ratios) == pytest.approx(1.0)


@pytest.mark.long
def test_interpolating_the_oracle_changes_ratios_little() -> None:
    """At the frames in between, where it was not asked: the mean over all frames errs by half as much."""
    entrants = [Entrant.of("begin2022"), Entrant.of("neves2009")]
    stage, first_scored = course_of("pan", "shelves", 4)
    every = SCENARIOS["pan"].oracle_every
    runs = race(stage, entrants, Oracle(stage), frames=48, first_scored=first_scored, every=every)
    exact, asked = Oracle(stage, exhaustive=True), runs[0].by_metric.best
    between = [frame for frame in range(first_scored, 48) if frame not in asked]
    ratios: dict[str, list[float]] = {entrant.name: [] for entrant in entrants}
    for frame in between:
        stage.go_to(frame)
        for series in runs:
            best = exact.best(series.delayed.loop.balance, series.delayed.decisions[frame].motion_px)
            assert best is not None
            ratios[series.entrant.name].append(series.metrics[frame, 0] / best.metrics[0])
    for series in runs:
        assert series.ratios[between].mean() == pytest.approx(np.mean(ratios[series.entrant.name]), abs=0.008)


def test_nothing_to_see_is_no_best() -> None:
    class Dark:
        frame = 0

        def expose(self, _side: Side, _setting: ExposureSetting) -> np.ndarray:
            return np.zeros((540, 720), np.uint8)

    assert Oracle(Dark()).best(ExposurePriority(), 0.0) is None  # type: ignore[arg-type]


def test_motion_is_rounded_to_half_octaves() -> None:
    assert rounded_motion(0.3) == 0.0
    assert rounded_motion(8.0) == 8.0
    assert rounded_motion(9.4) == 8.0
    assert rounded_motion(9.6) == pytest.approx(8 * 2**0.5)


LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
INFORMATION = Information(LINEAR, NOISE)


def texture(seed: int = 1, height: int = 96, width: int = 128) -> Floats:
    """Light between 0.02 and 1 of full scale, softly varying."""
    rng = np.random.default_rng(seed)
    coarse = rng.random((height // 8 + 1, width // 8 + 1))
    smooth = np.kron(coarse, np.ones((8, 8)))[:height, :width]
    for _ in range(3):
        smooth = (smooth + np.roll(smooth, 1, 0) + np.roll(smooth, 1, 1) + np.roll(smooth, -1, 0)) / 4
    return np.asarray(0.02 + 0.4 * smooth**2)


def expose(light: Floats, stops: float, gain: float = 1.0, noise: SensorNoise = NOISE, seed: int = 0) -> Greys:
    """A frame of the sensor: shot and read noise, then 8 bits; `light` is the share of full scale at 0 stops."""
    electrons = light * 2.0**stops * noise.full_well_e / gain
    spread = np.sqrt(electrons + noise.read_noise_e**2)
    taken = electrons + spread * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(taken * gain / noise.full_well_e * 255), 0, 255).astype(np.uint8)


def seen_in(image: Greys, weights: Greys | None = None, response: ResponseFunction = LINEAR) -> Contrast:
    """As control collects it."""
    return contrast(image, GreyBins(response), weights)


def worth(image: Greys, gain: float = 1.0, weights: Greys | None = None) -> float:
    return INFORMATION.measure(seen_in(image, weights), 1.0, gain)


def test_the_default_noise_is_that_of_the_configuration() -> None:
    seen = seen_in(expose(texture(), 0.0, gain=8.0))
    assert Information(LINEAR).measure(seen, 4.0, 8.0) == Information(LINEAR, NOISE).measure(seen, 4.0, 8.0)


def test_a_flat_image_of_pure_noise_has_next_to_no_information() -> None:
    flat, structured = expose(np.full((96, 128), 0.3), 0.0, gain=8.0), expose(texture(), 0.0, gain=8.0)
    assert worth(flat, 8.0) < 0.2 * worth(structured, 8.0)


@pytest.mark.parametrize("grey", [0, 255])
def test_no_gradients_and_nothing_but_saturation_are_worth_nothing(grey: int) -> None:
    assert worth(np.full((48, 64), grey, np.uint8)) == 0.0


def test_gain_costs_what_its_noise_costs() -> None:
    """The same grey levels from a sixteenth of the light."""
    assert worth(expose(texture(), 0.0, gain=16.0), 16.0) < 0.8 * worth(expose(texture(), 0.0))


def test_a_better_sensor_than_configured_does_not_hide_the_dark() -> None:
    better = SensorNoise(40_000.0, 2.0)
    seen = seen_in(expose(texture() / 16, 0.0, gain=16.0, noise=better))
    told, untold = (Information(LINEAR, noise).measure(seen, 1.0, 16.0) for noise in (better, NOISE))
    assert untold > 0.6 * told


def test_a_saturated_part_does_not_switch_noise_off() -> None:
    flat = expose(np.full((96, 128), 0.3), 0.0, gain=30.0)
    whole = worth(flat, 30.0)
    flat[:40] = 255
    assert worth(flat, 30.0) <= whole * 1.1


def test_a_pedestal_changes_nothing_but_the_grey_levels() -> None:
    above = np.rint(0.8 * texture() * 239).astype(np.uint8)
    narrow = ResponseFunction(
        np.log2(np.maximum(np.minimum(np.arange(256.0), 239.0), 0.5) / 239.0), black_level=0, saturation=239
    )
    found = [
        Information(response, NOISE).measure(seen_in(image, response=response), 1.0, 4.0)
        for response, image in ((narrow, above), (ResponseFunction.linear(16), above + 16))
    ]
    assert found[0] == pytest.approx(found[1], rel=0.02)


def test_one_rich_cell_does_not_pay_for_all_others() -> None:
    spread = expose(texture(), 0.0)
    patch = np.full_like(spread, spread.mean().round())
    patch[:12, :16] = np.where(np.indices((12, 16)).sum(axis=0) // 2 % 2, 20, 200)
    assert seen_in(patch).energy.sum() > seen_in(spread).energy.sum()
    assert worth(patch) < 0.5 * worth(spread)


def test_a_white_part_takes_away_no_more_than_its_cells() -> None:
    """A sky without structure does not darken the ground below it."""
    information, ground = Information(LINEAR, SensorNoise(1e9, 0.1)), expose(texture(), 0.0)
    below_sky = ground.copy()
    below_sky[: len(ground) // 2] = 255
    whole, half = (information.measure(seen_in(each), 1.0, 1.0) for each in (ground, below_sky))
    assert half == pytest.approx(0.5 * whole, rel=0.1)


def test_weights_leave_out_what_weighs_nothing() -> None:
    image = expose(texture(), 0.0)
    weights = np.full(image.shape, 255, np.uint8)
    weights[:, 64:] = 0
    disturbed = image.copy()
    disturbed[:, 66:] = 255
    assert worth(disturbed, weights=weights) == pytest.approx(worth(image, weights=weights))


def test_a_tiny_gradient_is_worth_its_square_over_noise_and_front_end() -> None:
    """A ramp of one grey level in each direction, every pixel alike."""
    ramp = (100 + np.add.outer(np.arange(10), np.arange(10))).astype(np.uint8)
    expected = np.sqrt((2 - QUANTISATION) / (QUANTISATION + FRONT_END_DN**2))
    assert Information(LINEAR, SensorNoise(1e9, 0.1)).measure(seen_in(ramp), 1.0, 1.0) == pytest.approx(
        expected, rel=0.01
    )


def test_the_variance_factors_are_those_of_photons_and_read_noise() -> None:
    """K g I + (sigma K g)^2, the law of EMVA 1288, for a linear camera."""
    gain, grey = 4.0, 100.0
    k = 255 / NOISE.full_well_e * gain
    shot, read = NOISE.variance_factors(np.array(grey * np.log(2)), np.array(grey / 255))
    assert shot * gain + read * gain**2 == pytest.approx(k * grey + (k * NOISE.read_noise_e) ** 2)
