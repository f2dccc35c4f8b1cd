"""What happened to the pairs to be published, and what consumers report."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from autoexpose_daemon.messages.report import ConsumerTally
from imaging.python310 import StrEnum

GONE_NS = 5_000_000_000
"""A consumer that has been silent this long has left; consumers report once a second."""

MOST_LISTED = 32
MOST_KNOWN = 1024
"""How many consumers are listed, and how many remembered: anyone can send reports, under invented names."""


class DropReason(StrEnum):
    """Why a pair was not published; the names are fixed for log and metrics."""

    NOT_OPEN = "not_open"
    """There was no session."""
    BEHIND = "behind"
    """The publisher was still busy with earlier pairs when newer ones arrived."""
    REFUSED = "refused"
    """zenoh rejected it."""


@dataclass(slots=True)
class _Consumer:
    since_ns: int
    heard_ns: int
    tally: ConsumerTally
    takes_pairs: bool = False


class Consumers:
    """The consumers that report, for as long as they do. Any thread may add or read; times are from CLOCK_MONOTONIC.

    Neither a name nor zenoh shows who sent a report. So consumers whose count of pairs has grown come first, then those
    known longest; invented names that do not report again make room for others.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[str, _Consumer] = {}  # the one heard longest ago comes first

    def heard(self, name: str, tally: ConsumerTally, now_ns: int) -> bool:
        """Note a report; True if it first shows that this consumer takes pairs, and all consumers are listed."""
        with self._lock:
            self._forget(now_ns)
            consumer = self._known.pop(name, None)
            if consumer is None:
                self._make_room()
                consumer = _Consumer(now_ns, now_ns, tally)
            begins = not consumer.takes_pairs and tally.pairs > consumer.tally.pairs
            self._known[name] = consumer
            consumer.heard_ns, consumer.tally = now_ns, tally
            consumer.takes_pairs |= begins
            return begins and len(self._known) <= MOST_LISTED

    def listed(self, now_ns: int) -> Mapping[str, ConsumerTally]:
        """At most `MOST_LISTED` consumers that report, and their last reports."""
        with self._lock:
            self._forget(now_ns)
            order = sorted(self._known.items(), key=lambda item: (not item[1].takes_pairs, item[1].since_ns))
            return {name: consumer.tally for name, consumer in order[:MOST_LISTED]}

    def unlisted(self, now_ns: int) -> int:
        """How many more consumers report."""
        with self._lock:
            self._forget(now_ns)
            return max(0, len(self._known) - MOST_LISTED)

    def _forget(self, now_ns: int) -> None:
        while self._known and now_ns - self._known[first := next(iter(self._known))].heard_ns >= GONE_NS:
            del self._known[first]

    def _make_room(self) -> None:
        if len(self._known) == MOST_KNOWN:
            idle = (name for name, consumer in self._known.items() if not consumer.takes_pairs)
            del self._known[next(idle, next(iter(self._known)))]


@dataclass(slots=True)
class PublishTally:
    """Counts of one publisher: each pair offered was sent, was dropped for one reason, or is waiting.

    Attributes
    ----------
    trouble
        Why there is no session, in words; empty if there is one.
    consumers
        The consumers that report.
    """

    offered: int = 0
    sent: int = 0
    dropped: Counter[DropReason] = field(default_factory=Counter)
    trouble: str = ""
    consumers: Consumers = field(default_factory=Consumers)
