"""The live view: a panel that follows the daemon in a terminal, plain log lines everywhere else."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.logging import RichHandler
from rich.panel import Panel
from rich.table import Table

from autoexpose_daemon.states import Health
from autoexpose_daemon.telemetry import Telemetry

log = logging.getLogger(__name__)

_LINE_PERIOD_S = 5.0


def set_up_logging(console: Console) -> None:
    """Log through rich in a terminal, and as plain lines (systemd adds the time) elsewhere."""
    if console.is_terminal:
        handler: logging.Handler = RichHandler(console=console, show_path=False, log_time_format="%H:%M:%S")
        handler.setFormatter(logging.Formatter("%(message)s"))
    else:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(levelname)s %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    for package in ("autoexpose_daemon", "drivers"):
        logging.getLogger(package).setLevel(logging.INFO)


Show = Callable[[Telemetry, Health], None]


@contextmanager
def display(console: Console, title: str) -> Iterator[Show]:
    """What shows the telemetry of a moment: a panel in a terminal, else a line of the log now and then."""
    started_s = time.monotonic()
    if console.is_terminal:
        with Live(console=console, auto_refresh=False, transient=False) as live:

            def show(telemetry: Telemetry, health: Health) -> None:
                heading = f"{title}, {time.monotonic() - started_s:.0f} s, {health}"
                live.update(panel(telemetry, heading), refresh=True)

            yield show
    else:
        said_s = started_s

        def say(telemetry: Telemetry, _health: Health) -> None:
            nonlocal said_s
            if time.monotonic() - said_s >= _LINE_PERIOD_S:
                said_s = time.monotonic()
                log.info("%s", telemetry.line(time.monotonic_ns()))

        yield say


def panel(telemetry: Telemetry, title: str) -> Panel:
    """The live view's picture of one moment."""
    table = Table.grid(padding=(0, 3))
    for side, camera in list(telemetry.cameras.items()):  # the control thread adds to it
        table.add_row(f"{side} camera", camera)
    table.add_row("pairs", f"{telemetry.pairs}   {telemetry.rate_hz(time.monotonic_ns()):.1f} per second")
    lost = ", ".join(f"{reason} {count}" for reason, count in telemetry.lost.items() if count)
    table.add_row("lost", lost or "none")
    for name, count in telemetry.oddities.items():
        table.add_row(name, str(count))
    if telemetry.applied is not None:
        applied = telemetry.applied
        table.add_row("exposure", f"{applied.exposure_time_us:.0f} us   gain {applied.gain_db:.1f} dB")
        table.add_row("level E", f"{applied.level:.2f} stops  {_bar(applied.level, 4.0, 18.0)}")
    if telemetry.decision is not None:
        decision = telemetry.decision
        table.add_row("metric", f"{decision.metric:.4f}")
        table.add_row("saturated", f"{decision.saturated_share:.0%}   black {decision.black_share:.0%}")
        table.add_row("decision", decision.reason)
    for side, grey in list(telemetry.drift_grey.items()):
        table.add_row(f"{side} response", f"off by {grey:.1f} grey levels")
    for name, text in telemetry.publishing.lines() if telemetry.publishing is not None else ():
        table.add_row(name, text)
    for name, durations in (
        ("decision time", telemetry.decision_ms),
        ("write time", telemetry.write_ms),
        ("frame to node", telemetry.frame_to_node_ms),
    ):
        percentiles = durations.percentiles()
        if percentiles["p50"] is not None:
            table.add_row(name, f"{percentiles['p50']:.2f} ms   p99 {percentiles['p99']:.2f} ms")
    return Panel(Group(table), title=title, expand=False, border_style="cyan")


def _bar(value: float, low: float, high: float, width: int = 28) -> str:
    filled = round(width * min(max((value - low) / (high - low), 0.0), 1.0))
    return "[cyan]" + "\u2588" * filled + "[/cyan]" + "\u2591" * (width - filled)
