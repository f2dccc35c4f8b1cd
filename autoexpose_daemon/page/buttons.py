"""What the page's buttons ask of control, for those who have the token."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Sequence
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response

from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.page.body import read_body
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
