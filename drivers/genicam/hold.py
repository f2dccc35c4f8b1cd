"""Having nodes hold values: each is written only where it holds another one, and refused by name where it cannot be.

What these functions raise beside `CameraLostError` and `CameraBusyError` is a `NodeError`: it stays.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from drivers.genicam.nodes import NodeMap
from drivers.setup import FeatureValue
from imaging.errors import NodeError

SWITCHED = {False: ("Off", "No", "False"), True: ("On", "Yes", "True")}
"""Entries of an enumeration that is a switch."""
_SELECTORS = ("GainSelector", "TriggerSelector", "LineSelector", "ChunkSelector")


def read_feature(nodes: NodeMap, name: str) -> FeatureValue:
    """The value of a feature, whatever its kind; NodeError if it cannot be read."""
    match nodes.kind(name):
        case "float":
            return nodes.read_float(name)
        case "integer":
            return nodes.read_integer(name)
        case "boolean":
            return nodes.read_boolean(name)
        case "enumeration" if entry := nodes.read_entry(name):
            return entry
        case "string":
            return nodes.read_string(name)
    raise NodeError(f"camera {nodes.serial}: {name} holds no value")


def write_feature(nodes: NodeMap, name: str, value: FeatureValue) -> None:
    """Write a value of the feature's kind."""
    match nodes.kind(name):
        case "float":
            nodes.write_float(name, float(value))
        case "integer":
            nodes.write_integer(name, int(value))
        case "boolean":
            nodes.write_boolean(name, bool(value))
        case "enumeration":
            nodes.write_entry(name, str(value))
        case "string":
            nodes.write_string(name, str(value))
        case "command":
            nodes.execute(name)


def hold(nodes: NodeMap, name: str, value: FeatureValue) -> None:
    """Have a feature hold a value of its kind."""
    present: FeatureValue | None = None
    with suppress(NodeError):  # it cannot be read, or holds no entry that the description has
        present = read_feature(nodes, name)
    if present == value:
        return
    if not nodes.writable(name):
        raise NodeError(
            f"camera {nodes.serial}: its {name} is {present} and cannot be {value}, as it is read-only or locked"
        )
    write_feature(nodes, name, value)


def switch(nodes: NodeMap, name: str, on: bool) -> None:
    """Have a switch on or off, whether it is an enumeration, a boolean or an integer."""
    match nodes.kind(name) if nodes.available(name) else None:
        case "boolean":
            hold(nodes, name, on)
        case "integer":
            hold(nodes, name, int(on))
        case "enumeration":
            entries = nodes.entries(name)
            entry = next((entry for entry in SWITCHED[on] if entry in entries), None)
            if entry is None:
                others = ", ".join(entries) or "nothing"
                raise NodeError(f"camera {nodes.serial}: its {name} has no {SWITCHED[on][0]}, only {others}")
            hold(nodes, name, entry)
        case _:
            raise NodeError(f"camera {nodes.serial}: it has no {name} that can be switched at present")


def unlock(nodes: NodeMap) -> None:
    """Undo the lock on all that decides how frames are sent, which a client that was killed leaves on."""
    if nodes.is_integer("TLParamsLocked"):
        with suppress(NodeError):
            hold(nodes, "TLParamsLocked", 0)


def offered(nodes: NodeMap, name: str) -> tuple[str, ...]:
    """The entries that an enumeration can be had at: of a read-only or locked one, that at which it stands."""
    entries = nodes.entries(name)
    if not entries or nodes.writable(name):
        return entries
    present = nodes.read_entry(name)
    return tuple(entry for entry in entries if entry == present)


def fixed_selectors(nodes: NodeMap) -> Iterator[str]:
    """What a read-only selector leaves out, in words."""
    for name in _SELECTORS:
        entries, had = nodes.entries(name), offered(nodes, name)
        others = [entry for entry in entries if entry not in had]
        if others:
            stays_at = ", ".join(had) or "no entry"
            yield f"its {name} is read-only and stays at {stays_at}: left alone are {', '.join(others)}"
