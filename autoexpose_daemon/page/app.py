"""The page as an ASGI application: its routes, its buttons, and the numbers and pictures that each browser gets."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket, WebSocketDisconnect

from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.client.status_client import SILENT_S, StatusClient
from autoexpose_daemon.control.policies.ids import policy_ids
from autoexpose_daemon.own_policy.installed import register_policies
from autoexpose_daemon.page.access import Access, Key, read_body
from autoexpose_daemon.page.metrics import CONTENT_TYPE, exposition
from autoexpose_daemon.page.pair_views import LENGTH_S, ExposureHistory, PairViews
from autoexpose_daemon.status.counters import DURATIONS, Topic, counters
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import losses
from imaging.errors import AutoexposeError

CountRow = tuple[str, int, bool]
"""A label, a count, and whether the count should be 0."""


def tables(status: Status) -> dict[str, list[Any]]:
    """Rows of a status by the table that shows them: `CountRow`, or label, median and 99th percentile (ms)."""
    lost = [(f"lost {words}", count, is_fault) for words, count, is_fault in losses(status.lost)]
    triggers = status.counts.pairs + sum(status.lost.values())
    durations = ((duration.label, getattr(status, duration.field)) for duration in DURATIONS)
    pairs, *others = _counts(status, "triggers")
    if len(status.cameras) > 2:
        pairs = "whole sets", *pairs[1:]
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
        since_s = max((of_group[-1][0] for of_group in rows.values()), default=since_s)
        status = client.status
        numbers: dict[str, Any] = {
            "rig": views.rig,
            "now_s": time.monotonic(),
            "silent_s": client.silent_s,
            "trouble": client.trouble,
            "status": None if status is None else replace(status, groups=status.by_group),
            "tables": None if status is None else tables(status),
            "promises": views.promises,
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


ASKED: Final = frozenset({"group", "locked", "ev_stops", "policy", "reset"})
"""What there are buttons for, and for which group, as in `config.request.Request`; the rest is for `autoexpose ctl`."""

NAME: Final = "page"
"""Who asks, for the daemon's log."""

_LONGEST: Final = 1024


class Buttons:
    """Passes requests on to the daemon, one at a time, as `autoexpose ctl` does."""

    def __init__(self, rig: str, connect: Sequence[str] | None) -> None:
        self._rig, self._connect = rig, connect
        self._turn = asyncio.Lock()

    async def ask(self, request: Request) -> Response:
        """Answer one press: what was taken, or the sentence that says why nothing has changed."""
        body = await read_body(request, _LONGEST)
        try:
            changes = json.loads(body)
        except (ValueError, RecursionError):
            changes = None
        if not isinstance(changes, dict) or not changes or not changes.keys() <= ASKED:
            return PlainTextResponse(f"give a JSON object with some of {', '.join(sorted(ASKED))}\n", 400)
        try:
            async with self._turn:
                return PlainTextResponse(f"{await asyncio.to_thread(self._pass_on, changes)}\n")
        except AutoexposeError as error:
            return PlainTextResponse(f"{error}\n", 409)

    def _pass_on(self, changes: dict[str, Any]) -> str:
        with ControlClient(self._rig, self._connect, name=NAME) as control:
            answer = control.ask(changes)
        return "; ".join(group.requests.latest for group in answer.groups.values()) or answer.requests.latest


STATIC = Path(__file__).with_name("static")
_STATUS_PERIOD_S = 1.0


def page_app(rig: str, connect: Sequence[str] | None, key: Key | None) -> ASGIApp:
    """The page of a rig as an ASGI application; with a key, only for requests that carry it, and with buttons."""
    history = ExposureHistory()
    client = StatusClient(rig, connect)

    @asynccontextmanager
    async def fed(app: Starlette) -> AsyncIterator[None]:
        with client, PairViews(rig, connect, client, history) as views:
            app.state.views = views
            recording = asyncio.create_task(_record_status(client, views, history))
            yield
            recording.cancel()

    register_policies()
    policies = None if key is None else policy_ids()

    async def live(socket: WebSocket) -> None:
        await serve_browser(socket, client, socket.app.state.views, history, policies)

    async def metrics(_request: Request) -> Response:
        heard = client.status if client.silent_s < SILENT_S else None
        return Response(exposition(rig, heard), media_type=CONTENT_TYPE)

    routes = [
        Route("/", _file("page.html")),
        WebSocketRoute("/live", live),
        Route("/metrics", metrics),
        Mount("/static", StaticFiles(directory=STATIC)),
    ]
    if key is not None:
        routes += [Route("/login", _file("login.html")), Route("/login", key.log_in, methods=["POST"])]
        routes.append(Route("/control", Buttons(rig, connect).ask, methods=["POST"]))
    return Access(Starlette(routes=routes, lifespan=fed), key)


async def _record_status(client: StatusClient, views: PairViews, history: ExposureHistory) -> None:
    """Keep the history going from the status, one point a second, while no pairs arrive, as when nobody watches."""
    seen = None
    while True:
        await asyncio.sleep(_STATUS_PERIOD_S)
        status = client.status
        if status is None or status is seen or status.rate_hz == 0:
            continue
        seen = status
        heard_s = time.monotonic() - client.silent_s
        for name, group in status.by_group.items():
            applied = status.setting_of(group)
            if applied is not None and heard_s > views.pair_s:
                history.add(heard_s, name, applied, group.decision)


def _file(name: str) -> Callable[[Request], Awaitable[Response]]:
    async def answer(_request: Request) -> Response:
        return FileResponse(STATIC / name)

    return answer
