"""Starting the demo, with its cameras first because they take longest."""

from __future__ import annotations

import importlib.util
import os
import shutil
import tempfile
import threading
from contextlib import ExitStack
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING

from autoexpose_daemon.control.policies.ids import check_policy_id
from autoexpose_daemon.demo.fakes import (
    begin_again_on_fake_bus,
    cameras_on_bus,
    check_simulator,
    fake_cameras,
    folder_of_bus,
    take_signals,
)
from autoexpose_daemon.demo.options import DemoOptions
from autoexpose_daemon.own_policy.installed import register_policies
from autoexpose_daemon.recording import check_recording_extra
from imaging.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.console import Console


def run_demo(options: DemoOptions, stop: threading.Event, console: Console) -> None:
    """Run the daemon on fake cameras and report.

    Raises AutoexposeError when the fakes do not start, or when the daemon's account of triggers disagrees with the
    wire's.
    """
    navigation = _navigation() if options.navigate else None  # brings what the others ask for
    check_simulator()
    register_policies()
    check_policy_id(options.policy)
    if options.record is not None:
        check_recording_extra()
    if options.navigate and importlib.util.find_spec("zenoh") is None:
        raise ConfigurationError("--navigate needs the extra `publish`: pip install 'autoexpose-daemon[publish]'")
    sockets, folder_of_sockets = cameras_on_bus(), folder_of_bus()
    if sockets and folder_of_sockets is None:
        raise ConfigurationError(
            "the demo has fake cameras of its own, and here others are on the USB bus: run it outside of "
            "`python -m fake_camera.usb3`"
        )
    if options.transport == "usb3" and not sockets:
        begin_again_on_fake_bus(options.cameras)
    arguments = ["--line0", f"demo-{os.getpid()}", "--scene", options.scene, "--seed", str(options.seed)]
    arguments += ["--pixel-format", options.pixel_format, "--size", options.size]
    arguments += ["--still"] if options.still else []
    arguments += ["--steered"] if options.navigate else []
    if options.light is not None:
        arguments += ["--light", str(options.light)]
    arguments += _keep_room()
    with ExitStack() as resources:
        folder = Path(resources.enter_context(tempfile.TemporaryDirectory(prefix="autoexpose-demo-")))
        if folder_of_sockets is not None:
            resources.callback(shutil.rmtree, folder_of_sockets)
            take_signals()
        console.print(f"starting {options.cameras} fake camera{'s' if options.cameras > 1 else ''} ...")
        cameras = resources.enter_context(fake_cameras(folder, arguments, sockets, stop, options.cameras))
        if navigation is not None:
            navigation.load()(options, cameras, folder, stop, console)
            return
        from autoexpose_daemon.demo.show import report, show  # noqa: PLC0415  takes half a second, as they do

        report(show(options, cameras, stop, console), console)


def _navigation() -> EntryPoint:
    """The demo of teach and repeat, a program that the daemon does not know."""
    for point in entry_points(group="autoexpose.demos", name="navigate"):
        return point
    raise ConfigurationError("--navigate needs autoexpose-lab: pip install autoexpose-lab, or in a checkout make setup")


def _keep_room() -> list[str]:
    """Options to cache the painted room between demos, if this user has a cache directory."""
    folder = cache_folder()
    return [] if folder is None else ["--keep-room", str(folder)]


def cache_folder() -> Path | None:
    """Where demos keep files for this user; None if there is no such place. It may not exist yet."""
    try:
        cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no home
        return None
    return cache / "autoexpose" if cache.is_absolute() else None
