"""A bar for work that takes minutes to hours, with the time that is left."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


def long_progress(console: Console, past_s: float) -> Progress:
    """A bar for pieces of work that take minutes each: the speed is estimated over all of the last `past_s` seconds."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
        console=console,
        speed_estimate_period=past_s,
    )
