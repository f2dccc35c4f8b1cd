"""The page as an ASGI application: its routes, its buttons, and the state behind them."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.client.status_client import SILENT_S, StatusClient
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.page.access import Access, Key, read_body
from autoexpose_daemon.page.live import serve_browser
from autoexpose_daemon.page.metrics import CONTENT_TYPE, exposition
from autoexpose_daemon.page.pair_views import ExposureHistory, PairViews
from imaging.errors import AutoexposeError

ASKED: Final = frozenset({"locked", "ev_stops", "policy", "reset"})
"""What there are buttons for, as in `config.request.Request`; the rest is for `autoexpose ctl`."""

NAME: Final = "page"
"""Who asks, for the daemon's log."""

_LONGEST: Final = 1024


class Buttons:
    """Passes requests on to the daemon, one at a time, as `autoexpose ctl` does."""

    def __init__(self, rig: str, connect: Sequence[str]) -> None:
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
            return control.ask(changes).requests.latest


STATIC = Path(__file__).with_name("static")

_STATUS_PERIOD_S = 1.0


def page_app(rig: str, connect: Sequence[str], key: Key | None) -> ASGIApp:
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

    policies = None if key is None else POLICY_IDS

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
        applied = status.cameras["left"].applied if "left" in status.cameras else None
        heard_s = time.monotonic() - client.silent_s
        if applied is not None and heard_s > views.pair_s:
            history.add(heard_s, applied, status.decision)


def _file(name: str) -> Callable[[Request], Awaitable[Response]]:
    async def answer(_request: Request) -> Response:
        return FileResponse(STATIC / name)

    return answer
