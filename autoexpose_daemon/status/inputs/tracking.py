"""How consumers' reports on their tracking are used."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from autoexpose_daemon.status.counters import Count
from imaging.python310 import StrEnum


class TrackingRefusal(StrEnum):
    """Why a report was ignored; the names are fixed for log and metrics."""

    DAMAGED = "damaged"
    """It is not a TrackedCells, or not a credible one."""
    TOO_OFTEN = "too_often"
    """More reports arrived between two frames than are looked at."""
    NO_CAMERA = "no_camera"
    """The rig has no such camera."""
    FUTURE = "future"
    """Its frame has not been taken yet."""
    STALE = "stale"
    """Its frame is too old."""
    UNKNOWN_FRAME = "unknown_frame"
    """No frame has its stamp."""
    PASSED_OVER = "passed_over"
    """Control had no time for its frame, or the camera's frame was missing."""
    TOO_MANY = "too_many_consumers"
    """Enough others already report."""


@dataclass(slots=True)
class TrackingTally:
    """Counts of reports, and how the latest decision used them.

    Attributes
    ----------
    reports, refused
        Reports that were taken, and those that were refused, by reason.
    by
        The consumers that steered the latest decision; empty: none did, or the policy cannot be steered.
    age_s
        Time from the frame that the newest report is about to the frame of the decision; None: nobody steered.
    """

    reports: Count = 0
    refused: Annotated[dict[str, Count], Field(max_length=100)] = field(
        default_factory=lambda: {str(reason): 0 for reason in TrackingRefusal}
    )
    by: Annotated[tuple[str, ...], Field(max_length=100)] = ()
    age_s: Annotated[float, Field(ge=0, le=1e6)] | None = None

    def __str__(self) -> str:
        """Who steers, in words, and what was refused."""
        used = "by nobody" if self.age_s is None else f"by {', '.join(self.by)}, age {self.age_s:.1f} s"
        refused = ", ".join(f"{count} {reason}" for reason, count in self.refused.items() if count)
        return f"{used}   reports: {self.reports}, refused: {refused or 'none'}"
