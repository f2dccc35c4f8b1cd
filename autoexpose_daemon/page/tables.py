"""The page's tables of numbers, ready to show: a browser need not know any counter by name."""

from __future__ import annotations

from typing import TypedDict

from autoexpose_daemon.status.counters import Topic, counters
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.durations import DURATIONS
from autoexpose_daemon.status.losses import losses

CountRow = tuple[str, int, bool]
"""A label, a count, and whether the count should be 0."""

DurationRow = tuple[str, float | None, float | None]
"""A label, median and 99th percentile (ms)."""


class Tables(TypedDict):
    """Rows by the table that shows them."""

    triggers: list[CountRow]
    writes: list[CountRow]
    latency: list[DurationRow]


def tables(status: Status) -> Tables:
    """The tables of a status."""
    lost = [(f"lost {words}", count, is_fault) for words, count, is_fault in losses(status.lost)]
    triggers = status.counts.pairs + sum(status.lost.values())
    durations = ((duration.label, getattr(status, duration.field)) for duration in DURATIONS)
    pairs, *others = _counts(status, "triggers")
    return {
        "triggers": [("triggers", triggers, False), pairs, *(lost or [("lost", 0, True)]), *others],
        "writes": _counts(status, "writes"),
        "latency": [(label, measured.p50_ms, measured.p99_ms) for label, measured in durations],
    }


def _counts(status: Status, topic: Topic) -> list[CountRow]:
    rows = counters(status.counts)
    return [(counter.label, count, counter.anomaly) for counter, count in rows if counter.topic == topic]
