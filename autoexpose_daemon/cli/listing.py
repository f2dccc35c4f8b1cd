"""The list of commands, by what a user is doing, and how the one that is asked for is loaded.

`autoexpose --help` and completion need no more than the list; to load all commands takes seconds.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

import typer
from typer.core import TyperGroup

from imaging.errors import AutoexposeError


class Listing(NamedTuple):
    """What is known of a command without loading it."""

    summary: str  # its line of the help, which fits into 80 columns
    # where its function or Typer app is, as in an entry point; empty: an entry point of `autoexpose-lab` says so
    place: str = ""
    extra: str = ""  # the extra of `autoexpose-daemon` that its module imports, in brackets


_HERE = "autoexpose_daemon.cli"

PANELS = {
    "Try it without cameras": {
        "demo": Listing("Expose two fake cameras while lights go on and off.", f"{_HERE}.cameras:demo"),
        "fake-camera": Listing("Start a fake camera, for any driver.", f"{_HERE}.cameras:fake_camera_app"),
    },
    "Find and check cameras": {
        "list": Listing("List the cameras that Aravis finds.", f"{_HERE}.cameras:list_cameras"),
        "init": Listing("Write a first configuration for the cameras found.", f"{_HERE}.first_config:init"),
        "doctor": Listing("Check what would stop the daemon: USB, network, permissions.", f"{_HERE}.cameras:doctor"),
        "features": Listing("Show a camera's features, as a configuration file.", f"{_HERE}.cameras:features"),
    },
    "Calibrate them": {
        "calibrate": Listing(
            "Measure response, noise, vignetting and geometry of cameras.",
            "calibration.commands.app:calibrate_app",
            extra="[calibration]",
        )
    },
    "Run the daemon": {
        "config": Listing("Check a configuration file.", f"{_HERE}.cameras:config_app"),
        "run": Listing("Run the daemon on the cameras of a configuration.", f"{_HERE}.daemon:run"),
        "record": Listing("Run the daemon and record what it sees and decides.", f"{_HERE}.daemon:record"),
        "ctl": Listing(
            "Change the control of a running daemon.",
            "autoexpose_daemon.client.control_client:ctl_app",
            extra="[publish]",
        ),
    },
    "Look at what it does": {
        "top": Listing("Watch a running daemon, or all of them, in the terminal.", f"{_HERE}.daemon:top"),
        "page": Listing("Serve a live page to browsers, and metrics to Prometheus.", f"{_HERE}.daemon:page"),
        "replay": Listing("Replay a recording, also with another policy.", f"{_HERE}.daemon:replay"),
    },
    "Teach and repeat a path (package autoexpose-lab)": {
        "teach": Listing("Remember a path while you drive the robot along it."),
        "repeat": Listing("Repeat a taught path. There is no obstacle detection."),
        "map": Listing("Inspect the map of a taught path."),
    },
    "Compare policies at the desk (package autoexpose-lab)": {
        "arena": Listing("Run every policy through every simulated scenario."),
        "experiments": Listing("Run the papers' experiments on a simulated rig."),
        "rejudge": Listing("Take policies through a drive recorded in brackets."),
        "train": Listing("Train a learned policy on simulated scenes."),
    },
}
LISTINGS = {name: listing for commands in PANELS.values() for name, listing in commands.items()}


class LazyGroup(TyperGroup):
    """Has stand-ins for its commands, which are enough to list them, and loads the one that is used."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Find the command that the words ask for, and load it."""
        name, command, rest = super().resolve_command(ctx, args)
        if name is not None:
            try:
                command = load_command(name)
            except AutoexposeError:
                if not ctx.resilient_parsing:  # a shell that completes gets no error, and no options
                    raise
        return name, command, rest


def load_command(name: str) -> Any:
    """Load the command of this name.

    Raises AutoexposeError if it belongs to a package that is not installed, or needs one.
    """
    listing = LISTINGS[name]
    module, _, attribute = listing.place.partition(":")
    try:
        found = getattr(import_module(module), attribute) if module else _load_entry_point(name)
    except ModuleNotFoundError as error:
        source = f"'autoexpose-daemon{listing.extra}'" if listing.place else "autoexpose-lab"
        raise AutoexposeError(
            f"`autoexpose {name}` needs {error.name}: pip install {source}, or in a checkout make setup"
        ) from error
    if isinstance(found, typer.Typer):
        return typer.main.get_command(found)
    app = typer.Typer(add_completion=False)
    app.command(name)(found)
    return typer.main.get_command(app)


def _load_entry_point(name: str) -> Any:
    from importlib.metadata import entry_points  # noqa: PLC0415  as long to load as all else that the help needs

    for point in entry_points(group="autoexpose.commands", name=name):
        return point.load()
    raise ModuleNotFoundError(name="autoexpose-lab")
