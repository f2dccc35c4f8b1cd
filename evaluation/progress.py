"""Progress of work that takes minutes to hours: a bar with the time left, or lines where there is no terminal."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from datetime import timedelta
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

LINE_S = 60.0
"""Interval between two lines."""


class LongProgress(Progress):
    """A bar for jobs that take minutes each; one line a minute where output goes to a file or a log.

    Parameters
    ----------
    console
        Where progress is shown.
    past_s
        The speed is estimated over this many past seconds.
    clock
        Returns seconds.
    """

    def __init__(self, console: Console, past_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=console,
            speed_estimate_period=past_s,
            get_time=clock,
        )
        self._next_line_s = clock() + LINE_S

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Update as rich does; without a terminal, print a line when one is due."""
        super().update(task_id, **changes)
        now_s = self.get_time()
        if self.console.is_terminal or now_s < self._next_line_s:
            return
        self._next_line_s = now_s + LINE_S
        task = self.tasks[task_id]
        left = "" if task.time_remaining is None else f", {timedelta(seconds=math.ceil(task.time_remaining))} left"
        gone = timedelta(seconds=round(task.elapsed or 0.0))
        self.console.print(f"{task.description}: {task.percentage:.0f} % after {gone}{left}")
