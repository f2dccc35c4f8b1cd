"""What one camera's image says: the metric now and under other exposures, and how much of it is clipped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.metrics.extension import extension as _native
from autoexpose_daemon.control.metrics.gradient import ExtremeShares, GradientMetric, PackedTables
from autoexpose_daemon.control.policy import Look
from calibration.response import ResponseFunction
from calibration.response.prediction import prediction_tables

_NEAR = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
_FALLS = (*_NEAR, 2.0, 2.5, 3.25, 4.0, 5.0, 6.0)
_RISES = (*_NEAR, 1.75, 2.0, 2.25, 2.5, 2.75, 3.0, 3.5, 4.0, 5.0, 6.0)

DELTAS: NDArray[np.float64] = np.array([*(-fall for fall in reversed(_FALLS)), 0.0, *_RISES])
"""Changes of level (stops) at which every view gives the metric; finest where predictions hold, which is up to 3 stops
upward: a peak may be half a stop wide."""

NO_CHANGE = len(_FALLS)
"""The place of 0 in `DELTAS`."""

FEWER_DELTAS: NDArray[np.float64] = np.array([-6, -4, -2.5, -1.5, -1, -0.5, 0, 0.5, 1, 1.5, 2.5, 4, 6])
"""For the second camera, which sees much the same: half the cost, the rest interpolated."""

FEWEST_DELTAS: NDArray[np.float64] = np.array([-6, -3, -1, 0, 1, 3, 6])
"""For the second camera when predictions are expensive."""

BRIGHT_QUANTILE = 0.99
"""Share of the pixels: anything brighter may be a lamp or a reflection."""


@dataclass(frozen=True, slots=True, eq=False)
class MetricView:
    """What one camera's image says of the metric.

    Attributes
    ----------
    curve
        M_g predicted at `DELTAS`, float64, shape (29,); at 0 it is measured, not predicted.
    saturated_share, black_share
        0..1.
    signal
        99th percentile: 0 at the black level, 1 at saturation, at least half a grey level.
    steered
        `curve` with parts of the picture counting more, as consumers steer; None: none do.
    """

    curve: NDArray[np.float64]
    saturated_share: float
    black_share: float
    signal: float
    steered: NDArray[np.float64] | None = None


class Tones:
    """The tones of one camera's images: how much is saturated, and how bright the rest is."""

    def __init__(self, response: ResponseFunction) -> None:
        self._response = response
        self._shares = ExtremeShares(response)

    def measure(self, look: Look) -> tuple[float, float, float]:
        """`saturated_share`, `black_share` and `signal` of a `MetricView`."""
        saturated_share, black_share = self._shares.measure(look.image, look.weights, look.cumulative)
        if look.cumulative is None:
            assert _native is not None
            grey = _native.grey_of_rank(look.image, BRIGHT_QUANTILE * look.image.size)
        else:
            grey = int(look.cumulative.searchsorted(BRIGHT_QUANTILE * look.cumulative[-1]))
        black, saturation = self._response.black_level, self._response.saturation
        return saturated_share, black_share, max(grey - black, 0.5) / (saturation - black)


class Viewer:
    """Makes views of one camera's images.

    Parameters
    ----------
    response
        Response function of the camera.
    metric
        The metric; its buffers may be shared.
    deltas
        Changes of level to predict, `DELTAS` or fewer.
    """

    def __init__(self, response: ResponseFunction, metric: GradientMetric, deltas: Sequence[float]) -> None:
        self._tones = Tones(response)
        self._metric = metric
        self._deltas = deltas
        self._tables = PackedTables(prediction_tables(response, deltas))

    def view(self, look: Look) -> MetricView:
        """The view of a frame."""
        curve = self._metric.measure_predictions(look.image, self._tables, look.weights)
        return MetricView(np.interp(DELTAS, self._deltas, curve), *self._tones.measure(look))
