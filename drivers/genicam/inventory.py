"""What a camera is set to: all features that can be set, read back."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from drivers.genicam.features import same, selecting, set_features
from drivers.genicam.hold import offered, read_feature
from drivers.genicam.nodes import NodeMap
from drivers.setup import FeatureSetting, FeatureValue, misfit
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError

USER_SET, LOAD, DEFAULT = "UserSetSelector", "UserSetLoad", "Default"
PACKET_DELAY = "GevSCPD"
_ATTEMPTS = 4
"""Attempts at putting back features that depend on each other, such as binning, sizes and offsets."""


@dataclass(frozen=True, slots=True)
class Inventory:
    """Settings in the order of the description, and the features that were left out.

    `unread` could not be read, or not be written in a list. `tables` have several selectors, or one that counts, as
    look-up tables have.
    """

    settings: tuple[FeatureSetting, ...]
    unread: tuple[str, ...]
    tables: tuple[str, ...]


def read_inventory(nodes: NodeMap) -> Inventory:
    """Read every feature that can be set at present and is worth storing, for each entry of its selector."""
    names = [name for name in nodes.features() if nodes.kind(name) not in (None, "command")]
    stored = _stored(nodes, names)
    selectors = [name for name in names if name.endswith(("Selector", "Index")) and nodes.selected(name)]
    above = {name: [each for each in selectors if name in nodes.selected(each)] for name in names}
    values: dict[str, list[FeatureSetting]] = {name: [] for name in stored if name not in selectors}
    unread: dict[str, None] = {}

    def note(selectors: tuple[tuple[str, str], ...], names: Iterable[str]) -> None:
        for name in names:
            try:
                if not nodes.writable(name):
                    continue
                value = read_feature(nodes, name)
                if misfit(value) is not None:
                    unread[name] = None
                elif nodes.kind(name) != "enumeration" or value in nodes.entries(name):
                    values[name].append(FeatureSetting(name, value, selectors))
            except NodeError:
                unread[name] = None

    note((), [name for name in values if not above[name]])
    for selector in selectors:
        selected = [name for name in values if above[name] == [selector]]
        try:
            for entry in offered(nodes, selector) if selected else ():
                with selecting(nodes, ((selector, entry),)):
                    note(((selector, entry),), selected)
        except (ConfigurationError, NodeError):
            unread[selector] = None
    tables = [name for name in values if len(above[name]) > 1 or "integer" in map(nodes.kind, above[name])]
    settings = tuple(setting for found in values.values() for setting in found)
    return Inventory(settings, tuple(unread), tuple(tables))


def _stored(nodes: NodeMap, names: Sequence[str]) -> list[str]:
    """Those of the features that belong to what a camera is set to, rather than to its network.

    Many descriptions mark them as streamable, Width for one. If not even Width is, all are taken except those of GigE
    Vision's own registers, such as the camera's address; the packet delay belongs to both.
    """
    streamable = nodes.streamable()
    if "Width" in streamable:
        return [name for name in names if name in streamable]
    return [name for name in names if not name.startswith("Gev") or name == PACKET_DELAY]


def differing(nodes: NodeMap, settings: Iterable[FeatureSetting]) -> list[tuple[FeatureSetting, FeatureValue | None]]:
    """The settings that the camera does not have at present, and what it has instead; None: it cannot be read."""
    found: list[tuple[FeatureSetting, FeatureValue | None]] = []
    for setting in settings:
        present: FeatureValue | None = None
        try:
            with selecting(nodes, setting.selectors):
                present = read_feature(nodes, setting.name)
        except (ConfigurationError, NodeError):
            pass
        if present is None or not same(setting.value, present):
            found.append((setting, present))
    return found


def changed_from_default(
    nodes: NodeMap, settings: Sequence[FeatureSetting]
) -> tuple[list[FeatureSetting], list[FeatureSetting]]:
    """Those present settings that differ from the camera's default user set, and those that were not put back.

    Loads that user set, compares, and sets what differs again.

    Raises
    ------
    UnsupportedCameraError
        When the camera has no default user set.
    """
    if DEFAULT not in nodes.entries(USER_SET) or nodes.kind(LOAD) != "command":
        raise UnsupportedCameraError(
            f"camera {nodes.serial}: it has no {USER_SET} {DEFAULT} to compare with: switch it off and on, "
            "save its settings with --save FILE, and compare later ones with --diff FILE"
        )
    with selecting(nodes, ((USER_SET, DEFAULT),)):
        nodes.execute(LOAD)
    changed = [setting for setting, _ in differing(nodes, settings)]
    lost = changed
    for _ in range(_ATTEMPTS):
        set_features(nodes, lost)
        lost = [setting for setting, _ in differing(nodes, settings)]
        if not lost:
            break
    return changed, lost
