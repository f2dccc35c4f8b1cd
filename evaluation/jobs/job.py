"""What long work is made of: pure functions with plain arguments and plain results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

Plain: TypeAlias = "bool | int | float | str | list[Any] | dict[str, Any] | None"  # What JSON can hold, NaN included


@dataclass(frozen=True, slots=True)
class Job:
    """One piece of work, done in one process, whose result is kept."""

    # A module-level function, called with `arguments` by name. Its result must depend on nothing else.
    measure: Callable[..., Plain]
    arguments: Mapping[str, Plain]  # names, seeds and numbers
    cost_s: float = 1.0  # approximate duration (s of one core): decides the order of jobs and the time left
    # Ids of the policies that it runs, each perhaps with a colon and what alters it: its result is kept until their
    # code changes. None: any policy.
    policies: tuple[str, ...] | None = None
    # Whether those that differ in their single policy alone run as one, since they share most of the work: `measure` is
    # then also given a list of them, `policies`, and returns a list of results. None may depend on the others.
    side_by_side: bool = False
    files: tuple[str, ...] = ()  # arguments that are paths: what is in the files counts, not where they are
