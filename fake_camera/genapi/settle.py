"""What is not simulated but offered: brought to values that a client can read, and write back as they are."""

from __future__ import annotations

import contextlib
import math

from fake_camera.genapi.access import AccessModes
from fake_camera.genapi.description import NodeError
from fake_camera.genapi.dialect import NUMBERS
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.opener import Opener, Wished
from fake_camera.genapi.solve import assign, fill

_ROUNDS = 2
"""The limits of a feature may follow from one that comes later."""
_RANGE, _LARGE_RANGE = 1000, 1_000_000
"""Between the limits of numbers of which nothing is known; the second where units are large."""


def settle(opener: Opener) -> None:
    """Bring all features in the categories within their limits, and fill limits and divisors that are empty."""
    evaluator = opener.evaluator
    parts = [part for node in evaluator.nodes.values() for part in node.parts.get("pFeature", [])]
    names = dict.fromkeys((part.text or "").strip() for part in parts)
    modes = AccessModes(evaluator)
    offered = {name: modes.of(name) for name in names if evaluator.kind(name)}
    writable = [name for name, mode in offered.items() if mode == "RW"]
    for name in writable * _ROUNDS:
        if evaluator.kind(name) == "Enumeration":
            _choose(evaluator, name, modes)
        elif evaluator.kind(name) in NUMBERS and not _is_sound(opener, name):
            with contextlib.suppress(NodeError):
                assign(evaluator, name, opener.on_increment(name, evaluator.value(name)))
    for name in (node.name for feature in writable for node in reversed(evaluator.chain(feature))):
        if evaluator.kind(name) in NUMBERS and not _is_sound(opener, name):
            _fill(opener, name)
    for name in (name for name, mode in offered.items() if mode == "RO" and evaluator.kind(name) in NUMBERS):
        if not evaluator.has_value(name):
            fill(evaluator, (name,), 1)


def _choose(evaluator: Evaluator, name: str, modes: AccessModes) -> None:
    """Choose the first entry that there is, if the present one is not there."""
    with contextlib.suppress(NodeError):
        nodes = [node for node in evaluator.node(name).entries.values() if modes.of_entry(node) == "RO"]
        values = [node.integer("Value", 0) for node in nodes]
        if values and evaluator.value(name) not in values:
            assign(evaluator, name, values[0])


def _is_sound(opener: Opener, name: str) -> bool:
    """Whether a number is finite, within its limits and on its increment."""
    if not _is_within(opener, name):
        return False
    value, step = opener.evaluator.value(name), opener.evaluator.bound(name, "Inc")
    return step is None or (step > 0 and abs(opener.on_increment(name, value) - value) < step / 2)


def _is_within(opener: Opener, name: str) -> bool:
    """Whether a number is finite and within its limits."""
    with contextlib.suppress(NodeError):
        low, high = opener.evaluator.limits(name)
        return math.isfinite(value := opener.evaluator.value(name)) and low <= value <= high
    return False


def _fill(opener: Opener, name: str) -> None:
    """Set a number beyond the limits that it has to their middle; else fill limits and increment."""
    evaluator, low = opener.evaluator, 0.0
    with contextlib.suppress(NodeError):
        holder, _ = evaluator.bounded(name, 1.0)
        least, most = evaluator.limits(holder)
        low = max(least, 0.0)
        if least < most < math.inf and not _is_within(opener, name):
            assign(evaluator, holder, opener.on_increment(holder, (least + most) / 2))
            if _is_sound(opener, name):
                return
    for first, size in ((low, _RANGE), (low + 1, _RANGE), (low, _LARGE_RANGE)):  # 0 may be no value of its formula
        if opener.adjust(name, Wished(first, first + size, 1, first)):
            return
