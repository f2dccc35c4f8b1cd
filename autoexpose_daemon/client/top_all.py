"""`autoexpose top --all`: every rig in one line of a terminal, worst first."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from autoexpose_daemon.client.fleet import MOST_RIGS, Condition, RigLine
from autoexpose_daemon.client.fleet_client import FleetClient
from autoexpose_daemon.status.panel import duration_text, plain
from imaging.errors import AutoexposeError

_PATIENCE_S = 5.0
_ROUND_S = 2.0
"""Every rig reports within this time, unless it is silent."""
_TURN_S = 0.25
_TALL = 1000
_FRAME_LINES = 3  # the border, and the names of the columns
_LONGEST_NAME = 24

_COLOURS = {
    Condition.FAILED: "red",
    Condition.SILENT: "red",
    Condition.DEGRADED: "yellow",
    Condition.LOSING: "yellow",
    Condition.ENDED: "",
    Condition.STARTING: "cyan",
    Condition.EXPOSING: "green",
}


def show_all_once(connect: Sequence[str], zenoh_file: Path | None, console: Console, stop: threading.Event) -> None:
    """Print the rigs that report within a few seconds; raises AutoexposeError if there are none."""
    with FleetClient(connect, zenoh_file) as client:
        if not client.heard.wait(_PATIENCE_S):
            raise AutoexposeError(no_rig(client))
        stop.wait(_ROUND_S)
        console.print(panel_of(client, _TALL))


def follow_all(connect: Sequence[str], zenoh_file: Path | None, console: Console, stop: threading.Event) -> None:
    """Show all rigs in the terminal until `stop` is set; raises AutoexposeError without a terminal."""
    if not console.is_terminal:
        raise AutoexposeError("top needs a terminal: add --once to print the rigs that report at present")
    with FleetClient(connect, zenoh_file) as client, Live(console=console, auto_refresh=False) as live:
        while not stop.wait(_TURN_S):
            shown = panel_of(client, console.height) if client.heard.is_set() else plain(no_rig(client))
            live.update(shown, refresh=True)


def no_rig(client: FleetClient) -> str:
    """A sentence: no rig was heard, and what to do about it."""
    if client.unanswered:
        where = ", ".join(client.unanswered)
        return f"no answer from {where}: is a daemon with `publish`, or a router, listening there?"
    return (
        f"no rig reports at {', '.join(client.places)}: is a daemon running with `publish` in its configuration, and "
        "does its `publish.connect` name this router?"
    )


def panel_of(client: FleetClient, height: int) -> Panel:
    """All rigs in a panel of at most `height` lines: the worst, and how many more there are."""
    now_s = time.monotonic()
    lines = client.fleet.lines(now_s)
    notes = list(_notes(client, now_s))
    room = max(height - _FRAME_LINES - len(notes), 1)
    if len(lines) > room:
        shown = max(room - 1, 1)
        notes.insert(0, f"{len(lines) - shown} more, none of them worse")
    else:
        shown = len(lines)
    worst = _COLOURS[lines[0].condition] if lines else ""
    parts: list[RenderableType] = [table_of(lines[:shown]), *(plain(note, "yellow") for note in notes)]
    return Panel(Group(*parts), title=plain(summary(lines), worst), expand=False, border_style=worst)


def table_of(lines: Sequence[RigLine]) -> Table:
    """One row for each rig."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    table.add_column("rig", no_wrap=True, overflow="ellipsis", max_width=_LONGEST_NAME)
    table.add_column("state", no_wrap=True)
    table.add_column("pairs/s", no_wrap=True, justify="right")
    table.add_column("lost", no_wrap=True, justify="right")
    table.add_column("last minute", no_wrap=True, justify="right")
    table.add_column("exposure", no_wrap=True)
    table.add_column("why")  # the column that gives way if the terminal is narrow
    for line in lines:
        table.add_row(*_cells(line))
    return table


def summary(lines: Sequence[RigLine]) -> str:
    """How many rigs are in which condition."""
    counts = Counter(line.condition for line in lines)
    each = ", ".join(f"{counts[condition]} {condition}" for condition in Condition if counts[condition])
    return f"{len(lines)} rig{'' if len(lines) == 1 else 's'}: {each}"


def _cells(line: RigLine) -> Iterator[Text]:
    heard = line.condition not in (Condition.SILENT, Condition.ENDED, Condition.FAILED)
    age = duration_text(line.age_s)
    yield plain(line.rig)
    yield plain(line.condition if heard else _since(line.condition, age), _COLOURS[line.condition])
    yield plain(f"{line.rate_hz:.1f}" if heard else "")
    yield plain(str(line.lost), "" if heard else "dim")
    yield plain(f"{line.lost_share:.1%}" if heard else "")
    yield plain("" if line.setting is None else str(line.setting), "" if heard else "dim")
    why = plain(line.why)
    why.no_wrap, why.overflow = True, "ellipsis"
    yield why


def _since(condition: Condition, age: str) -> str:
    return f"{condition} for {age}" if condition is Condition.SILENT else f"{condition}, {age} ago"


def _notes(client: FleetClient, now_s: float) -> Iterator[str]:
    if client.unanswered:
        yield f"no answer from {', '.join(client.unanswered)}"
    if client.fleet.crowded(now_s):
        yield f"more rigs report than the {MOST_RIGS} that were heard first, which are listed"
