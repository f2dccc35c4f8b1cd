"""The command line, `autoexpose COMMAND`. Each command imports what it needs: numpy and the like take half a second."""

from __future__ import annotations

import signal
from contextlib import suppress
from typing import Annotated, Any

import typer

from autoexpose_daemon.cli.listing import LISTINGS, PANELS, LazyGroup, load_command
from imaging.errors import AutoexposeError

# Typer loads pydantic to make a bool of a flag that has no value.
_FLAGS = dict.fromkeys(("help", "install_completion", "show_completion"), False)

app = typer.Typer(
    name="autoexpose",
    cls=LazyGroup,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"default_map": _FLAGS},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(f"autoexpose {version('autoexpose-daemon')}")
        raise typer.Exit


@app.callback()
def autoexpose(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Auto-exposure for robots that see with one to eight machine-vision cameras."""


def _stand_in() -> None:
    """A command that has not been loaded."""


for panel, commands in PANELS.items():
    for name, listing in commands.items():
        app.command(name, help=listing.summary, rich_help_panel=panel)(_stand_in)


def whole_command_line() -> Any:
    """Make the command line with every command that is installed loaded, for manual pages and tests."""
    command_line: Any = typer.main.get_command(app)
    command_line.commands = {}
    for name in LISTINGS:
        with suppress(AutoexposeError):
            command_line.commands[name] = load_command(name)
    return command_line


def main() -> None:
    """Run the command line; our own errors become one sentence on stderr and exit code 1."""
    try:
        app()
    except AutoexposeError as error:
        from autoexpose_daemon.service.logs import complain  # noqa: PLC0415

        complain(str(error))
        raise SystemExit(1) from None
    except KeyboardInterrupt:  # before the command has set up its own handling
        raise SystemExit(128 + signal.SIGINT) from None
