"""Lost triggers, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from drivers.triggers.outcomes import LossReason

_EDGES: dict[str, str] = {
    LossReason.STARTUP: "before every camera was open",
    LossReason.SHUTDOWN: "at the end",
}
"""The losses of every start and every end, which need no investigation."""
_FAULTS: dict[str, str] = {
    LossReason.LEFT_MISSING: "without the left frame",
    LossReason.RIGHT_MISSING: "without the right frame",
    LossReason.BOTH_MISSING: "without either frame",
    LossReason.INCOMPLETE: "with an incomplete frame",
    LossReason.NOT_GIVEN: "not triggered in time",
    LossReason.TRIGGER_IGNORED: "ignored by a camera",
    LossReason.CAMERA_GONE: "while a camera was gone",
    LossReason.STALE: "seen too late",
}


def losses(lost: Mapping[str, int]) -> Iterator[tuple[str, int, bool]]:
    """Each reason that has cost triggers: in words, how many, and whether it is a fault."""
    for reason, count in lost.items():
        if count:
            yield _EDGES.get(reason) or _FAULTS.get(reason, reason), count, reason not in _EDGES


def lost_in_words(lost: Mapping[str, int], note: str = "") -> str:
    """Losses by reason, those of start and end separately; `note` goes after the faults."""
    faults = ", ".join(f"{count} {words}" for words, count, is_fault in losses(lost) if is_fault)
    edges = ", ".join(f"{count} {words}" for words, count, is_fault in losses(lost) if not is_fault)
    return "; ".join([(faults or "none") + note, *([edges] if edges else [])])
