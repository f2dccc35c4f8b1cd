"""How the samples of the robot's IMU are used."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from autoexpose_daemon.control.parameters import FASTEST_TURN_RAD_S
from autoexpose_daemon.status.counters import Count


@dataclass(slots=True)
class ImuTally:
    """Counts of one IMU, and what the latest decision used.

    Attributes
    ----------
    samples, refused
        Messages with an angular rate, and messages without a credible one.
    angular_rate_rad_s
        The rate that the latest decision used; None: it used optical flow.
    trouble
        Why decisions use optical flow, or did less than a second ago, in words; empty if they do not.
    """

    samples: Count = 0
    refused: Count = 0
    angular_rate_rad_s: Annotated[float, Field(ge=0, le=FASTEST_TURN_RAD_S)] | None = None
    trouble: str = ""
