"""A daemon's status for people: a live table in terminals, lines for the log."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from queue import SimpleQueue
from threading import Thread

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.status.counters import DURATIONS, unusual_counts
from autoexpose_daemon.status.document import CameraStatus, DurationStatus, GroupStatus, PublishStatus, Status
from autoexpose_daemon.status.states import State
from drivers.triggers.outcomes import MISSING, LossReason
from imaging.exposure import ExposureSetting

log = logging.getLogger(__name__)

_EDGES: dict[str, str] = {
    LossReason.STARTUP: "before every camera was open",
    LossReason.SHUTDOWN: "at the end",
}
"""The losses of every start and every end, which need no investigation."""
_FAULTS: dict[str, str] = {
    LossReason.BOTH_MISSING: "without either frame",
    LossReason.SEVERAL_MISSING: "without several frames",
    LossReason.INCOMPLETE: "with an incomplete frame",
    LossReason.NOT_GIVEN: "not triggered in time",
    LossReason.TRIGGER_IGNORED: "ignored by a camera",
    LossReason.CAMERA_GONE: "while a camera was gone",
    LossReason.STALE: "seen too late",
}


def losses(lost: Mapping[str, int]) -> Iterator[tuple[str, int, bool]]:
    """Each reason that has cost triggers: in words, how many, and whether it is a fault."""
    for reason, count in lost.items():
        if count:
            yield _EDGES.get(reason) or _fault(reason), count, reason not in _EDGES


def _fault(reason: str) -> str:
    camera = reason.removesuffix(MISSING)
    return _FAULTS.get(reason) or (reason if camera == reason else f"without the {camera} frame")


def lost_in_words(lost: Mapping[str, int], note: str = "") -> str:
    """Losses by reason, those of start and end separately; `note` goes after the faults."""
    faults = ", ".join(f"{count} {words}" for words, count, is_fault in losses(lost) if is_fault)
    edges = ", ".join(f"{count} {words}" for words, count, is_fault in losses(lost) if not is_fault)
    return "; ".join([(faults or "none") + note, *([edges] if edges else [])])


COLOURS = {State.STARTING: "cyan", State.EXPOSING: "green", State.DEGRADED: "yellow", State.FAILED: "red"}
_LEVELS = (4.0, 18.0)  # stops: 16 us without gain, 8 ms with 30 dB
_BAR_WIDTH = 28


def table_of(status: Status) -> Table:
    """A status as rows of a name and a text."""
    table = Table.grid(padding=(0, 3))
    table.add_row("state", plain(str(status.health), COLOURS[status.state]))
    for name, text in _rows(status):
        table.add_row(plain(name), plain(text))
    return table


def plain(text: str, style: str = "") -> Text:
    """The text as it is, without markup or anything that a terminal would take for a command."""
    return Text("".join(letter if letter.isprintable() else "?" for letter in text), style)


def duration_text(seconds: float) -> str:
    """A duration in a unit that suits its length."""
    minutes, hours = int(seconds // 60), int(seconds // 3600)
    if hours >= 48:
        return f"{hours // 24} d {hours % 24} h"
    if hours:
        return f"{hours} h {minutes % 60} min"
    return f"{minutes} min" if minutes >= 2 else f"{seconds:.0f} s"


def line_of(status: Status) -> str:
    """A status in one line."""
    parts = [f"{status.rate_hz:.1f} pairs/s", f"{status.counts.pairs} pairs", f"lost: {_counts(status.lost)}"]
    for name, group in status.by_group.items():
        said = "; ".join(_in_line(group, status.setting_of(group)))
        parts += [f"{name} {said}" if len(status.by_group) > 1 else said] if said else []
    parts += [f"{name} {text}" for name, text in _responses(status)]
    parts += [f"{counter.label}: {count}" for counter, count in unusual_counts(status.counts)]
    parts += [f"{name} {text}" for name, text in _outlets(status)]
    if status.frame_to_node_ms.p50_ms is not None:
        p50_ms, p99_ms = status.frame_to_node_ms.p50_ms, status.frame_to_node_ms.p99_ms
        parts.append(f"frame to node {p50_ms:.1f} ms, 99 of 100 within {p99_ms:.1f} ms")
    return "; ".join(parts)


def _in_line(group: GroupStatus, applied: ExposureSetting | None) -> Iterator[str]:
    if applied is not None:
        yield str(applied)
    if group.decision is not None and group.decision.metric is not None:
        yield f"metric {group.decision.metric:.4f}"
    if requested := str(group.requests):
        yield f"requested: {requested}"


def _rows(status: Status) -> Iterator[tuple[str, str]]:
    absent = "not open yet" if status.state is State.STARTING else "gone"
    for name, camera in status.cameras.items():
        lost = f"   lost: {camera.lost}" if camera.lost and len(status.cameras) > 2 else ""  # of two, the reasons tell
        yield f"{name} camera", _camera(camera, absent) + lost
    yield "pairs", f"{status.counts.pairs}   {status.rate_hz:.1f} per second   for {duration_text(status.open_s)}"
    yield "lost", lost_in_words(status.lost)
    yield from ((counter.label, str(count)) for counter, count in unusual_counts(status.counts))
    groups = [(name, group, status.setting_of(group)) for name, group in status.by_group.items()]
    if len(groups) > 1:
        yield from ((f"group {name}", "   ".join(_of_several(group, applied))) for name, group, applied in groups)
    else:
        yield from (row for _, group, applied in groups for row in _of_one(group, applied))
    yield from _responses(status)
    yield from _outlets(status)
    for duration in DURATIONS:
        yield from ((duration.label, text) for text in _percentiles(getattr(status, duration.field)))


def _of_one(group: GroupStatus, applied: ExposureSetting | None) -> Iterator[tuple[str, str]]:
    if applied is not None:
        yield "exposure level", f"{applied.level:.2f} stops  {_bar(applied.level)}"
    if group.decision is not None:
        if group.decision.metric is not None:
            yield "metric", f"{group.decision.metric:.4f}"
        yield "saturated", _extremes(group.decision)
        yield "decision", _decided(group.decision)
    if requested := str(group.requests):
        yield "requested", requested
    if group.flicker_hz is not None:
        yield "flicker", f"{group.flicker_hz:g} Hz"


def _of_several(group: GroupStatus, applied: ExposureSetting | None) -> Iterator[str]:
    """A group in one line, beside others."""
    yield group.policy
    if applied is not None:
        yield f"E {applied.level:.2f}"
    if group.decision is not None:
        yield from (_decided(group.decision), f"saturated {_extremes(group.decision)}")
    if requested := str(group.requests):
        yield f"requested: {requested}"
    if group.flicker_hz is not None:
        yield f"flicker {group.flicker_hz:g} Hz"


def _decided(decision: Decision) -> str:
    return f"{decision.setting}: {decision.reason}"


def _extremes(decision: Decision) -> str:
    return f"{decision.saturated_share:.0%}   black {decision.black_share:.0%}"


def _camera(camera: CameraStatus, absent: str) -> str:
    applied = "" if camera.applied is None else f"   {camera.applied}"
    ptp = "" if camera.ptp is None else f"   PTP {camera.ptp}"
    return absent if camera.camera is None else camera.camera + applied + ptp


def policies_of(status: Status) -> str:
    """The policies that decide: one, or those of the groups in their order."""
    return " and ".join(dict.fromkeys(group.policy for group in status.by_group.values()))


def newest_setting(status: Status) -> ExposureSetting | None:
    """The setting of the newest frame, of the first camera that has one."""
    return next((camera.applied for camera in status.cameras.values() if camera.applied is not None), None)


def _responses(status: Status) -> Iterator[tuple[str, str]]:
    for name, camera in status.cameras.items():
        if camera.drift_grey is not None:
            yield f"{name} response", f"off by {camera.drift_grey:.1f} grey levels"


def _outlets(status: Status) -> Iterator[tuple[str, str]]:
    if status.imu is not None:
        imu, rate_rad_s = status.imu, status.imu.angular_rate_rad_s
        used = "not used" if rate_rad_s is None else f"{rate_rad_s:.2f} rad/s"
        yield "imu", f"{used}   samples: {imu.samples}, refused: {imu.refused or 'none'}"
    if (light := status.light_ahead) is not None and (light.messages or light.refused):
        used = "not used" if light.belief is None else f"{light.belief:.0%} trusted"
        yield "light ahead", f"{used}   messages: {light.messages}, refused: {light.refused or 'none'}"
    if status.tracking is not None and (status.tracking.reports or any(status.tracking.refused.values())):
        yield "steered", str(status.tracking)
    if status.publishing is not None:
        yield from _publishing(status.publishing)
    if status.recorder is not None:
        steps, dropped = status.recorder.steps, status.recorder.dropped
        yield "recorded", status.recorder.failure or f"{steps - dropped}, dropped: {dropped or 'none'}"


def _publishing(publishing: PublishStatus) -> Iterator[tuple[str, str]]:
    yield "published", f"{publishing.sent}, dropped: {_counts(publishing.dropped)}"
    if publishing.trouble:
        yield "not published", publishing.trouble
    yield from ((f"consumer {name}", str(tally)) for name, tally in publishing.consumers.items())
    if publishing.unlisted_consumers:
        yield "consumers", f"{publishing.unlisted_consumers} more, not listed"


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} {reason}" for reason, count in counts.items() if count) or "none"


def _percentiles(durations: DurationStatus) -> Iterator[str]:
    if durations.p50_ms is not None:
        yield f"{durations.p50_ms:6.2f} ms   99 of 100 within {durations.p99_ms:6.2f} ms"


def _bar(level: float) -> str:
    low, high = _LEVELS
    filled = round(_BAR_WIDTH * min(max((level - low) / (high - low), 0.0), 1.0))
    return "\u2588" * filled + "\u2591" * (_BAR_WIDTH - filled)


_FIRST_LINE_S = 5.0
_LONGEST_PAUSE_S = 3600.0  # a log that is kept for months
_LAST_PANEL_S = 3.0


Show = Callable[[Callable[[], Status]], None]
"""Takes a function that returns the status; it is called only when the status is shown."""


def _draw(console: Console, panels: SimpleQueue[Panel | None]) -> None:
    """Draw each panel in the place of the one before, until None comes."""
    with Live(console=console, auto_refresh=False, transient=False) as live:
        while (panel := panels.get()) is not None:
            live.update(panel, refresh=True)


@contextmanager
def display(console: Console, title: Callable[[], str]) -> Iterator[Show]:
    """A function that shows the status: in a panel in a terminal, else in log lines at growing intervals.

    A thread of its own draws the panel: a terminal that takes nothing more delays nobody.

    `title` is called each time the panel is drawn.
    """
    started_s = time.monotonic()
    if console.is_terminal:
        panels: SimpleQueue[Panel | None] = SimpleQueue()
        drawing = Thread(target=_draw, args=(console, panels), name="panel", daemon=True)
        drawing.start()

        def show(read: Callable[[], Status]) -> None:
            if panels.empty():  # else the terminal is slow, or stuck
                status = read()
                heading = f"{title()}, {time.monotonic() - started_s:.0f} s"
                panels.put(Panel(table_of(status), title=heading, expand=False, border_style=COLOURS[status.state]))

        try:
            yield show
        finally:
            panels.put(None)
            drawing.join(_LAST_PANEL_S)
    else:
        next_s, pause_s = started_s + _FIRST_LINE_S, _FIRST_LINE_S

        def say(read: Callable[[], Status]) -> None:
            nonlocal next_s, pause_s
            if time.monotonic() >= next_s:
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
                next_s = time.monotonic() + pause_s
                log.info("%s", line_of(read()))

        yield say
