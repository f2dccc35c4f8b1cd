from __future__ import annotations

import numpy as np
import pytest

from fake_camera.world.response import CURVES, response_table


@pytest.mark.parametrize("name", CURVES)
def test_response_increases_from_0_to_1(name: str) -> None:
    table = response_table(name, 4096)
    assert table.shape == (4096,)
    assert (table[0], table[-1]) == pytest.approx((0.0, 1.0))
    assert np.all(np.diff(table) > 0)


def test_curves_differ() -> None:
    middles = sorted(response_table(name, 101)[25] for name in CURVES)
    assert np.all(np.diff(middles) > 0.01)


def test_unknown_response_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"'sepia'.*linear, gamma, s_shaped"):
        response_table("sepia", 256)
