"""Fisher information of gradients, and its prediction at other exposures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import information
from autoexpose_daemon.control.metrics.contrast import CELLS, Contrast, GreyBins, contrast, sampled_contrast
from autoexpose_daemon.control.metrics.extension import extension
from autoexpose_daemon.control.metrics.gradient import ExtremeShares
from autoexpose_daemon.control.metrics.information import FRONT_END_DN, QUANTISATION, InformationPrediction, sharpness
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from calibration.response import ResponseFunction

LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
DELTAS = np.arange(-3.0, 3.25, 0.25)
NO_CHANGE = int(np.flatnonzero(DELTAS == 0)[0])
SAME = np.ones(DELTAS.size)


def texture(seed: int = 1, height: int = 96, width: int = 128) -> NDArray[np.float64]:
    """Light between 0.02 and 1 of full scale, softly varying."""
    rng = np.random.default_rng(seed)
    coarse = rng.random((height // 8 + 1, width // 8 + 1))
    smooth = np.kron(coarse, np.ones((8, 8)))[:height, :width]
    for _ in range(3):
        smooth = (smooth + np.roll(smooth, 1, 0) + np.roll(smooth, 1, 1) + np.roll(smooth, -1, 0)) / 4
    return np.asarray(0.02 + 0.4 * smooth**2)


def expose(
    light: NDArray[np.float64], stops: float, gain: float = 1.0, noise: SensorNoise = NOISE, seed: int = 0
) -> NDArray[np.uint8]:
    """A frame of the sensor: shot and read noise, then 8 bits; `light` is the share of full scale at 0 stops."""
    electrons = light * 2.0**stops * noise.full_well_e / gain
    spread = np.sqrt(electrons + noise.read_noise_e**2)
    taken = electrons + spread * np.random.default_rng(seed).standard_normal(light.shape)
    return np.clip(np.rint(taken * gain / noise.full_well_e * 255), 0, 255).astype(np.uint8)


def seen_in(
    image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None, response: ResponseFunction = LINEAR
) -> Contrast:
    """As the policy collects it."""
    return contrast(image, GreyBins(response), weights)


def slow_contrast(image: NDArray[np.uint8], weights: NDArray[np.uint8]) -> Contrast:
    """Pixel by pixel, as the docstring says it."""
    bins = GreyBins(LINEAR)
    energy, count = np.zeros((2, CELLS * CELLS, bins.count))
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    grey = image.astype(int)
    for y in range(1, rows + 1):
        for x in range(1, columns + 1):
            cell = CELLS * ((y - 1) * CELLS // rows) + (x - 1) * CELLS // columns
            cross = [grey[y, x], grey[y - 1, x], grey[y + 1, x], grey[y, x - 1], grey[y, x + 1]]
            weight = int(weights[y, x])
            squared = (grey[y, x + 1] - grey[y, x - 1]) ** 2 + (grey[y + 1, x] - grey[y - 1, x]) ** 2
            energy[cell, bins.of[max(cross)]] += weight * squared
            count[cell, bins.of[max(cross)]] += weight
    return Contrast(energy, count)


def same(first: Contrast, second: Contrast) -> bool:
    return bool((first.energy == second.energy).all() and (first.count == second.count).all())


@pytest.mark.parametrize("native", [True, False])
@given(st.integers(3, 24), st.integers(3, 24), st.integers(0, 2**32 - 1))
def test_contrast_is_collected_as_defined(native: bool, height: int, width: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    image, weights = rng.integers(0, 256, (2, height, width), dtype=np.uint8)
    bins = GreyBins(LINEAR)

    def collected(weights: NDArray[np.uint8] | None) -> Contrast:
        return contrast(image, bins, weights) if native else sampled_contrast(image, bins, weights, 1)

    assert same(collected(weights), slow_contrast(image, weights))
    assert same(collected(None), collected(np.ones_like(image)))
    flipped = contrast(image[:, ::-1], bins, weights[:, ::-1]) if native else None
    assert flipped is None or flipped.energy.sum() == collected(weights).energy.sum()


def test_sums_beyond_a_place_of_the_packed_table_are_right() -> None:
    """More pixels of the greatest energy and weight than 40 bits hold, in one place."""
    image = np.zeros((4, 500_000), np.uint8)
    image[:, 2::4], image[:, 3::4] = 255, 255
    seen = contrast(image, GreyBins(LINEAR), np.full_like(image, 255))
    assert seen.count.sum() == 255 * 2 * 499_998
    assert seen.energy.sum() == 255 * 255**2 * 2 * 499_998


@pytest.mark.parametrize("black_level", [0, 16, 200])
def test_both_paths_have_the_same_bins(black_level: int) -> None:
    """Black and saturated are bins of their own, and each grey level is counted in its bin."""
    response = ResponseFunction.linear(black_level)
    bins = GreyBins(response)
    assert (np.diff(bins.of.astype(int)) >= 0).all() and set(bins.of) == set(range(bins.count))
    assert set(np.flatnonzero(bins.of == 0)) == set(range(black_level + 1))
    assert set(np.flatnonzero(bins.of == bins.count - 1)) == set(range(ExtremeShares(response).saturated_from, 256))
    for grey in range(256):
        seen = contrast(np.full((3, 3), grey, np.uint8), bins)
        assert np.flatnonzero(seen.count.sum(axis=0)) == bins.of[grey]


def test_tables_that_do_not_fit_the_bins_are_refused() -> None:
    image, tables = np.zeros((8, 8), np.uint8), np.empty((2, 64, 66))
    with pytest.raises(ValueError, match="each of the 67 bins"):
        extension.contrast_sums(image, 0, 252, *tables)
    with pytest.raises(ValueError, match="below saturated"):
        extension.contrast_sums(image, 252, 252, *tables)


@pytest.mark.parametrize("gain", [1.0, 16.0])
def test_bins_change_the_curve_by_less_than_one_percent(gain: float) -> None:
    image = expose(texture(4, 272, 360), 0.0, gain=gain)
    curves = [
        prediction.curve(sampled_contrast(image, prediction.bins, None, 1), 1.0, gain, gain * SAME, SAME)
        for prediction in (InformationPrediction(LINEAR, NOISE, DELTAS), information_by_grey())
    ]
    assert curves[0] == pytest.approx(curves[1], abs=0.01 * curves[1].max())


def information_by_grey() -> InformationPrediction:
    """A prediction with a bin for each grey level."""
    bins = GreyBins(LINEAR)
    bins.of, bins.count = np.arange(256, dtype=np.uint8), 256
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(information, "GreyBins", lambda _: bins)
        return InformationPrediction(LINEAR, NOISE, DELTAS)


def test_without_the_extension_every_second_pixel_counts() -> None:
    image = (texture(3) * 255).astype(np.uint8)
    seen, every = contrast(image, GreyBins(LINEAR), native=False), seen_in(image)
    assert seen.count.sum() == pytest.approx(every.count.sum() / 4, rel=0.03)
    assert seen.energy.sum() == pytest.approx(every.energy.sum() / 4, rel=0.1)


def test_a_flat_image_of_pure_noise_has_next_to_no_information() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    flat = seen_in(expose(np.full((96, 128), 0.3), 0.0, gain=8.0))
    structured = seen_in(expose(texture(), 0.0, gain=8.0))
    curve = prediction.curve(flat, 1.0, 8.0, 8.0 * SAME, SAME)
    assert curve[NO_CHANGE] < 0.2 * prediction.curve(structured, 1.0, 8.0, 8.0 * SAME, SAME)[NO_CHANGE]


def test_no_gradients_and_nothing_but_saturation_are_worth_nothing() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    for grey in (0, 255):
        seen = seen_in(np.full((48, 64), grey, np.uint8))
        assert not prediction.curve(seen, 1.0, 1.0, SAME, SAME).any()


@pytest.mark.parametrize("stops", [-2.0, -1.0, 0.0, 0.75])
def test_predictions_agree_with_frames_really_taken_at_those_exposures(stops: float) -> None:
    """In steps of exposure time: the gain stays."""
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    light = texture()
    curve = prediction.curve(seen_in(expose(light, stops)), 1.0, 1.0, SAME, SAME)
    for place, delta in enumerate(DELTAS):
        if -2.0 <= delta <= 1.0 and stops + delta <= 1.0:
            there = seen_in(expose(light, stops + delta, seed=7))
            measured = prediction.curve(there, 1.0, 1.0, SAME, SAME)[NO_CHANGE]
            assert curve[place] == pytest.approx(measured, rel=0.15), (stops, delta)


def test_gain_costs_what_its_noise_costs() -> None:
    """The same grey levels from a quarter of the light: predicted from the frame at 0 dB, and really taken."""
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    low = seen_in(expose(texture(), 0.0))
    predicted = prediction.curve(low, 1.0, 1.0, 16.0 * SAME, SAME)[NO_CHANGE]
    high = seen_in(expose(texture(), 0.0, gain=16.0, seed=5))
    taken = prediction.curve(high, 1.0, 16.0, 16.0 * SAME, SAME)[NO_CHANGE]
    assert predicted == pytest.approx(taken, rel=0.15)
    assert predicted < 0.8 * prediction.curve(low, 1.0, 1.0, SAME, SAME)[NO_CHANGE]


def test_a_better_sensor_than_configured_does_not_hide_the_dark() -> None:
    better = SensorNoise(40_000.0, 2.0)
    seen = seen_in(expose(texture() / 16, 0.0, gain=16.0, noise=better))
    told = InformationPrediction(LINEAR, better, DELTAS).curve(seen, 1.0, 16.0, 16.0 * SAME, SAME)[NO_CHANGE]
    untold = InformationPrediction(LINEAR, NOISE, DELTAS).curve(seen, 1.0, 16.0, 16.0 * SAME, SAME)[NO_CHANGE]
    assert untold > 0.6 * told


def test_a_saturated_part_does_not_switch_noise_off() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    flat = expose(np.full((96, 128), 0.3), 0.0, gain=30.0)
    whole = prediction.curve(seen_in(flat), 1.0, 30.0, 30.0 * SAME, SAME)[NO_CHANGE]
    flat[:40] = 255
    assert prediction.curve(seen_in(flat), 1.0, 30.0, 30.0 * SAME, SAME)[NO_CHANGE] <= whole * 1.1


@pytest.mark.parametrize("black_level", [0, 16])
def test_what_falls_to_black_is_worth_nothing(black_level: int) -> None:
    response = ResponseFunction.linear(black_level)
    dark = np.full((48, 64), black_level + 4, np.uint8)
    dark[:, ::4] += 4
    curve = InformationPrediction(response, NOISE, np.array([-6.0, 0.0])).curve(
        seen_in(dark, response=response), 1.0, 1.0, np.ones(2), np.ones(2)
    )
    assert curve[0] == 0 < curve[1]


def test_a_pedestal_changes_nothing_but_the_grey_levels() -> None:
    light = 0.8 * texture()
    above = np.rint(light * 239).astype(np.uint8)
    narrow = ResponseFunction(
        np.log2(np.maximum(np.minimum(np.arange(256.0), 239.0), 0.5) / 239.0), black_level=0, saturation=239
    )
    curves = [
        InformationPrediction(response, NOISE, DELTAS).curve(
            seen_in(image, response=response), 1.0, 4.0, 4.0 * SAME, SAME
        )
        for response, image in ((narrow, above), (ResponseFunction.linear(16), above + 16))
    ]
    assert curves[0] == pytest.approx(curves[1], rel=0.02)


def test_one_rich_cell_does_not_pay_for_all_others() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    spread = expose(texture(), 0.0)
    patch = np.full_like(spread, spread.mean().round())
    patch[:12, :16] = np.where(np.indices((12, 16)).sum(axis=0) // 2 % 2, 20, 200)
    rich, even = seen_in(patch), seen_in(spread)
    assert rich.energy.sum() > even.energy.sum()
    assert (
        prediction.curve(rich, 1.0, 1.0, SAME, SAME)[NO_CHANGE]
        < 0.5 * prediction.curve(even, 1.0, 1.0, SAME, SAME)[NO_CHANGE]
    )


def test_a_white_part_takes_away_no_more_than_its_cells() -> None:
    """A sky without structure does not darken the ground below it."""
    prediction = InformationPrediction(LINEAR, SensorNoise(1e9, 0.1), DELTAS)
    ground = expose(texture(), 0.0)
    below_sky = ground.copy()
    below_sky[: len(ground) // 2] = 255
    whole, half = (prediction.curve(seen_in(each), 1.0, 1.0, SAME, SAME)[NO_CHANGE] for each in (ground, below_sky))
    assert half == pytest.approx(0.5 * whole, rel=0.1)


@given(st.floats(0.0, 50.0), st.floats(0.0, 50.0))
def test_more_blur_leaves_less(one_px: float, other_px: float) -> None:
    short, long = sorted((one_px, other_px))
    assert 0 < sharpness(long) <= sharpness(short) <= sharpness(0.0) == 1.0


def test_weights_leave_out_what_weighs_nothing() -> None:
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    image = expose(texture(), 0.0)
    weights = np.full(image.shape, 255, np.uint8)
    weights[:, 64:] = 0
    half = prediction.curve(seen_in(image, weights), 1.0, 1.0, SAME, SAME)
    disturbed = image.copy()
    disturbed[:, 66:] = 255
    assert np.allclose(half, prediction.curve(seen_in(disturbed, weights), 1.0, 1.0, SAME, SAME))


def test_the_variance_factors_are_those_of_photons_and_read_noise() -> None:
    """K g I + (sigma K g)^2, the law of EMVA 1288, for a linear camera."""
    gain, grey = 4.0, 100.0
    k = 255 / NOISE.full_well_e * gain
    shot, read = NOISE.variance_factors(np.array(grey * np.log(2)), np.array(grey / 255))
    assert shot * gain + read * gain**2 == pytest.approx(k * grey + (k * NOISE.read_noise_e) ** 2)


def test_a_tiny_gradient_is_worth_its_square_over_noise_and_front_end() -> None:
    """A ramp of one grey level in each direction, every pixel alike."""
    ramp = (100 + np.add.outer(np.arange(10), np.arange(10))).astype(np.uint8)
    curve = InformationPrediction(LINEAR, SensorNoise(1e9, 0.1), DELTAS).curve(seen_in(ramp), 1.0, 1.0, SAME, SAME)
    expected = np.sqrt((2 - QUANTISATION) / (QUANTISATION + FRONT_END_DN**2))
    assert curve[NO_CHANGE] == pytest.approx(expected, rel=0.01)


def test_an_even_lens_changes_nothing() -> None:
    prediction, seen = InformationPrediction(LINEAR, NOISE, DELTAS), seen_in(expose(texture(4), 0.0))
    plain = prediction.curve(seen, 4.0, 1.0, SAME, SAME)
    even = prediction.curve(seen, 4.0, 1.0, SAME, SAME, relative_light=np.ones(64))
    assert even == pytest.approx(plain, rel=1e-9)


def test_contrast_that_the_lens_took_counts_as_if_it_were_back_and_its_noise_with_it() -> None:
    """Half the light through a lens that passes half: the same contrast once it is divided out, but more noise."""
    light = texture(4)
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    half = np.full(64, 0.5)
    bright, dark = seen_in(expose(light, 0.0)), seen_in(expose(light, -1.0))
    full, seen_darker, divided = (
        prediction.curve(seen, 1e6, 1.0, SAME, SAME, relative_light=lens)[NO_CHANGE]  # so much averaged, hardly noise
        for seen, lens in ((bright, None), (dark, None), (dark, half))
    )
    assert divided == pytest.approx(full, rel=0.03)
    assert seen_darker < 0.6 * full
    bright, dark = (seen_in(expose(light, stops, gain=16.0)) for stops in (0.0, -1.0))
    full, divided = (
        prediction.curve(seen, 1.0, 16.0, 16.0 * SAME, SAME, relative_light=lens)[NO_CHANGE]
        for seen, lens in ((bright, None), (dark, half))
    )
    assert divided < 0.95 * full


def test_each_cell_has_its_own_light() -> None:
    prediction, image = InformationPrediction(LINEAR, NOISE, DELTAS), expose(texture(4), 0.0)
    seen = seen_in(image)
    lens = np.ones(64)
    lens[:8] = 0.4
    mixed = prediction.curve(seen, 1e6, 1.0, SAME, SAME, relative_light=lens)[NO_CHANGE]
    ends = [
        prediction.curve(seen, 1e6, 1.0, SAME, SAME, relative_light=part * np.ones(64))[NO_CHANGE]
        for part in (1.0, 0.4)
    ]
    assert ends[0] < mixed < ends[0] + 0.2 * (ends[1] - ends[0])
