"""What was requested of control while it runs: in the status, and as the answer to a request."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from autoexpose_daemon.messages.report import LAST_COUNT
from autoexpose_daemon.status.counters import Count
from imaging.exposure import ExposureLimits, ExposureSetting
from imaging.frames import Side

LARGEST_ANSWER_BYTES = 1 << 16

_Text = Annotated[str, Field(max_length=1000)]


@dataclass(frozen=True, slots=True)
class Bounds:
    """The exposures that control may choose."""

    min_time_us: float
    max_time_us: float
    min_gain_db: float
    max_gain_db: float

    @classmethod
    def of(cls, limits: ExposureLimits) -> Bounds:
        """The bounds that limits set."""
        return cls(limits.min_time_us, limits.max_time_us, limits.min_gain_db, limits.max_gain_db)

    def __str__(self) -> str:
        return f"{self.min_time_us:g} to {self.max_time_us:g} us, {self.min_gain_db:g} to {self.max_gain_db:g} dB"


@dataclass(slots=True)
class RequestTally:
    """Which requests are in force, and how many there were.

    Attributes
    ----------
    locked
        The setting that is held; None: control decides.
    ev_stops
        Added to what the policy decides.
    changed
        Which of `policy`, `limits`, `region left` and `region right` are not as configured.
    bounds
        The exposures that control may choose; None before a camera is open.
    taken, refused
        Requests, since the cameras were opened.
    latest
        The latest request that was taken, and who asked; empty: none.
    """

    locked: ExposureSetting | None = None
    ev_stops: float = 0.0
    changed: Annotated[tuple[_Text, ...], Field(max_length=10)] = ()
    bounds: Bounds | None = None
    taken: Count = 0
    refused: Count = 0
    latest: _Text = ""

    def __str__(self) -> str:
        """What is in force, in words; empty: all is as configured."""
        parts = [] if self.locked is None else [f"locked at {self.locked}"]
        parts += [f"EV {self.ev_stops:+g}"] if self.ev_stops else []
        parts += [f"{name} changed" for name in self.changed]
        return ", ".join(parts)


@dataclass(frozen=True, slots=True)
class Shot:
    """The pair that was taken for a shot.

    Attributes
    ----------
    setting
        The setting that its frames report they were taken with.
    trigger
        The daemon's number of the trigger.
    frame_ids
        The id of each camera's frame.
    """

    setting: ExposureSetting
    trigger: Annotated[int, Field(ge=0, le=LAST_COUNT)]
    frame_ids: dict[Side, Annotated[int, Field(ge=0, lt=1 << 64)]]


@dataclass(frozen=True, slots=True)
class Answer:
    """The state of control after a request: the policy that decides, what was requested, and the pair of a shot."""

    policy: _Text
    requests: RequestTally
    shot: Shot | None = None

    def to_json(self) -> str:
        """The text that is sent."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: bytes) -> Answer | None:
        """The answer in a message; None if it is damaged."""
        if len(text) > LARGEST_ANSWER_BYTES:
            return None
        try:
            return _ADAPTER.validate_json(text)
        except ValidationError:
            return None


_ADAPTER = TypeAdapter(Answer)
