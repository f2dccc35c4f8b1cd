"""A few of the simulated sweeps of `benchmarks/stated_error.py`; tests/accept has a hundred."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.sweeps.score import scored
from evaluation.sweeps.simulated import KINDS, Kind, simulated


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


def test_groups_that_only_noise_lifts_out_of_the_dark_make_no_exposure_odd() -> None:
    """Of a uniform scene behind a gamma, the darkest exposures show a few groups of pixels, all by their noise."""
    assert scored(200_010, simulated(200_010)).verdict != "refused"
