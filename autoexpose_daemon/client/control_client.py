"""Asks the daemon of a rig to change its control while it runs: the same as `autoexpose ctl`, from a program."""

from __future__ import annotations

import getpass
import os
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import zenoh

from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.config.section import LONGEST_NAME
from autoexpose_daemon.messages.keys import LOOPBACK, check_rig_name, control_key
from autoexpose_daemon.publish.session import Endpoints, SessionError, open_session
from autoexpose_daemon.status.inputs import Answer, AnsweredShot
from documents.text import readable
from imaging.errors import AutoexposeError
from imaging.frames import Side
from imaging.python310 import Self

_PATIENCE_S: Final = 10.0
_LONGEST_REASON: Final = 1000

Rectangle = tuple[int, int, int, int]
"""x, y, width and height, in pixels of the frames."""


class ControlClient:
    """A connection for requests, open while its context is entered. Each call waits for the daemon's answer.

    Parameters
    ----------
    rig
        Name of the rig, `publish.rig` of the daemon's configuration.
    connect
        Endpoints of daemons or routers.
    zenoh_file
        A configuration file of zenoh, which then has the endpoints.
    name
        Who asks, for the daemon's log: 1 to 64 printable characters; None: user and host.

    Raises
    ------
    AutoexposeError
        From every call: a sentence that says why nothing has changed, from the daemon or because it cannot be reached.
    """

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] = (LOOPBACK,),
        zenoh_file: Path | None = None,
        name: str | None = None,
    ) -> None:
        check_rig_name(rig)
        self._rig = rig
        self._name = _user_and_host() if name is None else name
        self._endpoints = Endpoints.of_client(connect, zenoh_file)
        self._session: zenoh.Session | None = None

    def __enter__(self) -> Self:
        try:
            self._session = open_session("client", self._endpoints)
        except SessionError as error:
            if self._endpoints.file is not None:
                raise  # the file may be at fault
            raise self._no_answer() from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]

    def show(self) -> Answer:
        """Ask for the settings in force; changes nothing."""
        return self.ask({})

    def lock(self) -> Answer:
        """Keep the setting that was decided last."""
        return self.ask({"locked": True})

    def unlock(self) -> Answer:
        """Let the policy decide again."""
        return self.ask({"locked": False})

    def ev(self, stops: float) -> Answer:
        """Add stops to what the policy decides, -3 to 3."""
        return self.ask({"ev_stops": stops})

    def policy(self, policy_id: str) -> Answer:
        """Have another policy decide."""
        return self.ask({"policy": policy_id})

    def limits(
        self,
        min_time_us: float | None = None,
        max_time_us: float | None = None,
        min_gain_db: float | None = None,
        max_gain_db: float | None = None,
    ) -> Answer:
        """Change bounds of the exposure; None: unchanged."""
        given = {
            "min_time_us": min_time_us, "max_time_us": max_time_us,
            "min_gain_db": min_gain_db, "max_gain_db": max_gain_db,
        }  # fmt: skip
        return self.ask({"limits": given})

    def region(self, side: Side, rectangles: Sequence[Rectangle] = (), background_weight: float = 0.0) -> Answer:
        """Count only rectangles of a camera's picture, and the rest with a weight; without any, all of it."""
        boxes = [{"box": box} for box in rectangles]
        return self.ask({"region": {side: {"rectangles": boxes, "background_weight": background_weight}}})

    def shot(self, exposure_time_us: float, gain_db: float = 0.0) -> AnsweredShot:
        """Have one pair taken with another setting; returns which one that was."""
        answer = self.ask({"shot": {"exposure_time_us": exposure_time_us, "gain_db": gain_db}})
        if answer.shot is None:
            raise AutoexposeError("the daemon does not say which pair the shot is: it has another version")
        return answer.shot

    def reset(self) -> Answer:
        """Go back to the configuration."""
        return self.ask({"reset": True})

    def ask(self, changes: Mapping[str, Any]) -> Answer:
        """Make several changes at once, or none of them: keys and values as in `config.request.Request`."""
        request = new_request({"by": self._name, **changes})
        if self._session is None:
            raise AutoexposeError("this client is not open: use it in a `with` block")
        for reply in self._session.get(control_key(self._rig), payload=request.to_json(), timeout=_PATIENCE_S):
            if reply.err is not None:
                reason = reply.err.payload.to_bytes()[:_LONGEST_REASON].decode(errors="replace")
                if reason == "Timeout":  # zenoh's own
                    break
                raise AutoexposeError(readable(reason))
            if reply.ok is not None:
                answer = Answer.from_json(reply.ok.payload.to_bytes())
                if answer is None:
                    raise AutoexposeError(f"the answer for rig {self._rig} is not from a daemon of this version")
                return answer
        raise self._no_answer()

    def _no_answer(self) -> AutoexposeError:
        section = "{}" if self._rig == "rig" else f"{{rig: {self._rig}}}"
        return AutoexposeError(
            f"no answer for rig {self._rig} from {self._endpoints}: is the daemon running, with "
            f"`publish: {section}` in its configuration, and may you ask it?"
        )


def _user_and_host() -> str:
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user without a name, as in some containers
        user = str(os.getuid())
    name = "".join(letter if letter.isprintable() else "?" for letter in f"{user}@{socket.gethostname()}")
    return name[:LONGEST_NAME].strip()
