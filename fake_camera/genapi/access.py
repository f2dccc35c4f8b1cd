"""What a client may do with a node at present."""

from __future__ import annotations

from typing import Literal

from fake_camera.genapi.description import REGISTERS, Node, NodeError
from fake_camera.genapi.evaluator import Evaluator

AccessMode = Literal["NI", "NA", "WO", "RO", "RW"]
"""Not implemented, not available, write only, read only, both."""

_WITHOUT_REGISTER = {"SwissKnife": "RO", "IntSwissKnife": "RO", "Category": "RO", "EnumEntry": "RO"}
_CONDITIONS: dict[str, AccessMode | None] = {"pIsImplemented": "NI", "pIsAvailable": "NA", "pIsLocked": None}
"""What refers to a condition, and what a node is where it is false."""
_ABSENT: frozenset[AccessMode] = frozenset(("NI", "NA"))
_Letters = frozenset[str]


class AccessModes:
    """Access modes of the nodes of one camera, as they were when first asked for: make a new one after each write.

    A node is there only if all nodes are that it refers to: behind it, in its formulas, address, conditions and limits.
    """

    def __init__(self, evaluator: Evaluator) -> None:
        self._evaluator = evaluator
        self._found: dict[str, AccessMode] = {}

    def of(self, name: str) -> AccessMode:
        """The access mode of a node; raises NodeError when there is no such node."""
        if name not in self._found:
            self._found[name] = "RW"  # for those that refer to themselves in a circle
            self._found[name] = self._of(self._evaluator.node(name))
        return self._found[name]

    def of_entry(self, entry: Node) -> AccessMode:
        """The access mode of an entry of an enumeration."""
        return self._of(entry)

    def _of(self, node: Node) -> AccessMode:
        missing = self._missing(node)
        if missing:
            return "NI" if "NI" in missing else "NA"
        behind = self._evaluator.behind(node)
        if node.kind in REGISTERS:
            own = node.text("AccessMode", "RO")
        elif behind is not None:
            own = self.of(behind)
        else:
            own = _WITHOUT_REGISTER.get(node.kind, "RW")
        letters = _letters(own) & _letters(node.text("ImposedAccessMode", "RW"))
        if node.text("pIsLocked") and self._evaluator.value(node.text("pIsLocked")):
            letters -= {"W"}
        return _MODES[letters]

    def _missing(self, node: Node) -> set[AccessMode]:
        """Why a node is not there: the modes of what it lacks."""
        try:
            modes: set[AccessMode] = {self.of(other) for other in self._evaluator.referred(node)}
            for tag, mode in _CONDITIONS.items():
                condition = node.text(tag)
                if condition:
                    modes.add("NA" if self.of(condition) == "WO" else self.of(condition))
                if condition and mode is not None and not self._evaluator.value(condition):
                    modes.add(mode)
        except NodeError:
            modes = {"NA"}
        if node.kind in REGISTERS and not self._evaluator.is_served(node.text("pPort")):
            modes.add("NI")
        entries = {self._of(entry) for entry in node.entries.values()} if node.kind == "Enumeration" else set()
        if entries and entries <= _ABSENT:
            modes.add("NI" if entries == {"NI"} else "NA")
        return modes & _ABSENT


def _letters(mode: str) -> _Letters:
    return frozenset({"RO": "R", "WO": "W", "RW": "RW"}.get(mode, ""))


_MODES: dict[_Letters, AccessMode] = {
    frozenset("RW"): "RW", frozenset("R"): "RO", frozenset("W"): "WO", frozenset(): "NA",
}  # fmt: skip
