"""What clipped parts of a picture are expected to show at other exposures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics import information
from autoexpose_daemon.control.metrics.contrast import contrast
from autoexpose_daemon.control.metrics.information import InformationPrediction
from autoexpose_daemon.control.metrics.sensor_noise import SensorNoise
from autoexpose_daemon.control.metrics.unseen import DEPTHS, SHADE, BinLevels, expected_unseen
from calibration.response import ResponseFunction

LINEAR = ResponseFunction.linear()
NOISE = SensorNoise(10_500.0, 3.0)
DELTAS = np.arange(-6.0, 6.5, 0.5)
NOW = int(np.flatnonzero(DELTAS == 0)[0])

LEVELS = BinLevels(
    readable=np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0]),
    slopes2=np.array([0.1, 0.5, 2.0, 400.0, 10_000.0, 25_000.0, 30_000.0]),
    stops=np.array([-9.0, -8.0, -7.0, -3.0, -1.0, -0.2, 0.0]),
)
"""Of black, two dark grey levels, three brighter bins, and saturation."""


def table(**cells: list[float]) -> NDArray[np.float64]:
    """64 cells by 7 bins, of which those named `cell0` and so on are not 0."""
    made = np.zeros((64, 7))
    for name, row in cells.items():
        made[int(name.removeprefix("cell"))] = row
    return made


def predicted(light: NDArray[np.float64], stops: float) -> NDArray[np.float64]:
    """The curve of a frame without noise; `light` is the share of full scale at 0 stops."""
    prediction = InformationPrediction(LINEAR, NOISE, DELTAS)
    image = np.clip(np.rint(255 * light * 2.0**stops), 0, 255).astype(np.uint8)
    same = np.ones(DELTAS.size)
    return prediction.curve(contrast(image, prediction.bins), 4.0, 1.0, same, same)


def stripes(brightest: float) -> NDArray[np.float64]:
    """Light from 0.02 to `brightest` of full scale, as many pixels in each stop, with stripes of 20 %."""
    down, across = np.mgrid[:96, :128]
    return np.asarray(0.02 * (brightest / 0.02) ** (across / 127) * (1.0 + 0.1 * (down // 2 % 2)))


def test_many_pixels_next_to_white_mean_that_white_ends_soon() -> None:
    count = table(cell0=[0, 0, 0, 0, 0, 10, 10], cell1=[0, 0, 0, 0, 10, 0, 10])
    signal = count * LEVELS.slopes2 * 0.1
    soon, later = expected_unseen(signal, count, LEVELS)[:2, SHADE:]
    assert soon[DEPTHS < 1].sum() > 2 * later[DEPTHS < 1].sum()
    # All that is saturated, with the contrast of what lies next to it.
    assert soon.sum() == pytest.approx(10 * 0.1, rel=0.01)


def test_white_far_from_all_else_is_a_window_that_shows_something_some_stops_down() -> None:
    count = table(cell0=[0, 0, 0, 0, 100, 0, 100], cell1=[0, 0, 0, 0, 0, 0.1, 0])
    window = expected_unseen(count * LEVELS.slopes2 * 0.1, count, LEVELS)[0, SHADE:] / (100 * 0.1)
    assert window[DEPTHS < 1].sum() < 0.05
    assert window.sum() > 0.5


def test_dark_cells_are_expected_to_have_the_contrast_of_the_others() -> None:
    count = table(cell0=[0, 0, 0, 0, 10, 0, 0], cell1=[0, 10, 10, 0, 0, 0, 0], cell2=[0, 10, 10, 0, 0, 0, 0])
    signal = count * LEVELS.slopes2 * 0.1
    signal[1] = 0.0
    signal[2] *= 3
    shade = expected_unseen(signal, count, LEVELS)[:, :SHADE]
    assert shade[1] == pytest.approx([1.0, 1.0])
    assert (shade[[0, 2]] == 0).all()  # shown, or more than expected


def test_nothing_is_expected_of_a_picture_that_shows_nothing() -> None:
    for only in ([0, 0, 0, 0, 0, 0, 10], [10, 0, 0, 0, 0, 0, 0], [0, 10, 10, 0, 0, 0, 0]):
        count = table(cell0=only)
        assert (expected_unseen(np.zeros(count.shape), count, LEVELS) == 0).all()


@given(st.integers(0, 2**32 - 1))
def test_more_white_is_worth_more_and_no_more_than_all_of_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = rng.random((64, 7)) * 100
    signal = rng.random((64, 7)) * count * LEVELS.slopes2
    above = expected_unseen(signal, count, LEVELS)[:, SHADE:]
    contrast_next_to_white = signal[:, 5].sum() / (count[:, 5].sum() * LEVELS.slopes2[5])
    assert (above >= 0).all()
    assert (above.sum(axis=1) <= count[:, -1] * contrast_next_to_white * (1 + 1e-9)).all()


@pytest.mark.parametrize("native", [True, False])
def test_a_ramp_that_runs_into_white_is_predicted_as_it_will_be(native: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not native:
        monkeypatch.setattr(information, "_native", None)
    light = stripes(brightest=8.0)  # a third of its stops is white
    curve, true = predicted(light, 0.0), predicted(light, -2.0)[NOW]
    assert curve[NOW - 4] == pytest.approx(true, rel=0.15)
    assert predicted(np.minimum(light, 1.0), 0.0)[NOW] == curve[NOW]  # what is shown now is measured


def test_the_dark_is_predicted_from_what_is_bright() -> None:
    light = stripes(brightest=1.0)
    light[:, :96] *= 0.02 / light[:, :96].mean(axis=0)  # three quarters, 5.6 stops down
    curve, true = predicted(light, -2.0), predicted(light, 2.0)[NOW]
    assert 0.5 < curve[NOW + 8] / true < 2.0
