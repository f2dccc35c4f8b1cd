"""Changes the control of a running daemon: from a program, or from a terminal as `autoexpose ctl`."""

from __future__ import annotations

import getpass
import os
import socket
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer
import zenoh

from autoexpose_daemon.config.request import new_request
from autoexpose_daemon.config.section import LONGEST_NAME
from autoexpose_daemon.control.policies.ids import POLICY_IDS
from autoexpose_daemon.messages.keys import check_endpoints, check_rig_name, check_zenoh_file, rig_key
from autoexpose_daemon.publish.session import Endpoints, SessionError, open_session
from autoexpose_daemon.status.counters import Answer, AnsweredShot, GroupAnswer
from autoexpose_daemon.status.panel import plain
from documents.text import readable
from imaging.errors import AutoexposeError, ConfigurationError
from imaging.frames import CameraName
from imaging.python310 import Self

_PATIENCE_S: Final = 10.0
_LONGEST_REASON: Final = 1000

Rectangle = tuple[int, int, int, int]
"""x, y, width and height, in pixels of the frames."""


class ControlClient:
    """A connection for requests, open while its context is entered. Each call waits for the daemon's answer.

    `rig`, `connect` and `zenoh_file` are those of `RigClient`; `name` says who asks, for the daemon's log: 1 to 64
    printable characters, or None: user and host. Requests are for the cameras of `group`; None: for all. Every call
    raises AutoexposeError when nothing has changed, with a sentence that says why: the daemon's own, or that it cannot
    be reached.
    """

    def __init__(
        self,
        rig: str = "rig",
        connect: Sequence[str] | None = None,
        zenoh_file: Path | None = None,
        name: str | None = None,
        group: str | None = None,
    ) -> None:
        check_rig_name(rig)
        self._rig = rig
        self._group = group
        self._name = _user_and_host() if name is None else name
        self._endpoints = Endpoints.of_rig(rig, connect, zenoh_file)
        self._session: zenoh.Session | None = None

    def __enter__(self) -> Self:
        try:
            self._session = open_session("client", self._endpoints)
        except SessionError as error:
            if self._endpoints.file is not None:
                raise  # the file may be at fault
            raise self._no_answer() from error
        return self

    def __exit__(self, *_: object) -> None:
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

    def region(
        self, camera: CameraName, rectangles: Sequence[Rectangle] = (), background_weight: float = 0.0
    ) -> Answer:
        """Count only rectangles of a camera's picture, and the rest with a weight; without any, all of it."""
        boxes = [{"box": box} for box in rectangles]
        return self.ask({"region": {camera: {"rectangles": boxes, "background_weight": background_weight}}})

    def shot(self, exposure_time_us: float, gain_db: float = 0.0) -> AnsweredShot:
        """Have one pair taken with another setting; returns which one that was. Of several groups one must be given.

        Raises AutoexposeError when the daemon refuses, or does not answer.
        """
        answer = self.ask({"shot": {"exposure_time_us": exposure_time_us, "gain_db": gain_db}})
        if answer.shot is None:
            raise AutoexposeError("the daemon does not say which pair the shot is: it has another version")
        return answer.shot

    def reset(self) -> Answer:
        """Go back to the configuration."""
        return self.ask({"reset": True})

    def ask(self, changes: Mapping[str, Any]) -> Answer:
        """Make several changes at once, or none of them: keys and values as in `config.request.Request`.

        Raises AutoexposeError when the daemon refuses, or does not answer.
        """
        request = new_request({"by": self._name, "group": self._group, **changes})
        if self._session is None:
            raise AutoexposeError("this client is not open: use it in a `with` block")
        for reply in self._session.get(rig_key(self._rig, "control"), payload=request.to_json(), timeout=_PATIENCE_S):
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
            f"`publish: {section}` in its configuration, and may you ask it?{self._endpoints.hint()}"
        )


def _user_and_host() -> str:
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user without a name, as in some containers
        user = str(os.getuid())
    name = "".join(letter if letter.isprintable() else "?" for letter in f"{user}@{socket.gethostname()}")
    return name[:LONGEST_NAME].strip()


ctl_app = typer.Typer(
    help="Change the control of a running daemon, until it restarts or reloads.",
    no_args_is_help=True,
    add_completion=False,
)


@ctl_app.callback()
def connection(
    context: typer.Context,
    rig: Annotated[str, typer.Option(help="Name of the rig, `publish.rig` of its configuration.")] = "rig",
    connect: Annotated[
        list[str] | None,
        typer.Option(help="Endpoint of a daemon or router; the rig's socket on this machine unless given."),
    ] = None,
    zenoh: Annotated[
        Path | None, typer.Option(help="A configuration file of zenoh, for TLS and the like, instead of --connect.")
    ] = None,
    *,
    by: Annotated[str | None, typer.Option(help="Who asks, for the daemon's log; user@host unless given.")] = None,
    group: Annotated[str | None, typer.Option(help="Group of cameras that is meant; all unless given.")] = None,
) -> None:
    """Say which daemon to ask, and for which cameras; these options come before the command."""
    check_endpoints(connect or [])
    if zenoh is not None:
        check_zenoh_file(zenoh)
    context.obj = ControlClient(rig, connect or None, zenoh, by, group)


