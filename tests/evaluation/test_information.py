"""Fisher information of frames, by which exposures are judged."""

from __future__ import annotations

import numpy as np
import pytest

from autoexpose_daemon.control.metrics.contrast import Contrast, GreyBins, SensorNoise, contrast
from evaluation.arrays import Floats, Greys
from evaluation.stage.oracle import FRONT_END_DN, QUANTISATION, Information
from imaging.response import ResponseFunction

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
