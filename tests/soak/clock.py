"""Virtual time: actors take their turns in the order in which they are due."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter

MS = 1_000_000
SECOND = 1_000_000_000


class Clock:
    """The time that all actors see (ns). A turn that takes time moves it on; the next turn begins when it is due."""

    def __init__(self) -> None:
        self.now_ns = SECOND

    def __call__(self) -> int:
        return self.now_ns


class Actor:
    """Does `turn` whenever it is due. `held_until_ns`: busy with its last turn, or stopped from outside."""

    __slots__ = ("due_ns", "held_until_ns", "turn")

    def __init__(self, turn: Callable[[], None], due_ns: float = math.inf) -> None:
        self.turn = turn
        self.due_ns = due_ns
        self.held_until_ns = 0

    def plan(self, due_ns: float) -> None:
        """The next turn: at `due_ns`, or when it is free."""
        self.due_ns = due_ns if due_ns > self.held_until_ns else self.held_until_ns

    def hold(self, until_ns: int) -> None:
        """Nothing before `until_ns`."""
        self.held_until_ns = max(self.held_until_ns, until_ns)
        self.plan(self.due_ns)


_DUE = attrgetter("due_ns")


def run(actors: list[Actor], clock: Clock, until_ns: int) -> None:
    """Let actors take their turns until a time."""
    while (actor := min(actors, key=_DUE)).due_ns <= until_ns:
        clock.now_ns = int(actor.due_ns)
        actor.turn()
    clock.now_ns = until_ns
