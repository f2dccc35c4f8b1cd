"""Which policy a team should run, and how sure that is: a rule that is stated before the figures are seen.

Segments of drives are compared in pairs: each policy with the present one on the same ten seconds. What says most about
localization decides first: the error of odometry, then the share of pairs that it loses, then the matches that frames
give. A policy is recommended if it is better in one of these, and worse in none that comes before it. Better: the
interval is above 0, and the difference is at least the margin. Not worse: no part of the interval is below 0 by more
than the margin. Who loses more pairs is never better, since errors are of those that are kept. Intervals hold for all
policies together, so that one of twenty is not recommended by chance. A policy with limits of its own must also be
better than the same without them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.stats import t

from evaluation.intervals import FEWEST, Interval, over_places
from evaluation.rejudge.contender import ALTERED

SEGMENT_S = 10.0
FEWEST_SEGMENTS = 6
"""With fewer nothing is decided: so few say little about how much segments differ."""

LEAST_MM = 0.1
"""Errors below are not told apart. Frames that are the very shots of the reference have none at all, and the logarithm
of a ratio with nothing would decide alone."""


@dataclass(frozen=True, slots=True)
class Margins:
    """Differences that a team does not care about, as shares."""

    odometry: float = 0.10  # of the error
    lost: float = 0.01  # of all pairs
    features: float = 0.05  # of the matches

    def of(self, name: str) -> float:
        """That of a kind of `Difference`."""
        return {"odometry": self.odometry, "lost": self.lost, "features": self.features}[name]


@dataclass(frozen=True, slots=True)
class SeenSegment:
    """What a policy's frames of one segment were worth; None: not known, for lack of a geometry or of motion."""

    drive: str
    number: int
    rpe_mm: float | None  # error of odometry; None also where it was lost altogether
    lost_share: float | None  # share of the pairs that it could not follow
    matches: float | None  # stereo matches, mean


@dataclass(frozen=True, slots=True)
class Difference:
    """A policy compared with the present one; above 0 is better. None: not known.

    The error and the matches as a share of the present policy's, lost pairs as a share of all.
    """

    policy: str
    odometry: Interval | None
    lost: Interval | None
    features: Interval | None

    @property
    def known(self) -> list[tuple[str, Interval]]:
        """What is known, in the order in which it decides."""
        found = [("odometry", self.odometry), ("lost", self.lost), ("features", self.features)]
        return [(name, interval) for name, interval in found if interval is not None]


@dataclass(frozen=True, slots=True)
class Recommendation:
    """What to run: a policy, or None to stay with the present one; and why, in words."""

    policy: str | None
    why: str
    more_minutes: int | None = None  # how much more to record, where that would decide


def differences(
    seen: Mapping[str, Sequence[SeenSegment]], present: str, percent: float | None = None
) -> list[Difference]:
    """Each other policy compared with the present one, by segments that both went through, in the same order.

    `percent` is the confidence of each interval; None: that with which they hold for all together at 95 %.
    """
    others = [policy for policy in seen if policy != present]
    level = percent if percent is not None else 100.0 - 5.0 / max(len(others), 1)
    return [_difference(policy, seen[policy], seen[present], level) for policy in others]


def _difference(policy: str, ours: Sequence[SeenSegment], theirs: Sequence[SeenSegment], percent: float) -> Difference:
    pairs = list(zip(ours, theirs, strict=True))

    def interval(rows: Sequence[tuple[SeenSegment, float, float]]) -> Interval | None:
        """Of differences with their weights. Drives are independent; few of them say too little about their spread."""
        if len(rows) < 2:
            return None
        drives = {segment.drive for segment, *_ in rows}
        whole = len(drives) >= FEWEST
        places = [segment.drive if whole else f"{segment.drive} {segment.number}" for segment, *_ in rows]
        return over_places([value for _, value, _ in rows], places, [weight for *_, weight in rows], percent)

    errors = [
        (one, math.log(max(other.rpe_mm, LEAST_MM) / max(one.rpe_mm, LEAST_MM)), 1.0)
        for one, other in pairs
        if one.rpe_mm is not None and other.rpe_mm is not None
    ]
    lost = [
        (one, other.lost_share - one.lost_share, 1.0)
        for one, other in pairs
        if one.lost_share is not None and other.lost_share is not None
    ]
    matches = [
        (one, one.matches - other.matches, other.matches)
        for one, other in pairs
        if one.matches is not None and other.matches is not None
    ]
    return Difference(
        policy,
        _as_share(interval(errors)),
        interval(lost),
        interval(matches) if any(weight > 0 for *_, weight in matches) else None,
    )


