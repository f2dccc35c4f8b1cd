"""`autoexpose top`: a running daemon, or every rig in one line, seen from a terminal."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from autoexpose_daemon.client.status_client import MOST_RIGS, Condition, FleetClient, RigLine, StatusClient
from autoexpose_daemon.status.document import Fault, Status
from autoexpose_daemon.status.panel import COLOURS, duration_text, plain, policies_of, table_of
from imaging.errors import AutoexposeError

_PATIENCE_S = 5.0
_SILENT_S = 3.0
_TURN_S = 0.25
_SHOWN_FAULTS = 8
_HISTORY = 60
_BESIDE_CURVES = 58  # columns: the frame, the longest name, a range
_LEAST_CURVE = 10
_TALL = 1000
_LARGEST = 1e15
_METRIC = "metric"
_BLOCKS = "\u2581\u2582\u2583\u2584\u2585\u2586\u2587\u2588"


def show_once(rig: str, connect: Sequence[str] | None, console: Console, zenoh_file: Path | None = None) -> None:
    """Print the next status; raises AutoexposeError if none arrives for some seconds."""
    with StatusClient(rig, connect, zenoh_file) as client:
        status = client.wait(_PATIENCE_S)
        if status is None:
            raise AutoexposeError(no_status(client))
        console.print(panel_of(status, Sparklines(), client.silent_s, _TALL, console.width))


def follow(
    rig: str, connect: Sequence[str] | None, console: Console, stop: threading.Event, zenoh_file: Path | None = None
) -> None:
    """Show the status in the terminal until `stop` is set; raises AutoexposeError without a terminal."""
    if not console.is_terminal:
        raise AutoexposeError("top needs a terminal: add --once to print the current status")
    sparklines = Sparklines()
    with StatusClient(rig, connect, zenoh_file) as client, Live(console=console, auto_refresh=False) as live:
        while not stop.wait(_TURN_S):
            status = client.status
            if status is None:
                live.update(plain(no_status(client)), refresh=True)
            else:
                sparklines.add(status)
                panel = panel_of(status, sparklines, client.silent_s, console.height, console.width)
                live.update(panel, refresh=True)


class Sparklines:
    """Curves of exposure time, gain and metric of each group over the last minute."""

    def __init__(self) -> None:
        self._time_s = 0.0
        self._groups: list[str] = []
        self._rows: dict[str, deque[float]] = {}

    def add(self, status: Status) -> None:
        """Add a status; one that was added before is ignored."""
        if status.unix_time_s == self._time_s:
            return
        self._time_s = status.unix_time_s
        if self._groups != list(status.by_group):  # at first, and after a reload
            self._groups = list(status.by_group)
            self._rows.clear()
        for name, group in status.by_group.items():
            of_group = f"{name}: " if len(status.by_group) > 1 else ""
            applied = status.setting_of(group)
            values = {} if applied is None else {"exposure, us": applied.exposure_time_us, "gain, dB": applied.gain_db}
            metric = None if group.decision is None else group.decision.metric
            values |= {} if metric is None else {_METRIC: metric}
            for what, value in values.items():
                if abs(value) < _LARGEST:  # and not NaN
                    self._rows.setdefault(of_group + what, deque(maxlen=_HISTORY)).append(value)

    def add_rows(self, table: Table, width: int) -> None:
        """Add a row for each curve in a terminal so wide: name, range and as much of the curve as there is room for."""
        newest = min(max(width - _BESIDE_CURVES, _LEAST_CURVE), _HISTORY)
        for name, values in self._rows.items():
            decimals = 4 if name.endswith(_METRIC) else 1
            shown = list(values)[-newest:]
            low, high = (f"{value:.{decimals}f}" for value in (min(shown), max(shown)))
            table.add_row(
                plain(name), f"{low if low == high else f'{low} to {high}':17}  [cyan]{sparkline(shown)}[/cyan]"
            )


def sparkline(values: Sequence[float]) -> str:
    """A curve drawn in block characters."""
    low, high = min(values), max(values)
    scale = (len(_BLOCKS) - 1) / (high - low) if high > low else 0.0
    return "".join(_BLOCKS[round((value - low) * scale)] for value in values)


def panel_of(status: Status, sparklines: Sparklines, silent_s: float, height: int, width: int) -> Panel:
    """A panel of at most `height` lines, in a terminal so wide, for a status received `silent_s` ago."""
    title = f"autoexpose {status.rig}, {policies_of(status)}, up {duration_text(status.uptime_s)}"
    colour = COLOURS[status.state]
    if silent_s > _SILENT_S:
        colour = "red"
        since = duration_text(silent_s)
        title += f": {f'ended {since} ago' if status.ending else f'silent for {since}'}; this is its last status"
    table = table_of(status)
    sparklines.add_rows(table, width)
    parts: list[RenderableType] = [table]
    if status.faults:
        room = height - table.row_count - 3  # the border, and the title of the faults
        parts.append(_faults(status.faults[-min(max(room, 1), _SHOWN_FAULTS) :]))
    return Panel(Group(*parts), title=plain(title, colour), expand=False, border_style=colour)


def _faults(faults: Sequence[Fault]) -> Table:
    table = Table(box=None, title="latest faults", title_justify="left", show_header=False, padding=(0, 2, 0, 0))
    for fault in faults:
        when = datetime.fromtimestamp(fault.unix_time_s).strftime("%d %b %H:%M:%S")
        table.add_row(when, plain(fault.message, "" if fault.level == "WARNING" else "red"))
    return table


def no_status(client: StatusClient) -> str:
    """Why there is no status, in words."""
    rig, where, since = client.rig, client.endpoints, f"for {client.silent_s:.0f} s"
    if client.trouble:
        section = "{}" if rig == "rig" else f"{{rig: {rig}}}"
        return (
            f"no answer from {where} {since}: is the daemon running, with `publish: {section}` in its configuration?"
            f"{where.hint()}"
        )
    return f"no status from a rig named {rig} at {where} {since}: is that its publish.rig, and is the daemon running?"


_ROUND_S = 2.0
"""Every rig reports within this time, unless it is silent."""
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


def show_all_once(
    connect: Sequence[str] | None, zenoh_file: Path | None, console: Console, stop: threading.Event
) -> None:
    """Print the rigs that report within a few seconds; raises AutoexposeError if there are none."""
    with FleetClient(connect, zenoh_file) as client:
        if not client.heard.wait(_PATIENCE_S):
            raise AutoexposeError(no_rig(client))
        stop.wait(_ROUND_S)
        console.print(panel_of_all(client, _TALL))


def follow_all(connect: Sequence[str] | None, zenoh_file: Path | None, console: Console, stop: threading.Event) -> None:
    """Show all rigs in the terminal until `stop` is set; raises AutoexposeError without a terminal."""
    if not console.is_terminal:
        raise AutoexposeError("top needs a terminal: add --once to print the rigs that report at present")
    with FleetClient(connect, zenoh_file) as client, Live(console=console, auto_refresh=False) as live:
        while not stop.wait(_TURN_S):
            shown = panel_of_all(client, console.height) if client.heard.is_set() else plain(no_rig(client))
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


def panel_of_all(client: FleetClient, height: int) -> Panel:
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
    parts: list[RenderableType] = [table_of_all(lines[:shown]), *(plain(note, "yellow") for note in notes)]
    return Panel(Group(*parts), title=plain(summary(lines), worst), expand=False, border_style=worst)


def table_of_all(lines: Sequence[RigLine]) -> Table:
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
    age, silent = duration_text(line.age_s), line.condition is Condition.SILENT
    since = f"{line.condition} for {age}" if silent else f"{line.condition}, {age} ago"
    yield plain(line.rig)
    yield plain(line.condition if heard else since, _COLOURS[line.condition])
    yield plain(f"{line.rate_hz:.1f}" if heard else "")
    yield plain(str(line.lost), "" if heard else "dim")
    yield plain(f"{line.lost_share:.1%}" if heard else "")
    yield plain("" if line.setting is None else str(line.setting), "" if heard else "dim")
    why = plain(line.why)
    why.no_wrap, why.overflow = True, "ellipsis"
    yield why


def _notes(client: FleetClient, now_s: float) -> Iterator[str]:
    if client.unanswered:
        yield f"no answer from {', '.join(client.unanswered)}"
    if client.fleet.crowded(now_s):
        yield f"more rigs report than the {MOST_RIGS} that were heard first, which are listed"
