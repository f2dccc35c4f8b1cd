"""The command line, `autoexpose COMMAND`. Each command imports what it needs: numpy and the like take half a second."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from importlib.metadata import entry_points, version
from typing import Annotated

import typer

from autoexpose_daemon.cli.consumers import page, ros2, top
from autoexpose_daemon.cli.daemon import record, replay, run
from autoexpose_daemon.cli.inspection import check_config, doctor, features, list_cameras
from autoexpose_daemon.cli.simulated import demo, fake_camera
from imaging.errors import AutoexposeError

_COMMANDS: dict[str, Callable[..., None]] = {
    "run": run, "record": record, "replay": replay, "demo": demo, "page": page, "top": top, "ros2": ros2,
    "list": list_cameras, "doctor": doctor, "features": features,
}  # fmt: skip

app = typer.Typer(name="autoexpose", no_args_is_help=True, pretty_exceptions_enable=False)
for name, command in _COMMANDS.items():
    app.command(name)(command)
app.command(
    "fake-camera", context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
)(fake_camera)
config_app = typer.Typer(help="Work with configuration files.", no_args_is_help=True)
config_app.command("check")(check_config)
app.add_typer(config_app, name="config")


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"autoexpose {version('autoexpose-daemon')}")
        raise typer.Exit


@app.callback()
def autoexpose(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Auto-exposure for stereo machine-vision cameras on robots."""


def main() -> None:
    """Run the command line; our own errors become one sentence on stderr and exit code 1."""
    try:
        add_commands(_requested())
        app()
    except AutoexposeError as error:
        from autoexpose_daemon.service.logs import complain  # noqa: PLC0415

        complain(str(error))
        raise SystemExit(1) from None
    except KeyboardInterrupt:  # before the command has set up its own handling
        raise SystemExit(128 + signal.SIGINT) from None


def _requested() -> str | None:
    """The command that is to run, or whose options a shell completes; None: any."""
    words = sys.argv[1:]
    if "_AUTOEXPOSE_COMPLETE" in os.environ:
        line = os.environ.get("COMP_WORDS", os.environ.get("_TYPER_COMPLETE_ARGS", ""))
        words = line.split()[1:-1]  # the last one is not complete
    elif words == ["--version"]:
        return "--version"
    return next((word for word in words if not word.startswith("-")), None)


def add_commands(requested: str | None = None) -> None:
    """Add the commands of other packages: the requested one, or all for the help; loading them takes a second."""
    if requested in (None, "ctl"):
        _add_ctl(requested)
    for point in entry_points(group="autoexpose.commands"):
        if requested in (None, point.name):
            try:
                command = point.load()
                if isinstance(command, typer.Typer):
                    app.add_typer(command, name=point.name)
                else:
                    app.command(point.name)(command)
            except ImportError as error:
                if requested is not None:
                    needs = f"`autoexpose {requested}` needs {error.name}"
                    raise AutoexposeError(
                        f"{needs}: pip install 'autoexpose-daemon[sim,calibration,experiments]'"
                    ) from error


def _add_ctl(requested: str | None) -> None:
    try:
        from autoexpose_daemon.client.ctl import ctl_app  # noqa: PLC0415  an extra
    except ImportError as error:
        if requested is not None:
            raise AutoexposeError(f"{error.name} is missing: pip install 'autoexpose-daemon[publish]'") from error
    else:
        app.add_typer(ctl_app, name="ctl")
