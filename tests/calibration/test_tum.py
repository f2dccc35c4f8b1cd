from __future__ import annotations

import numpy as np
import pytest

from calibration.response.file import tum_table
from imaging.response import ResponseFunction

GAMMA = ResponseFunction(2.2 * np.log2(np.maximum(np.arange(256), 0.5) / 255), 0, 255)


@pytest.mark.parametrize(
    "response",
    [
        ResponseFunction.linear(),
        ResponseFunction.linear(16),
        GAMMA,
        ResponseFunction(GAMMA.log2_exposure, 30, 200),
        ResponseFunction(GAMMA.log2_exposure + 2000.0, 0, 255),
        ResponseFunction(np.arange(256) * 1e4, 0, 255),
    ],
)
def test_256_numbers_rise_strictly_from_0_to_255_also_in_single_precision(response: ResponseFunction) -> None:
    line = tum_table(response)
    assert line.endswith("\n")
    assert line.count("\n") == 1
    table = np.array(line.split(), np.float32)
    assert table.shape == (256,)
    assert (np.diff(table) > 0).all()
    assert (table[0], table[-1]) == (0.0, 255.0)


def test_the_table_is_the_light_of_each_grey_level() -> None:
    table = np.array(tum_table(GAMMA).split(), float)
    assert table[1:] == pytest.approx(255 * (np.arange(1, 256) / 255) ** 2.2, abs=0.01)
    assert np.array(tum_table(ResponseFunction.linear()).split(), float) == pytest.approx(np.arange(256), abs=0.6)
