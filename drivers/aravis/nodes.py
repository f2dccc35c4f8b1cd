"""The nodes of an Aravis device, with its errors translated into ours."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from drivers.aravis.introspection import Aravis, GLib
from drivers.genicam.nodes import Kind
from imaging.errors import CameraBusyError, CameraError, CameraLostError, NodeError

T = TypeVar("T")
N = TypeVar("N", int, float)

_KINDS: tuple[tuple[Any, Kind], ...] = (
    (Aravis.GcEnumeration, "enumeration"),
    (Aravis.GcBoolean, "boolean"),
    (Aravis.GcCommand, "command"),
    (Aravis.GcFloat, "float"),
    (Aravis.GcString, "string"),
    (Aravis.GcInteger, "integer"),
)
"""Kinds by interface; enumerations and booleans are integers, too, so these come last."""
_SILENCE = (Aravis.DeviceError.TIMEOUT, Aravis.DeviceError.NOT_CONNECTED)
_LASTING = [
    getattr(Aravis.DeviceError, name)
    for name in (
        "WRONG_FEATURE", "FEATURE_NOT_FOUND", "INVALID_PARAMETER", "NO_STREAM_CHANNEL",
        "PROTOCOL_ERROR_NOT_IMPLEMENTED", "PROTOCOL_ERROR_INVALID_PARAMETER", "PROTOCOL_ERROR_INVALID_ADDRESS",
        "PROTOCOL_ERROR_WRITE_PROTECT", "PROTOCOL_ERROR_BAD_ALIGNMENT",
    )
    if hasattr(Aravis.DeviceError, name)  # 0.8.20 has one for all that a camera answers
]  # fmt: skip
"""What the device's own interface or the camera answers for ever; others, such as busy or access denied, pass."""


def _ordered(least: N, most: N) -> tuple[N, N]:
    """Bounds, which Aravis gives the wrong way round for a converter that decreases; 0 is one that it cannot find."""
    return (most, least) if least > most > 0 else (least, most)


def is_silence(error: GLib.Error) -> bool:
    """Whether Aravis reports that a request got no answer."""
    return any(error.matches(Aravis.device_error_quark(), code) for code in _SILENCE)


def _lasts(error: GLib.Error) -> bool:
    """Whether it follows from the description, or from an answer that does not change."""
    of_description: bool = error.domain == GLib.quark_to_string(Aravis.gc_error_quark())
    return of_description or any(error.matches(Aravis.device_error_quark(), code) for code in _LASTING)


