"""Long runs: asked for, with the time they take and a place for their results; shown; kept, so that they resume."""

from __future__ import annotations

import json
import math
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from typing import Any, Generic, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from documents.files import replace_file
from imaging.errors import AutoexposeError, ConfigurationError

Asked = TypeVar("Asked")


def check_chosen(quick: bool, full: bool, takes_s: Callable[[bool], float]) -> None:
    """Raise ConfigurationError unless one of --quick and --full is given; `takes_s(quick)` estimates what it takes."""
    if quick and full:
        raise ConfigurationError("--quick and --full exclude each other: leave one out")
    if not quick and not full:
        everything, some = in_words(takes_s(False)), in_words(takes_s(True))
        raise ConfigurationError(
            f"say how much: --full takes about {everything} with these --jobs, --quick about {some}"
        )


def in_words(seconds: float) -> str:
    """A duration, rounded up."""
    minutes = math.ceil(seconds / 60)
    if minutes <= 1:
        return "a minute"
    return f"{minutes} minutes" if minutes < 90 else f"{seconds / 3600:.1f} hours"


def make_writable(folder: Path, option: str) -> None:
    """Create a folder and try it; ConfigurationError before hours of work, not after."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be written to ({error.strerror}): choose another {option}"
        ) from None


LINE_S = 60.0  # Interval between two lines


class LongProgress(Progress):
    """A bar for jobs that take minutes each; one line a minute where output goes to a file or a log. `past_s`: the
    speed is estimated over this many past seconds."""

    def __init__(self, console: Console, past_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(elapsed_when_finished=False), console=console,
            speed_estimate_period=past_s, get_time=clock,
        )  # fmt: skip
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


class KeptResults(ABC, Generic[Asked]):
    """One JSON file for each result, named by its key."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @abstractmethod
    def key(self, asked: Asked) -> str:
        """A hash, equal for what has the same result."""

    def get(self, asked: Asked) -> tuple[Any] | None:
        """The result in a tuple, because it may be None; None when no result is kept."""
        try:
            return (json.loads(self._path(asked).read_text(encoding="utf-8")),)
        except (FileNotFoundError, ValueError):
            return None

    def put(self, asked: Asked, result: Any) -> None:
        """Keep a result, atomically; AutoexposeError when it cannot be written."""
        path = self._path(asked)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, json.dumps(result).encode())
        except OSError as error:
            raise AutoexposeError(
                f"{path}: the result cannot be saved ({error.strerror}): fix that and run the same command to resume"
            ) from None

    def _path(self, asked: Asked) -> Path:
        key = self.key(asked)
        return self._folder / key[:2] / f"{key}.json"
