"""What a decision rests on, as a daemon sends it to who asks, to be drawn: plain data, as JSON."""

from __future__ import annotations

from pydantic import TypeAdapter, ValidationError

from autoexpose_daemon.control.grounds import Grounds

LARGEST_GROUNDS_BYTES = 1 << 16
"""Four times what those of two cameras take."""

_ADAPTER: TypeAdapter[Grounds | None] = TypeAdapter(Grounds | None)


def grounds_to_json(grounds: Grounds | None) -> bytes:
    """The message; there are none if the policy has no belief."""
    return _ADAPTER.dump_json(grounds)


def grounds_from_json(data: bytes) -> Grounds | None:
    """What is in a message; None, too, if that is damaged."""
    try:
        grounds = _ADAPTER.validate_json(data) if len(data) <= LARGEST_GROUNDS_BYTES else None
    except ValidationError:
        return None
    return grounds if grounds is not None and grounds.is_whole else None