def _as_share(logs: Interval | None) -> Interval | None:
    """By how much an error is smaller, of logarithms of ratios."""
    if logs is None:
        return None
    return Interval(*(1.0 - math.exp(-value) for value in (logs.value, logs.low, logs.high)))


def decide(seen: Mapping[str, Sequence[SeenSegment]], present: str, margins: Margins = Margins()) -> Recommendation:
    """What to run, from what every policy did in the same segments. `present` is one of them."""
    minutes = len(seen[present]) * SEGMENT_S / 60.0
    said = f"{minutes:.0f} minutes" if minutes >= 2.0 else f"{60.0 * minutes:.0f} s"
    if len(seen) < 2:
        return Recommendation(None, f"there is no other policy to compare {present} with")
    found = differences(seen, present)
    if all(not one.matches for rows in seen.values() for one in rows):
        return Recommendation(
            None, f"nothing was matched, so nothing tells what frames are worth to localization: stay with {present}"
        )
    if len(seen[present]) >= FEWEST_SEGMENTS:
        better = [
            (each, by)
            for each in found
            if (by := _better_by(each, margins)) is not None and _better_than_unaltered(each.policy, seen, margins)
        ]
        if better:
            best, by = min(better, key=_order)
            return Recommendation(best.policy, f"{best.policy} rather than {present}: {_in_words(best, by)}")
        if all(each.known and _settled(each, margins) for each in found):
            return Recommendation(
                None, f"no other policy is better than {present} by more than the margins, in {said}: stay with it"
            )
    nearest = max(found, key=lambda each: each.known[0][1].value if each.known else -math.inf)
    more = _more_minutes(nearest, margins, len(seen[present]))
    return Recommendation(
        None,
        f"no difference that {said} of driving could show: stay with {present}; record about {more} more "
        f"minutes to decide, first of all about {nearest.policy}",
        more,
    )


def _better_by(one: Difference, margins: Margins) -> str | None:
    """In what it is better, while it is not worse in what comes before, and loses no more pairs."""
    if one.lost is not None and one.lost.value < -margins.lost:
        return None
    for name, interval in one.known:
        margin = margins.of(name)
        if interval.low > 0.0 and interval.value >= margin:
            return name
        if interval.low < -margin:
            return None
    return None


def _better_than_unaltered(name: str, seen: Mapping[str, Sequence[SeenSegment]], margins: Margins) -> bool:
    """True also of a policy itself, and where it was not judged."""
    policy = name.partition(ALTERED)[0]
    if policy == name or policy not in seen:
        return True
    level = 100.0 - 5.0 / max(len(seen) - 1, 1)
    return _better_by(_difference(name, seen[name], seen[policy], level), margins) is not None


def _settled(one: Difference, margins: Margins) -> bool:
    """Whether more driving would hardly make it better: surely not by more than the margin in what decides first."""
    return all(interval.high < 2.0 * margins.of(name) for name, interval in one.known[:1])


_RANK = ("odometry", "lost", "features")


def _order(entry: tuple[Difference, str]) -> tuple[int, float]:
    one, by = entry
    return _RANK.index(by), -dict(one.known)[by].value


def _in_words(one: Difference, by: str) -> str:
    words = {
        "odometry": "the error of odometry is {} smaller",
        "lost": "{} fewer of the pairs are lost",
        "features": "frames give {} more matches",
    }
    found = dict(one.known)
    parts = [words[by].format(_percent(found[by]))]
    parts += [f"{name} {_percent(interval)}" for name, interval in found.items() if name != by]
    return "; ".join(parts)


def _percent(interval: Interval) -> str:
    return f"{100 * interval.value:.1f} % [{100 * interval.low:.1f}, {100 * interval.high:.1f}]"


def _more_minutes(one: Difference, margins: Margins, segments: int) -> int:
    """How much more would decide on it, if it goes on as it has begun: intervals narrow with the root of segments.

    Those of few segments are wider still, by what is not known of the spread; that goes away with more of them.
    """
    fewest = 2.0 * FEWEST_SEGMENTS
    needed = fewest
    if one.known:
        name, interval = one.known[0]
        margin = margins.of(name)
        value, low, high = (
            -math.log(1.0 - each) if name == "odometry" else each
            for each in (interval.value, interval.low, interval.high)
        )
        half = (high - low) / 2.0 / (_student(segments) if segments < FEWEST else 1.0)
        needed = max(segments * (half / max(abs(value), margin)) ** 2, fewest, segments + 1.0)
    return max(math.ceil((needed - segments) * SEGMENT_S / 60.0), 1)


def _student(segments: int) -> float:
    """By how much an interval of few is wider than one of many with the same spread."""
    return float(t.ppf(0.995, segments - 1) / t.ppf(0.995, 1e6))
