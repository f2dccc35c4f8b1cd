"""What a camera's features are set to: as a configuration, and compared with one."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import typer
import yaml

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import load_config
from documents.text import readable
from drivers.aravis import open_nodes
from drivers.genicam.dialect import gain_driven
from drivers.genicam.features import advice, changed_from_default, differing, read_inventory
from drivers.genicam.nodes import NodeMap
from drivers.setup import CameraSetup, FeatureSetting, TriggerSetup, as_list
from imaging.errors import AutoexposeError, CameraLostError, ConfigurationError
from imaging.frames import Side

_STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NO_CONFIGURATION = CameraSetup(TriggerSetup("external"))


def show_features(serial: str, changed: bool, save: Path | None) -> None:
    """Print what can be set on a camera, or what differs from its default user set, as a configuration; or save it.

    Features that the daemon drives itself are left out.
    """
    with open_nodes(serial) as nodes:
        inventory = read_inventory(nodes)
        settings, lost = list(inventory.settings), list[FeatureSetting]()
        if changed:
            try:
                with _undisturbed():
                    settings, lost = changed_from_default(nodes, settings)
            except CameraLostError as error:
                raise CameraLostError(f"{error}; it may be left with its default user set") from error
        free = _free(nodes, settings)
    text = _configuration(serial, free)
    if save is None:
        typer.echo(text, nl=False)
    else:
        _write(save, text)
        typer.echo(f"{save}: {len(free)} features of camera {serial}")
    _tell("driven by the daemon, so left out", [setting.name for setting in settings if setting not in free])
    _tell("cannot be read, so left out", inventory.unread)
    _tell("tables, so left out", inventory.tables)
    if changed:
        _tell("the default user set was loaded for a moment, which may have reset these tables", inventory.tables)
    if lost:
        raise AutoexposeError(
            f"camera {serial}: these could not be put back after its default user set was loaded: "
            f"{', '.join(f'{setting.key}: {setting.value}' for setting in lost)}; switch it off and on"
        )


def show_difference(serial: str, file: Path) -> bool:
    """Print where a camera differs from the features of a configuration file; True if there is no difference."""
    config = load_config(file)
    side = _side_of(serial, config, file)
    last = {feature.key: feature for feature in config.sides[side].features}  # of equal keys the last counts
    with open_nodes(serial) as nodes:
        settings = [feature for feature in last.values() if nodes.kind(feature.name) != "command"]
        found = differing(nodes, settings)
    for setting, present in found:
        has = "cannot be read" if present is None else f"is {_value(present)}"
        typer.echo(readable(f"{setting.key} {has}, in {file} {_value(setting.value)}"))
    if not found:
        typer.echo(f"camera {serial} has all {len(settings)} features of cameras.{side} in {file}")
    return not found


def _side_of(serial: str, config: Config, file: Path) -> Side:
    for side, camera in config.sides.items():
        if camera.serial == serial:
            return side
    if len(config.sides) == 1:  # the features of another camera, such as its twin
        return "left"
    raise ConfigurationError(f"{file}: neither camera is {serial}: name a file with that camera, or with a single one")


def _free(nodes: NodeMap, settings: Sequence[FeatureSetting]) -> list[FeatureSetting]:
    """The features that the daemon does not drive."""
    driven = gain_driven(nodes)
    return [setting for setting in settings if advice(setting, _NO_CONFIGURATION, driven) is None]


def _configuration(serial: str, features: Sequence[FeatureSetting]) -> str:
    camera = {"serial": serial, "features": as_list(features)}
    return yaml.safe_dump({"cameras": {"left": camera}}, sort_keys=False, allow_unicode=True, width=1000)


def _write(file: Path, text: str) -> None:
    try:
        with file.open("x") as new:
            new.write(text)
    except OSError as error:
        raise AutoexposeError(f"{file}: cannot be written ({error.strerror}): name a new file") from error


def _value(value: object) -> str:
    return yaml.safe_dump(value).removesuffix("...\n").strip()


def _tell(what: str, names: Sequence[str]) -> None:
    if names:
        typer.echo(readable(f"{what}: {', '.join(dict.fromkeys(names))}"), err=True)


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Ctrl-C, SIGTERM and a closed terminal wait: the camera must not be left with its default user set."""
    came: list[int] = []
    former = {one: signal.signal(one, lambda number, _: came.append(number)) for one in _STOPPING}
    try:
        yield
    finally:
        for one, handler in former.items():
            signal.signal(one, handler)
        if came:
            signal.raise_signal(came[0])
