"""Aravis through GObject introspection, in the only file that imports `gi`, and the nodes of its devices."""

from __future__ import annotations

import contextlib
import ctypes
import threading
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import gi

from drivers.genicam.nodes import Kind
from drivers.setup import FeatureValue
from imaging.errors import AutoexposeError, CameraBusyError, CameraError, CameraLostError, NodeError

try:
    gi.require_version("Aravis", "0.8")
except ValueError:
    _others = ", ".join(gi.Repository.get_default().enumerate_versions("Aravis"))
    raise AutoexposeError(
        f"Aravis 0.8 is not installed{f', only {_others}' if _others else ''}: apt install gir1.2-aravis-0.8"
    ) from None
from gi.repository import Aravis, GLib

for _name in dir(Aravis):  # PyGObject makes a class when it is first named, and other threads see it half made
    getattr(Aravis, _name)

__all__ = ["Aravis", "AravisNodes", "GLib", "is_silence"]

T = TypeVar("T")

_KINDS: tuple[tuple[Any, Kind], ...] = (
    (Aravis.GcEnumeration, "enumeration"),
    (Aravis.GcBoolean, "boolean"),
    (Aravis.GcCommand, "command"),
    (Aravis.GcFloat, "float"),
    (Aravis.GcString, "string"),
    (Aravis.GcInteger, "integer"),
)
"""Kinds by interface; enumerations and booleans are integers, too, so these come last."""
_VALUES: dict[Kind, tuple[type[bool | int | float | str], str]] = {
    "enumeration": (str, "string"),
    "boolean": (bool, "boolean"),
    "float": (float, "float"),
    "string": (str, "string"),
    "integer": (int, "integer"),
}
"""The type of a kind's values, and what Aravis' functions for them are called by."""
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


def is_silence(error: GLib.Error) -> bool:
    """Whether Aravis reports that a request got no answer."""
    return any(error.matches(Aravis.device_error_quark(), code) for code in _SILENCE)


def _lasts(error: GLib.Error) -> bool:
    """Whether it follows from the description, or from an answer that does not change."""
    of_description: bool = error.domain == GLib.quark_to_string(Aravis.gc_error_quark())
    return of_description or any(error.matches(Aravis.device_error_quark(), code) for code in _LASTING)