@ctl_app.command()
def show(context: typer.Context) -> None:
    """Show the settings in force."""
    _show(context, ControlClient.show)


@ctl_app.command()
def lock(context: typer.Context) -> None:
    """Keep the exposure that was decided last."""
    _show(context, ControlClient.lock)


@ctl_app.command()
def unlock(context: typer.Context) -> None:
    """Let the policy decide again."""
    _show(context, ControlClient.unlock)


@ctl_app.command(context_settings={"ignore_unknown_options": True})  # a negative number is not an option
def ev(context: typer.Context, stops: Annotated[float, typer.Argument(help="-3 to 3; 0: none.")]) -> None:
    """Add stops to what the policy decides."""
    _show(context, lambda client: client.ev(stops))


@ctl_app.command()
def policy(
    context: typer.Context, policy_id: Annotated[str, typer.Argument(help=f"One of {', '.join(POLICY_IDS)}.")]
) -> None:
    """Have another policy decide."""
    _show(context, lambda client: client.policy(policy_id))


@ctl_app.command()
def limits(
    context: typer.Context,
    min_time_us: Annotated[float | None, typer.Option(help="Shortest exposure time, us.")] = None,
    max_time_us: Annotated[float | None, typer.Option(help="Longest exposure time, us.")] = None,
    min_gain_db: Annotated[float | None, typer.Option(help="Lowest gain, dB.")] = None,
    max_gain_db: Annotated[float | None, typer.Option(help="Highest gain, dB.")] = None,
) -> None:
    """Change the bounds of the exposure; bounds that are not given stay."""
    _show(context, lambda client: client.limits(min_time_us, max_time_us, min_gain_db, max_gain_db))


@ctl_app.command()
def region(
    context: typer.Context,
    camera: Annotated[str, typer.Argument(help="Which camera, by its name in the configuration.")],
    rectangle: Annotated[
        list[str] | None,
        typer.Option(help="X,Y,WIDTH,HEIGHT in pixels of the frames; give several. Without any, everything counts."),
    ] = None,
    background: Annotated[float, typer.Option(help="Weight of what no rectangle covers, 0 to 1.")] = 0.0,
) -> None:
    """Change what counts in a camera's picture."""
    boxes = [_box(text) for text in rectangle or []]
    _show(context, lambda client: client.region(camera, boxes, background))


@ctl_app.command()
def shot(
    context: typer.Context,
    time_us: Annotated[float, typer.Option(help="Exposure time, us.")],
    gain_db: Annotated[float, typer.Option(help="Gain, dB.")] = 0.0,
) -> None:
    """Take one pair with another setting, and show which one it is."""
    with context.obj as client:
        taken: AnsweredShot = client.shot(time_us, gain_db)
    frames = ", ".join(f"{camera} frame {taken.frame_ids[camera]}" for camera in sorted(taken.frame_ids))
    typer.echo(f"trigger {taken.trigger}: {frames}, taken with {taken.setting}")


@ctl_app.command()
def reset(context: typer.Context) -> None:
    """Go back to the configuration."""
    _show(context, ControlClient.reset)


def _show(context: typer.Context, ask: Callable[[ControlClient], Answer]) -> None:
    """Send the request, and print the settings then in force."""
    with context.obj as client:
        for name, text in rows_of(ask(client)):
            typer.echo(f"{name:9} {plain(text)}")


def rows_of(answer: Answer) -> list[tuple[str, str]]:
    """The settings in force, as rows of a name and a text; of several groups, one after another."""
    if len(answer.groups) < 2:
        return _rows(answer)
    return [row for name, group in answer.groups.items() for row in (("group", name), *_rows(group))]


def _rows(answer: GroupAnswer) -> list[tuple[str, str]]:
    requests = answer.requests
    rows = [
        ("policy", answer.policy),
        ("exposure", "decided by the policy" if requests.locked is None else f"locked at {requests.locked}"),
        ("EV", f"{requests.ev_stops:+g}" if requests.ev_stops else "0"),
        ("bounds", str(requests.bounds or "unknown before a camera is open")),
        ("changed", ", ".join(requests.changed) or "nothing"),
    ]
    if requests.taken:
        rows.append(("latest", requests.latest))
    return rows


def _box(text: str) -> Rectangle:
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise ConfigurationError(f"{text} is not a rectangle: give X,Y,WIDTH,HEIGHT, such as 0,0,720,270") from None
    return x, y, width, height
