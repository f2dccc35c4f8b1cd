"""Light out of frames, and frames that are exposed again against frames that were really taken."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.control.metrics.contrast import SensorNoise
from evaluation.experiments.rejudge import OFFSETS, measure_still
from evaluation.rejudge.camera import Exposer, SeenLight
from imaging.exposure import ExposureSetting
from imaging.frames import Frame
from imaging.pixels import Pixels
from imaging.response import ResponseFunction

NOISE = SensorNoise(20_000.0, 3.0)
QUIET = SensorNoise(1e7, 0.1)
GAMMA = ResponseFunction(np.log2(np.maximum(np.arange(256), 0.5) / 255) * 1.7, 0, 255)
SHAPE = 60, 80


def frame(pixels: Pixels, setting: ExposureSetting) -> Frame:
    return Frame(pixels, 8 * pixels.itemsize, 0, 0, 0, 0, setting)


def flat(amount: float) -> SeenLight:
    return SeenLight(np.full(SHAPE, amount, np.float32), np.zeros(SHAPE, np.float32))


@pytest.mark.parametrize("response", [ResponseFunction.linear(), GAMMA], ids=["linear", "gamma"])
@given(grey=st.integers(12, 240), stops=st.floats(-2.0, 2.0))
def test_without_noise_a_frame_is_what_the_response_says(response: ResponseFunction, grey: int, stops: float) -> None:
    exposer, setting = Exposer(response, QUIET, 0), ExposureSetting(1000.0, 0.0)
    seen = exposer.light(frame(np.full(SHAPE, grey, np.uint8), setting))
    exposed = exposer.expose(seen, ExposureSetting(1000.0 * 2.0**stops, 0.0), 8, 0)
    wanted = response.intensity(response.inverse(np.array([grey])) + stops)[0]
    assert abs(float(exposed.mean()) - wanted) < 0.6


def test_a_frame_exposed_as_it_was_taken_is_itself() -> None:
    grey = np.arange(4800, dtype=np.int64).reshape(SHAPE) % 250
    taken = frame(grey.astype(np.uint8), ExposureSetting(700.0, 12.0))
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    again = exposer.expose(exposer.light(taken), taken.setting, 8, 3)
    assert np.abs(again.astype(int) - grey).max() <= 1


@pytest.mark.parametrize(("time_us", "gain_db"), [(1000.0, 0.0), (250.0, 12.0), (31.6, 30.0)])
def test_noise_is_what_the_setting_has(time_us: float, gain_db: float) -> None:
    setting = ExposureSetting(time_us, gain_db)
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    exposed = exposer.expose(flat(0.3 * 2.0**-setting.level), setting, 16, 0) / 257.0
    gain = 10 ** (gain_db / 20)
    electrons = 0.3 * NOISE.full_well_e / gain
    wanted = 255 * gain / NOISE.full_well_e * np.sqrt(electrons + NOISE.read_noise_e**2)
    assert exposed.mean() == pytest.approx(0.3 * 255, rel=0.02)
    assert exposed.std() == pytest.approx(wanted, rel=0.1)


def test_noise_that_is_there_already_is_not_added_again() -> None:
    setting = ExposureSetting(500.0, 18.0)
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    first = exposer.expose(flat(0.3 * 2.0**-setting.level), setting, 8, 0)
    again = exposer.expose(exposer.light(frame(first, setting)), setting, 8, 1)
    assert again.std() == pytest.approx(first.std(), rel=0.05)


def test_fused_frames_show_what_none_of_them_shows_alone() -> None:
    """From 1 to 1000 times the darkest light that one frame would resolve."""
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    amount = np.geomspace(1e-7, 1e-4, SHAPE[1], dtype=np.float32)[None].repeat(SHAPE[0], axis=0)
    light = SeenLight(amount, np.zeros(SHAPE, np.float32))
    settings = [ExposureSetting(1000.0, 6.0 * step) for step in range(6)] + [ExposureSetting(8000.0, 0.0)]
    frames = [frame(exposer.expose(light, setting, 8, number), setting) for number, setting in enumerate(settings)]
    fused = exposer.fused(frames)
    error = np.log2(fused.amount.mean(axis=0) / amount[0])
    assert np.abs(error[30:]).max() < 0.15


@pytest.mark.parametrize("codes", [5.0, 10.0, 20.0, 40.0])
def test_what_rounds_to_black_in_most_frames_is_not_made_darker(codes: float) -> None:
    """Grey levels in the brightest frame; 64 times fewer in the darkest, where noise is a hundredth of one."""
    exposer = Exposer(ResponseFunction.linear(), SensorNoise(20_000.0, 1.0), 0)
    settings = [ExposureSetting(1000.0, 6.02 * step) for step in range(5)] + [ExposureSetting(4000.0, 24.08)]
    light = flat(codes / 255 * 2.0 ** -settings[-1].level)
    frames = [frame(exposer.expose(light, setting, 8, number), setting) for number, setting in enumerate(settings)]
    assert exposer.fused(frames).amount.mean() == pytest.approx(light.amount[0, 0], rel=0.08)


@given(st.floats(0.0, 3.0))
def test_what_is_saturated_stays_so_in_a_little_less_light(stops: float) -> None:
    setting = ExposureSetting(1000.0, 0.0)
    exposer = Exposer(ResponseFunction.linear(), QUIET, 0)
    seen = exposer.light(frame(np.full(SHAPE, 255, np.uint8), setting))
    darker = exposer.expose(seen, ExposureSetting(1000.0 * 2.0**-stops, 0.0), 8, 0)
    assert (darker == 255).all() == (stops <= 1.0) or abs(stops - 1.0) < 0.05


def test_frames_of_more_bits_and_colours_keep_their_form() -> None:
    exposer = Exposer(ResponseFunction.linear(), NOISE, 0)
    deep = Frame(np.full((4, 6), 2000, np.uint16), 12, 0, 0, 0, 0, ExposureSetting(1000.0, 0.0))
    assert exposer.expose(exposer.light(deep), deep.setting, 12, 0).dtype == np.uint16
    assert abs(float(exposer.expose(exposer.light(deep), deep.setting, 12, 0).mean()) - 2000) < 20
    colour = Frame(np.full((4, 6, 3), 99, np.uint8), 8, 0, 0, 0, 0, deep.setting, layout="RGB")
    assert exposer.expose(exposer.light(colour), deep.setting, 8, 0).shape == (4, 6, 3)


def test_noise_of_a_frame_is_the_same_whatever_its_setting() -> None:
    exposer, setting = Exposer(ResponseFunction.linear(), NOISE, 0), ExposureSetting(1000.0, 0.0)
    first, again, other = (exposer.expose(flat(3e-4), setting, 8, number) for number in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_frames_of_a_still_scene_are_as_if_really_taken() -> None:
    """Four stops either side of the bracket's middle; the brightest shot is three stops above it."""
    rows = measure_still(scene="leaves", seed=311, frames=28)
    assert [row["offset"] for row in rows] == list(OFFSETS)
    for row in rows:
        assert row["rms"] < 1.0  # grey levels, beyond noise
        assert abs(row["bias"]) < 0.2
        assert row["made_noise"] == pytest.approx(row["noise"], rel=0.25)
