"""A few of the simulated sweeps of `benchmarks/stated_error.py`; tests/accept has a hundred."""

from __future__ import annotations

import numpy as np
import pytest

from calibration.response.stillness import moved_share
from tests.calibration.simulated_sweeps import KINDS, Kind, Processing, scored, simulated
from tests.calibration.sweeps import solve_response


def test_a_seed_gives_the_same_sweep_again() -> None:
    one, other = simulated(3), simulated(3)
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(one.sweep.shots, other.sweep.shots, strict=True))
    assert (one.true.log2_exposure == other.true.log2_exposure).all()
    assert one.kind == KINDS[3]


@pytest.mark.parametrize(("seed", "kind"), [(1, "sound"), (19, "few"), (25, "proportion")])
def test_the_stated_error_covers_the_true_one(seed: int, kind: Kind) -> None:
    result = scored(seed, simulated(seed, kind))
    assert result.covered
    assert (result.verdict == "refused") == (kind == "proportion")


@pytest.mark.parametrize(
    ("seed", "processing"),
    [(10_007, "bilateral"), (10_008, "nlm"), (10_016, "colour"), (10_017, "jpeg 75"), (10_026, "jpeg 95")],
)
def test_a_sound_sweep_of_a_camera_that_processes_its_images_is_accepted(seed: int, processing: Processing) -> None:
    """All were refused, or stated a tenth of their error."""
    result = scored(seed, simulated(seed, "sound", processing))
    assert result.verdict != "refused"
    assert result.covered


def test_compression_of_colours_is_not_motion() -> None:
    assert moved_share(simulated(800_190, "sound", "colour").sweep) < 0.03


def test_groups_that_only_noise_lifts_out_of_the_dark_make_no_exposure_odd() -> None:
    """Of a uniform scene behind a gamma, the darkest exposures show a few groups of pixels, all by their noise."""
    assert scored(200_010, simulated(200_010)).verdict != "refused"


@pytest.mark.parametrize("seed", [303, 511, 30])
def test_a_curve_that_bends_just_below_saturation_is_followed(seed: int) -> None:
    """Smoothness over octaves of grey alone hid it: 0.03 to 0.07 stops at grey 254."""
    case = simulated(seed)
    found, true = solve_response(case.sweep).response.log2_exposure, case.true.log2_exposure
    bright = slice(128, 255)
    assert np.ptp(found[bright] - true[bright]) < 0.006


def test_an_offset_that_a_uniform_scene_hides_is_within_the_stated_error() -> None:
    """Of the light that black may stand for, and of the noise that is there without light."""
    result = scored(53, simulated(53))
    assert (result.kind, result.scene) == ("offset", "uniform")
    assert result.covered
