"""The interface to a camera's GenICam nodes, so that the driver's rules can be tested without a camera."""

from __future__ import annotations

from typing import Literal, Protocol

Kind = Literal["float", "integer", "boolean", "enumeration", "string", "command"]


class NodeMap(Protocol):
    """The nodes of one camera, by name.

    Every method that touches the camera raises `NodeError` when the camera or the node's bounds refuse for good,
    `CameraBusyError` when the camera refuses for the moment, and `CameraLostError` when it does not answer.
    """

    @property
    def serial(self) -> str:
        """Serial number of the camera, for messages."""

    def features(self) -> tuple[str, ...]:
        """All features, in the order of the camera's description; categories are not features."""

    def streamable(self) -> frozenset[str]:
        """The features that the description marks as worth storing; empty if it marks none."""

    def kind(self, name: str) -> Kind | None:
        """What kind of feature it is; None if the camera has none of that name, or it holds no value of these kinds."""

    def writable(self, name: str) -> bool:
        """Whether the feature is available, and neither read-only nor locked at present."""

    def selected(self, name: str) -> tuple[str, ...]:
        """The features whose values depend on this one; empty if it is not a selector."""

    def exists(self, name: str) -> bool:
        """Whether the camera has this feature, available or not."""

    def available(self, name: str) -> bool:
        """Whether the camera has this feature and currently offers it; a category is not a feature."""

    def is_float(self, name: str) -> bool:
        """Whether the feature holds a floating-point number."""

    def is_integer(self, name: str) -> bool:
        """Whether the feature holds an integer, not an enumeration or boolean."""

    def unit(self, name: str) -> str | None:
        """The unit that a number declares, None when it declares none."""

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries that an enumeration currently offers; empty if the camera has no such enumeration."""

    def float_bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value that the feature takes at present."""

    def float_increment(self, name: str) -> float:
        """The declared increment; 0.0 when any value is taken."""

    def integer_bounds(self, name: str) -> tuple[int, int]:
        """Least and greatest value that the feature takes at present."""

    def integer_increment(self, name: str) -> int:
        """The declared increment; 1 when none is declared."""

    def read_float(self, name: str) -> float:
        """Value of a floating-point feature."""

    def write_float(self, name: str, value: float) -> None:
        """Write a floating-point feature."""

    def read_integer(self, name: str) -> int:
        """Value of an integer feature."""

    def write_integer(self, name: str, value: int) -> None:
        """Write an integer feature."""

    def read_boolean(self, name: str) -> bool:
        """Value of a boolean feature."""

    def write_boolean(self, name: str, value: bool) -> None:
        """Write a boolean feature."""

    def read_entry(self, name: str) -> str:
        """The current entry of an enumeration; empty if it holds none that the description has."""

    def write_entry(self, name: str, entry: str) -> None:
        """Choose an entry of an enumeration."""

    def read_string(self, name: str) -> str:
        """Value of a text feature."""

    def write_string(self, name: str, value: str) -> None:
        """Write a text feature."""

    def execute(self, name: str) -> None:
        """Execute a command feature."""
