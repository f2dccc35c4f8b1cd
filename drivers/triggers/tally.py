"""What became of the triggers of a rig, counted: each is a pair, or lost for one reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from drivers.triggers.outcomes import Fate, Outcome
from imaging.frames import Side
from imaging.python310 import StrEnum


class LossReason(StrEnum):
    """Why a trigger made no pair; the names are fixed for logs, JSON and metrics."""

    STARTUP = "startup"
    SHUTDOWN = "shutdown"
    LEFT_MISSING = "left_missing"
    RIGHT_MISSING = "right_missing"
    BOTH_MISSING = "both_missing"
    INCOMPLETE = "incomplete"
    NOT_GIVEN = "not_given"
    TRIGGER_IGNORED = "trigger_ignored"
    CAMERA_GONE = "camera_gone"
    STALE = "stale"


_BLAME: Final = (
    (Fate.GONE, LossReason.CAMERA_GONE),
    (Fate.STARTUP, LossReason.STARTUP),
    (Fate.INCOMPLETE, LossReason.INCOMPLETE),
    (Fate.NOT_GIVEN, LossReason.NOT_GIVEN),
    (Fate.IGNORED, LossReason.TRIGGER_IGNORED),
    (Fate.SILENT, LossReason.TRIGGER_IGNORED),
    (Fate.STALE, LossReason.STALE),
    (Fate.SHUTDOWN, LossReason.SHUTDOWN),
)
"""Which fate names the loss when the two cameras' fates differ; missing frames come last."""


@dataclass(slots=True)
class Tally:
    """The balance: every trigger of the window is a pair or a loss. Times are CLOCK_MONOTONIC.

    `surplus_frames` arrived between the expected triggers and belong to none of them (the trigger runs too fast).
    """

    pairs: int = 0
    lost: Counter[LossReason] = field(default_factory=Counter)
    surplus_frames: int = 0
    window_start_ns: int | None = None
    window_end_ns: int | None = None

    @property
    def triggers(self) -> int:
        """All triggers accounted for so far."""
        return self.pairs + self.lost.total()


def stopped(outcomes: Mapping[Side, Outcome]) -> bool:
    """Whether there was no trigger: every camera that was there to show it was silent."""
    return Fate.SILENT in outcomes.values() and all(fate in (Fate.SILENT, Fate.GONE) for fate in outcomes.values())


def loss_reason(outcomes: Mapping[Side, Outcome]) -> LossReason:
    """Why a trigger with these outcomes made no pair."""
    for fate, reason in _BLAME:
        if fate in outcomes.values():
            return reason
    missing = [side for side, outcome in outcomes.items() if outcome is Fate.MISSING]
    match missing:
        case ["left"]:
            return LossReason.LEFT_MISSING
        case ["right"]:
            return LossReason.RIGHT_MISSING
        case []:  # the frame arrived after its partner had been used alone, or is of another instant
            return LossReason.STALE
        case _:
            return LossReason.BOTH_MISSING
