"""What a client may do with a node at present."""

from __future__ import annotations

from typing import Literal

from fake_camera.genapi.description import REGISTERS, Node, NodeError
from fake_camera.genapi.evaluator import Evaluator

AccessMode = Literal["NI", "NA", "WO", "RO", "RW"]
"""Not implemented, not available, write only, read only, both."""

_WITHOUT_REGISTER = {"SwissKnife": "RO", "IntSwissKnife": "RO", "Category": "RO", "EnumEntry": "RO"}
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
            modes = {self.of(other) for other in self._evaluator.referred(node)}
            conditions = [node.text(tag) for tag in ("pIsImplemented", "pIsAvailable", "pIsLocked") if node.text(tag)]
            modes |= {"NA" if self.of(condition) == "WO" else self.of(condition) for condition in conditions}
            missing: set[AccessMode] = {mode for mode in modes if mode in ("NI", "NA")}
            if missing:
                return missing
            if node.text("pIsImplemented") and not self._evaluator.value(node.text("pIsImplemented")):
                return {"NI"}
            if node.text("pIsAvailable") and not self._evaluator.value(node.text("pIsAvailable")):
                return {"NA"}
            if node.kind in REGISTERS and not self._evaluator.is_served(node.text("pPort")):
                return {"NI"}
        except NodeError:
            return {"NA"}
        entries = {self._of(entry) for entry in node.entries.values()} if node.kind == "Enumeration" else set()
        return {"NI" if entries == {"NI"} else "NA"} if entries and entries <= {"NI", "NA"} else set()


def _letters(mode: str) -> _Letters:
    return frozenset({"RO": "R", "WO": "W", "RW": "RW"}.get(mode, ""))


_MODES: dict[_Letters, AccessMode] = {
    frozenset("RW"): "RW", frozenset("R"): "RO", frozenset("W"): "WO", frozenset(): "NA",
}  # fmt: skip