class AravisNodes:
    """The node map of an Aravis camera (see `drivers.genicam.nodes.NodeMap`), with its errors translated into ours.

    Whatever else needs the camera or its device asks for them here, and keeps neither: after `release` they are gone,
    whichever tracebacks are kept. A camera that is still referred to stays open, and controlled.
    """

    def __init__(self, camera: Any, serial: str) -> None:
        self.camera = camera
        self.device = camera.get_device()
        self.serial = serial
        self.silent = threading.Event()
        """Set once a request got no answer, or control is lost: the camera is lost."""
        self.device.set_register_cache_policy(Aravis.RegisterCachePolicy.DISABLE)
        # Bounds are checked here: Aravis 0.8.26 errs where a converter decreases, or is a lookup table.
        self.device.set_range_check_policy(Aravis.RangeCheckPolicy.DISABLE)
        self._check_writes(True)
        # The handler runs on a thread of Aravis, which would end the process by dropping the last reference to the
        # camera. So the handler holds only the event, and `release` disconnects it before it gives up control.
        lost = self.silent
        self._control_lost = self.device.connect("control-lost", lambda _device: lost.set())

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
            self.device.set_access_check_policy(access.ENABLE if on else access.DISABLE)

    def stop_acquisition(self) -> None:
        """Have the camera expose no more, if it can be told to; raises as `call` does."""
        if self.exists("AcquisitionStop"):
            self.call("stop acquisition", self.camera.stop_acquisition)

    def release(self) -> None:
        """Drop the camera, which closes it, and gives up control."""
        self.device.disconnect(self._control_lost)
        self.camera = self.device = None

    def call(self, action: str, function: Callable[..., T], *arguments: object) -> T:
        """Call into Aravis; `action` completes the sentence "camera S: could not ...".

        Raises NodeError, or CameraLostError when the camera does not answer.
        """
        try:
            return function(*arguments)
        except GLib.Error as error:
            del function  # a traceback would keep it, and with it the camera
            raise self._translated(error, action) from None
        except OverflowError:  # of PyGObject
            del function
            words = f"camera {self.serial}: could not {action}: integers go from -2^63 to 2^63 - 1"
            raise NodeError(words) from None

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
            listed = self.device.get_feature(category)
            for name in () if listed is None else listed.get_features():
                node = self.device.get_feature(name)
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
        part = self.device.get_feature(name).get_first_child()
        while part is not None:
            if part.get_node_name() == "Streamable":
                return bool(part.get_string() == "Yes")
            part = part.get_next_sibling()
        return False

    def kind(self, name: str) -> Kind | None:
        """What kind of feature it is."""
        node = self.device.get_feature(name)
        return next((kind for interface, kind in _KINDS if isinstance(node, interface)), None)

    def writable(self, name: str) -> bool:
        """Whether the feature is available, and neither read-only nor locked at present."""
        node = self.device.get_feature(name)
        if not self.available(name) or node.get_actual_access_mode() == Aravis.GcAccessMode.RO:
            return False
        return not self.call(f"ask whether {name} is locked", node.is_locked)

    def selected(self, name: str) -> tuple[str, ...]:
        """The features whose values depend on this one."""
        node = self.device.get_feature(name)
        if not isinstance(node, Aravis.GcSelector):
            return ()
        return tuple(feature.get_name() for feature in node.get_selected_features())

    def exists(self, name: str) -> bool:
        """Whether the camera's description has this feature."""
        return self.device.get_feature(name) is not None

    def available(self, name: str) -> bool:
        """Whether the camera has this feature and currently offers it."""
        node = self.device.get_feature(name)
        if node is None or isinstance(node, Aravis.GcCategory):
            return False
        return bool(self.call(f"look for {name}", self.device.is_feature_available, name))

    def unit(self, name: str) -> str | None:
        """The unit that a number declares."""
        return self.device.get_feature(name).get_unit() or None

    def entries(self, name: str) -> tuple[str, ...]:
        """The entries that an enumeration currently offers."""
        if not isinstance(self.device.get_feature(name), Aravis.GcEnumeration) or not self.available(name):
            return ()
        names = self.device.dup_available_enumeration_feature_values_as_strings
        return tuple(self.call(f"list the entries of {name}", names, name))

    def bounds(self, name: str) -> tuple[float, float]:
        """Least and greatest value; Aravis turns them round for a converter that decreases; 0 is one it cannot find."""
        called = "integer" if self.kind(name) == "integer" else "float"
        read = f"get_{called}_feature_bounds"
        bounds = self.call(f"read the bounds of {name}", getattr(self.device, read), name)
        return (bounds.max, bounds.min) if bounds.min > bounds.max > 0 else (bounds.min, bounds.max)

    def increment(self, name: str) -> float:
        """The declared increment; without one Aravis gives an error, or the smallest positive float.

        Raises NodeError when it cannot be read.
        """
        try:
            if self.kind(name) == "integer":
                return int(self.device.get_integer_feature_increment(name))
            increment = float(self.device.get_float_feature_increment(name))
        except GLib.Error as error:
            if error.matches(Aravis.gc_error_quark(), Aravis.GcError.PROPERTY_NOT_DEFINED):
                return 0.0
            raise self._translated(error, f"read the increment of {name}") from None
        return increment if increment > 1e-9 else 0.0

    def _value(self, name: str) -> tuple[Kind, type[bool | int | float | str], str]:
        """Kind and type of a feature's values, and what Aravis calls them; NodeError if it holds none."""
        kind = self.kind(name)
        if kind is None or kind not in _VALUES:
            raise NodeError(f"camera {self.serial}: {name} holds no value")
        return kind, *_VALUES[kind]

    def read(self, name: str) -> FeatureValue:
        """Value of a feature, of its kind. Raises NodeError when it cannot be read."""
        _, type_, called = self._value(name)
        try:
            value = self.call(f"read {name}", getattr(self.device, f"get_{called}_feature_value"), name)
        except UnicodeDecodeError:
            raise NodeError(f"camera {self.serial}: {name} is not UTF-8 text") from None
        return str(value or "") if type_ is str else type_(value)

    def write(self, name: str, value: FeatureValue) -> None:
        """Write a value of the feature's kind. Raises NodeError when the camera refuses it."""
        kind, type_, called = self._value(name)
        value = type_(value)
        if self._checked and kind in ("float", "integer"):
            low, high = self.bounds(name)
            if float(value) < low or float(value) > high:
                takes = f"it takes {low:.10g} to {high:.10g}"
                raise NodeError(f"camera {self.serial}: could not set {name} to {value}: {takes}")
        shown = f"{value:g}" if isinstance(value, float) else repr(value) if kind == "string" else value
        self.call(f"set {name} to {shown}", getattr(self.device, f"set_{called}_feature_value"), name, value)

    def execute(self, name: str) -> None:
        """Execute a command feature."""
        self.call(f"execute {name}", self.device.execute_command, name)

    def description_xml(self) -> str:
        """The camera's GenICam description.

        Aravis 0.8.26 gives it with its length and no terminator, but PyGObject takes it for terminated text, and reads
        whatever memory follows, so it is read without PyGObject.
        """
        function = ctypes.CDLL("libaravis-0.8.so.0").arv_device_get_genicam_xml
        function.restype, function.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)]
        size = ctypes.c_size_t()
        text = function(hash(self.device), ctypes.byref(size))  # PyGObject's hash is the address
        return ctypes.string_at(text, size.value).decode("utf-8", "replace") if text else ""
