"""What a sweep says about a camera's response, and how well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imaging.response import ResponseFunction

ResponseModel = Literal["linear", "gamma", "emor", "free"]


@dataclass(frozen=True, slots=True, eq=False)
class ResponseSolution:
    """A response function recovered from a sweep.

    Attributes
    ----------
    response
        The response function; its log2 exposures are 0 at `response.saturation`, since a sweep fixes no scale.
    model
        The simplest kind of curve that explains the sweep as well as a free one: "linear" with clip, "gamma" (a power
        law), "emor" (a few basis curves), or "free" (each grey level separately, monotone).
    parameters
        Those of the model by name, such as {"gamma": 0.45}; empty for a free curve.
    uncertainty_stops
        Standard error of the log2 exposure of each grey level (stops), float64, shape (256,).
    covered
        The first and last grey level that the sweep itself has seen; beyond them the curve is extended. Where noise
        does not vouch for the images, those next to black and saturation do not count.
    residual_grey
        Root mean square of grey levels observed minus those predicted from the other exposures.
    uniform
        Whether the scene had one brightness only, so that grey levels cannot tell a curve from wrong exposure times.
    accurate
        The first and last of those that are known well, for which the error is stated; None: not judged yet.
    hidden_light
        The most light (saturation is 1) that black may contain, if exposures are all longer than stated.
    """

    response: ResponseFunction
    model: ResponseModel
    parameters: dict[str, float]
    uncertainty_stops: NDArray[np.float64]
    covered: tuple[int, int]
    residual_grey: float
    accurate: tuple[int, int] | None = None
    uniform: bool = False
    hidden_light: float = 1.0