class AravisNodes:
    """The node map of an Aravis device (see `drivers.genicam.nodes.NodeMap`), with its errors translated into ours."""

    def __init__(self, device: Any, serial: str) -> None:
        self._device = device
        self.serial = serial
        self.silent = threading.Event()
        """Set once a request got no answer: the camera is lost."""
        device.set_register_cache_policy(Aravis.RegisterCachePolicy.DISABLE)
        # Bounds are checked here: Aravis 0.8.26 errs where a converter decreases, or is a lookup table.
        device.set_range_check_policy(Aravis.RangeCheckPolicy.DISABLE)
        self._check_writes(True)

    @contextlib.contextmanager
    def unchecked(self) -> Iterator[None]:
        """Write without checking bounds and locks first, which costs a round trip each; for values that are read back.

        Only the camera itself can then refuse a value.
        """
        self._check_writes(False)
        try:
            yield
        finally:
            self._check_writes(True)

    def _check_writes(self, on: bool) -> None:
        """By default Aravis checks nothing: even a write to a read-only node passes silently."""
        self._checked = on
        if hasattr(Aravis, "AccessCheckPolicy"):  # not in 0.8.20, where only the camera refuses what is locked
            access = Aravis.AccessCheckPolicy
            self._device.set_access_check_policy(access.ENABLE if on else access.DISABLE)

    def release(self) -> None:
        """Drop the device, so that what still refers to these nodes (a traceback) does not keep it open."""
        self._device = None

    def call(self, action: str, function: Callable[..., T], *arguments: object) -> T:
        """Call into Aravis; `action` completes the sentence "camera S: could not ..."."""
        try:
            return function(*arguments)
        except GLib.Error as error:
            failure = self._translated(error, action)
        except OverflowError:  # of PyGObject
            failure = NodeError(f"camera {self.serial}: could not {action}: integers go from -2^63 to 2^63 - 1")
        del function  # it holds the device, and the traceback would hold it
        try:
            raise failure
        finally:
            del failure  # it would hold this frame, the frame it, and the garbage collector block on a dead camera

    def _translated(self, error: GLib.Error, action: str) -> CameraError:
        if is_silence(error):
            self.silent.set()
            return CameraLostError(f"camera {self.serial} does not answer: could not {action}")
        kind = NodeError if _lasts(error) else CameraBusyError
        return kind(f"camera {self.serial}: could not {action}: {error.message}")

    def features(self) -> tuple[str, ...]:
        """All features below the root category."""
        found: dict[str, None] = {}
        categories = ["Root"]
        for category in categories:
            listed = self._device.get_feature(category)
            for name in () if listed is None else listed.get_features():
                node = self._device.get_feature(name)
                if isinstance(node, Aravis.GcCategory) and name not in categories:
                    categories.append(name)
                elif isinstance(node, Aravis.GcFeatureNode):
                    found[name] = None
        return tuple(found)

    def streamable(self) -> frozenset[str]:
        """The features that the description marks as worth storing."""
        return frozenset(name for name in self.features() if self._is_streamable(name))

    def _is_streamable(self, name: str) -> bool:
        # Aravis 0.8.26 keeps the mark to itself, and gives the description as text without a terminator.
        part = self._device.get_feature(name).get_first_child()
        while part is not None:
            if part.get_node_name() == "Streamable":
                return bool(part.get_string() == "Yes")
            part = part.get_next_sibling()
        return False

    def kind(self, name: str) -> Kind | None:
        """What kind of feature it is."""
        node = self._device.get_feature(name)
        return next((kind for interface, kind in _KINDS if isinstance(node, interface)), None)

    def writable(self, name: str) -> bool:
        """Whether the feature is available, and neither read-only nor locked at present."""
        node = self._device.get_feature(name)
        if not self.available(name) or node.get_actual_access_mode() == Aravis.GcAccessMode.RO:
            return False
        return not self.call(f"ask whether {name} is locked", node.is_locked)

    def selected(self, name: str) -> tuple[str, ...]:
        """The features whose values depend on this one."""
        node = self._device.get_feature(name)
        if not isinstance(node, Aravis.GcSelector):
            return ()
        return tuple(feature.get_name() for feature in node.get_selected_features())

    def exists(self, name: str) -> bool:
        """Whether the camera's description has this feature."""
        return self._device.get_feature(name) is not None

    def available(self, name: str) -> bool:
        """Whether the camera has this feature and currently offers it."""
        node = self._device.get_feature(name)
        if node is None or isinstance(node, Aravis.GcCategory):
            return False
        return bool(self.call(f"look for {name}", self._device.is_feature_available, name))

    def is_float(self, name: str) -> bool:
        """Whether the feature is available and holds a floating-point number."""
        return isinstance(self._device.get_feature(name), Aravis.GcFloat) and self.available(name)

    def is_integer(self, name: str) -> bool:
        """Whether the feature is available and holds an integer, not an enumeration or boolean."""
        node = self._device.get_feature(name)
        if isinstance(node, Aravis.GcEnumeration | Aravis.GcBoolean | Aravis.GcFloat):
            return False
        return isinstance(node, Aravis.GcInteger) and self.available(name)

    def unit(self, name: str) -> str | None:
        """The unit that a number declares."""
        return self._device.get_feature(name).get_unit() or None

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries that an enumeration currently offers."""
        if not isinstance(self._device.get_feature(name), Aravis.GcEnumeration) or not self.available(name):
            return ()
        names = self._device.dup_available_enumeration_feature_values_as_strings
        return tuple(self.call(f"list the entries of {name}", names, name))

    def float_bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value."""
        bounds = self.call(f"read the bounds of {name}", self._device.get_float_feature_bounds, name)
        return _ordered(bounds.min, bounds.max)

    def float_increment(self, name: str) -> float:
        """The declared increment; without one Aravis gives an error, or the smallest positive float."""
        try:
            increment: float = self._device.get_float_feature_increment(name)
        except GLib.Error as error:
            if error.matches(Aravis.gc_error_quark(), Aravis.GcError.PROPERTY_NOT_DEFINED):
                return 0.0
            raise self._translated(error, f"read the increment of {name}") from None
        return increment if increment > 1e-9 else 0.0

    def integer_bounds(self, name: str) -> tuple[int, int]:
        """Least and greatest value."""
        bounds = self.call(f"read the bounds of {name}", self._device.get_integer_feature_bounds, name)
        return _ordered(bounds.min, bounds.max)

    def integer_increment(self, name: str) -> int:
        """The declared increment."""
        return int(self.call(f"read the increment of {name}", self._device.get_integer_feature_increment, name))

    def read_float(self, name: str) -> float:
        """Value of a floating-point feature."""
        return float(self.call(f"read {name}", self._device.get_float_feature_value, name))

    def write_float(self, name: str, value: float) -> None:
        """Write a floating-point feature."""
        if self._checked:
            self._check(name, value, self.float_bounds(name))
        self.call(f"set {name} to {value:g}", self._device.set_float_feature_value, name, value)

    def _check(self, name: str, value: float, bounds: tuple[float, float]) -> None:
        if value < bounds[0] or value > bounds[1]:
            raise NodeError(
                f"camera {self.serial}: could not set {name} to {value}: it takes {bounds[0]:.10g} to {bounds[1]:.10g}"
            )

    def read_integer(self, name: str) -> int:
        """Value of an integer feature."""
        return int(self.call(f"read {name}", self._device.get_integer_feature_value, name))

    def write_integer(self, name: str, value: int) -> None:
        """Write an integer feature."""
        if self._checked:
            self._check(name, value, self.integer_bounds(name))
        self.call(f"set {name} to {value}", self._device.set_integer_feature_value, name, value)

    def read_boolean(self, name: str) -> bool:
        """Value of a boolean feature."""
        return bool(self.call(f"read {name}", self._device.get_boolean_feature_value, name))

    def write_boolean(self, name: str, value: bool) -> None:
        """Write a boolean feature."""
        self.call(f"set {name} to {value}", self._device.set_boolean_feature_value, name, value)

    def read_entry(self, name: str) -> str:
        """The current entry of an enumeration."""
        return str(self.call(f"read {name}", self._device.get_string_feature_value, name) or "")

    def write_entry(self, name: str, entry: str) -> None:
        """Choose an entry of an enumeration."""
        self.call(f"set {name} to {entry}", self._device.set_string_feature_value, name, entry)

    def read_string(self, name: str) -> str:
        """Value of a text feature."""
        try:
            return str(self.call(f"read {name}", self._device.get_string_feature_value, name) or "")
        except UnicodeDecodeError:
            raise NodeError(f"camera {self.serial}: {name} is not UTF-8 text") from None

    def write_string(self, name: str, value: str) -> None:
        """Write a text feature."""
        self.call(f"set {name} to {value!r}", self._device.set_string_feature_value, name, value)

    def execute(self, name: str) -> None:
        """Execute a command feature."""
        self.call(f"execute {name}", self._device.execute_command, name)
