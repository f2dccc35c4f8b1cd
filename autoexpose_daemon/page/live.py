"""Serving one browser: numbers twice a second, and pictures as fast as it asks for them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine, Iterable, Sequence
from contextlib import suppress
from typing import Any, TypedDict

from pydantic_core import to_json
from starlette.websockets import WebSocket, WebSocketDisconnect

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.page.pair_views import LENGTH_S, ExposureHistory, PairViews
from autoexpose_daemon.status.counters import DURATIONS, Topic, counters
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import losses

CountRow = tuple[str, int, bool]
"""A label, a count, and whether the count should be 0."""

DurationRow = tuple[str, float | None, float | None]
"""A label, median and 99th percentile (ms)."""


class Tables(TypedDict):
    """Rows by the table that shows them."""

    triggers: list[CountRow]
    writes: list[CountRow]
    latency: list[DurationRow]


def tables(status: Status) -> Tables:
    """The tables of a status."""
    lost = [(f"lost {words}", count, is_fault) for words, count, is_fault in losses(status.lost)]
    triggers = status.counts.pairs + sum(status.lost.values())
    durations = ((duration.label, getattr(status, duration.field)) for duration in DURATIONS)
    pairs, *others = _counts(status, "triggers")
    return {
        "triggers": [("triggers", triggers, False), pairs, *(lost or [("lost", 0, True)]), *others],
        "writes": _counts(status, "writes"),
        "latency": [(label, measured.p50_ms, measured.p99_ms) for label, measured in durations],
    }


def _counts(status: Status, topic: Topic) -> list[CountRow]:
    rows = counters(status.counts)
    return [(counter.label, count, counter.unusual) for counter, count in rows if counter.topic == topic]


CROWDED = 4001
"""The code that closes the web socket of one viewer too many; `page.js` has it, too."""

NUMBERS_PERIOD_S = 0.5


async def serve_browser(
    socket: WebSocket, client: StatusClient, views: PairViews, history: ExposureHistory, policies: Sequence[str] | None
) -> None:
    """Serve one web socket until it closes.

    Text messages to the browser hold the numbers, binary ones a pair. Each message from the browser asks for the next
    pair: a slow or distant browser gets fewer pairs, never a queue of old ones. `policies` are those that its
    buttons may choose; None: it has no buttons.
    """
    await socket.accept()
    if views.crowded:
        return await socket.close(CROWDED)
    asked = asyncio.Event()
    with views.watched() as before:
        parts = (
            _send_numbers(socket, client, views, history, policies),
            _send_pairs(socket, views, asked, before),
            _heed(socket, asked),
        )
        await _first_of(parts)


async def _heed(socket: WebSocket, asked: asyncio.Event) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        asked.set()


async def _first_of(parts: Iterable[Coroutine[Any, Any, None]]) -> None:
    """Run them until one ends or fails, or notices that the browser is gone."""
    tasks = [asyncio.create_task(part) for part in parts]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        with suppress(WebSocketDisconnect):
            task.result()


async def _send_numbers(
    socket: WebSocket, client: StatusClient, views: PairViews, history: ExposureHistory, policies: Sequence[str] | None
) -> None:
    since_s = time.monotonic() - LENGTH_S
    while True:
        rows = history.since(since_s)
        since_s = rows[-1][0] if rows else since_s
        status = client.status
        numbers: dict[str, Any] = {
            "rig": views.rig,
            "now_s": time.monotonic(),
            "silent_s": client.silent_s,
            "trouble": client.trouble,
            "status": status,
            "tables": None if status is None else tables(status),
            "grounds": views.grounds,
            "curve": views.curve,
            "history": rows,
            "policies": policies,
        }
        await socket.send_text(to_json(numbers, inf_nan_mode="null").decode())
        await asyncio.sleep(NUMBERS_PERIOD_S)


async def _send_pairs(socket: WebSocket, views: PairViews, asked: asyncio.Event, number: int) -> None:
    """Send a pair each time that one is asked for, the first one after that of this number."""
    while True:
        await asked.wait()
        asked.clear()
        number, pair = await views.next_view(number)
        await socket.send_bytes(pair)
