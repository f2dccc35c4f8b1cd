"""What a consumer of frames reports to the daemon once a second, in JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Final

LARGEST_REPORT_BYTES: Final = 1024
"""The five counts of a report take at most 170."""

LAST_COUNT: Final = (1 << 63) - 1
"""The highest count that is believed if another process sends it."""


@dataclass(slots=True)
class ConsumerTally:
    """A consumer's own count of pairs, since it started.

    Attributes
    ----------
    pairs
        Handed to the consumer.
    missed
        Frames of the left camera between these pairs, by gaps in its frame id: lost anywhere, for any reason.
    lost
        Pairs that the daemon sent, but that never arrived complete.
    too_slow
        Pairs that arrived, and were replaced by newer ones before the consumer asked.
    alone
        Triggers with a frame of only one camera.

    Raises
    ------
    ValueError
        For a count that is not credible.
    """

    pairs: int = 0
    missed: int = 0
    lost: int = 0
    too_slow: int = 0
    alone: int = 0

    def __post_init__(self) -> None:
        counts = (getattr(self, name) for name in self.__slots__)
        if not all(type(count) is int and 0 <= count <= LAST_COUNT for count in counts):
            raise ValueError(f"counts are whole numbers of 0 to {LAST_COUNT}")

    def to_json(self) -> str:
        """The text that is sent to the daemon."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> ConsumerTally | None:
        """The counts in a report; None if it is damaged."""
        if len(text) > LARGEST_REPORT_BYTES:
            return None
        try:
            report = json.loads(text)
            return cls(**{name: report[name] for name in cls.__slots__})
        except (ValueError, TypeError, KeyError, RecursionError):
            return None

    def __str__(self) -> str:
        losses = {"missed": self.missed, "lost": self.lost, "too slow": self.too_slow, "lone frames": self.alone}
        return ", ".join([f"{self.pairs} pairs", *(f"{count} {name}" for name, count in losses.items() if count)])
