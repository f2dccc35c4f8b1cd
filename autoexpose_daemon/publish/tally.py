"""What became of the frames that were to be published, and what consumers say of themselves."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum

GONE_NS = 5_000_000_000
"""A consumer that has said nothing for so long has left; it speaks once a second."""
MOST_CONSUMERS = 32
"""More are not remembered: names come from outside."""


class DropReason(StrEnum):
    """Why a pair was not published; the names are fixed for the log and metrics."""

    NOT_OPEN = "not_open"
    """There was no session."""
    BEHIND = "behind"
    """The publisher was still busy with pairs before it, and newer ones came."""
    REFUSED = "refused"
    """zenoh did not take it."""


@dataclass(slots=True)
class ConsumerTally:
    """A consumer's own count of pairs, since it started.

    Attributes
    ----------
    pairs
        Handed to the consumer.
    missed
        Frames of the left camera between these pairs, by gaps in its frame id: lost anywhere, for whatever reason.
    lost
        Pairs that the daemon sent and that never came whole.
    too_slow
        Pairs that came and made place for newer ones before the consumer asked.
    alone
        Triggers of which the daemon had one camera's frame only.
    """

    pairs: int = 0
    missed: int = 0
    lost: int = 0
    too_slow: int = 0
    alone: int = 0

    def to_json(self) -> str:
        """As it is sent to the daemon."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str | bytes) -> ConsumerTally | None:
        """What a consumer sent, or None when it is nothing of the kind."""
        try:
            counts = json.loads(text)
            return cls(**{name: int(counts[name]) for name in cls.__slots__})
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            return None

    def __str__(self) -> str:
        oddities = {"missed": self.missed, "lost": self.lost, "too slow": self.too_slow, "lone frames": self.alone}
        return ", ".join([f"{self.pairs} pairs", *(f"{count} {name}" for name, count in oddities.items() if count)])


@dataclass(slots=True)
class PublishTally:
    """Counts of one publisher: every pair offered was sent, dropped for one reason, or waits.

    Attributes
    ----------
    trouble
        Why there is no session, in words; empty when there is one.
    """

    offered: int = 0
    sent: int = 0
    dropped: Counter[DropReason] = field(default_factory=Counter)
    trouble: str = ""
    _consumers: dict[str, tuple[int, ConsumerTally]] = field(default_factory=dict)

    def heard(self, name: str, tally: ConsumerTally, now_ns: int) -> bool:
        """Note what a consumer reports, and whether it is a new one; times are CLOCK_MONOTONIC."""
        known = {other: last for other, last in self._consumers.items() if now_ns - last[0] < GONE_NS}
        new = name not in known and len(known) < MOST_CONSUMERS
        if new or name in known:
            known[name] = now_ns, tally
        self._consumers = known  # replaced, not changed: other threads read it
        return new

    def consumers(self, now_ns: int) -> Mapping[str, ConsumerTally]:
        """Those that are there, and what they last reported."""
        return {name: tally for name, (heard_ns, tally) in self._consumers.items() if now_ns - heard_ns < GONE_NS}
