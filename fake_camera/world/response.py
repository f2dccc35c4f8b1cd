"""Response functions of simulated sensors: what the electronics do to the linear signal before it is quantised."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Curve = NDArray[np.float64]


def _linear(signal: Curve) -> Curve:
    return signal


def _gamma(signal: Curve) -> Curve:
    """The power law of a consumer camera, 1/2.2."""
    return signal ** (1.0 / 2.2)


def _s_shaped(signal: Curve) -> Curve:
    """A film-like curve: toe in the shadows, shoulder in the highlights, over a power law."""
    lifted = signal**0.5
    return 0.4 * lifted + 0.6 * lifted * lifted * (3.0 - 2.0 * lifted)


CURVES: dict[str, Callable[[Curve], Curve]] = {"linear": _linear, "gamma": _gamma, "s_shaped": _s_shaped}
"""Response functions by name: increasing, from 0 at 0 to 1 at 1."""


def response_table(name: str, entries: int) -> NDArray[np.float64]:
    """The response to `entries` equally spaced linear signals from 0 to 1, shape (entries,), values in [0, 1].

    Raises ValueError when no response function has that name.
    """
    if name not in CURVES:
        raise ValueError(f"there is no response function {name!r}: choose one of {', '.join(CURVES)}")
    return CURVES[name](np.linspace(0.0, 1.0, entries))
