"""The values of a camera's features, with the limits, increments and locks that it enforces."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from fake_camera.device.feature_table import (
    CHUNK_BYTES,
    CHUNK_TRAILER_BYTES,
    ENUM_ENTRIES,
    Spec,
    Value,
    ptp_specs,
    specs,
)
from fake_camera.imaging import PIXEL_FORMATS, ImageSettings


@dataclass(frozen=True, slots=True)
class Limits:
    """The present bounds of a number; an increment of 0 means any value."""

    minimum: float
    maximum: float
    increment: float


class FeatureError(Exception):
    """The camera refuses an access; the protocol answers with the status code for `kind`."""

    def __init__(self, kind: Literal["out_of_range", "read_only", "locked"], message: str) -> None:
        super().__init__(message)
        self.kind = kind


FULL_READOUT_NS = 3_000_000
"""Readout of the sensor's full height; a lower region takes proportionally less."""

_REGION = {"Width": "OffsetX", "OffsetX": "Width", "Height": "OffsetY", "OffsetY": "Height"}  # share an axis
_LASTING = ("DeviceUserID",)  # cameras keep the user-defined name in non-volatile memory
NOT_IN_USER_SETS = ("DeviceUserID", "TLParamsLocked", "UserSetSelector")
"""Writable features that are no settings."""
_HISTORY = 64  # writes that may come between a pulse and the moment when its thread runs


def readout_ns(settings: ImageSettings, sensor_height: int) -> int:
    """How long the rows of an image take to be read."""
    return round(FULL_READOUT_NS * settings.height * settings.binning_vertical / sensor_height)


class Features:
    """The values of one camera's features; safe to use from any thread.

    Commands (AcquisitionStart, AcquisitionStop, TriggerSoftware, TimestampLatch, DeviceReset, UserSetLoad,
    UserSetSave) are not features: see ``Device.execute``. LineInverter is kept for each line, and has no effect.
    `device_clock_ns` gives Timestamp; `host_clock_ns` dates the writes; `pixel_format` is the PixelFormat at power-on;
    `ptp_clock` is the identity of the PTP clock, if there is one.

    Attributes
    ----------
    has_ptp
        Whether the features of PTP and action commands are among them.
    """

    def __init__(
        self,
        serial: str,
        sensor_width: int,
        sensor_height: int,
        device_clock_ns: Callable[[], int],
        host_clock_ns: Callable[[], int] = time.monotonic_ns,
        *,
        model: str = "FakeGV287M",
        pixel_format: str = "Mono8",
        ptp_clock: int | None = None,
    ) -> None:
        table = specs(model, serial, sensor_width, sensor_height, pixel_format)
        if ptp_clock is not None:
            table += ptp_specs(ptp_clock)
        self.has_ptp = ptp_clock is not None
        self._specs = {spec.name: spec for spec in table}
        self._derived: dict[str, Callable[[], Value]] = {
            "Timestamp": device_clock_ns,
            "WidthMax": lambda: self._region_max("Width"),
            "HeightMax": lambda: self._region_max("Height"),
            "PayloadSize": self._payload_bytes,
            "SensorReadoutTime": lambda: readout_ns(self._snapshot(), sensor_height) * 1e-3,
            "ChunkEnable": lambda: self._chunks[str(self._values["ChunkSelector"])],
            "LineInverter": lambda: self._inverted[str(self._values["LineSelector"])],
            "BalanceRatio": lambda: self._ratios[str(self._values["BalanceRatioSelector"])],
            "LineMode": lambda: "Output" if self._values["LineSelector"] == "Line1" else "Input",
            "LineSource": lambda: self._values["LineSource"] if self._values["LineSelector"] == "Line1" else "Off",
        }
        self._host_clock_ns = host_clock_ns
        self._lock = threading.RLock()
        self._values: dict[str, Value] = {}
        self.reset()
        self._user_sets = dict.fromkeys(ENUM_ENTRIES["UserSetSelector"], self._user_set())

    def reset(self) -> None:
        """Back to the power-on state; the name that the user gave the camera stays."""
        with self._lock:
            lasting = {name: value for name, value in self._values.items() if name in _LASTING}
            self._values = {spec.name: spec.initial for spec in self._specs.values()} | lasting
            self._chunks = dict.fromkeys(CHUNK_BYTES, False)
            self._inverted = dict.fromkeys(ENUM_ENTRIES["LineSelector"], False)
            self._ratios = dict.fromkeys(ENUM_ENTRIES["BalanceRatioSelector"], 1.0)
            self._history = deque([(self._host_clock_ns(), self._snapshot())], maxlen=_HISTORY)

    @property
    def names(self) -> tuple[str, ...]:
        """All features."""
        return tuple(self._specs)

    def spec(self, name: str) -> Spec:
        """The declaration of a feature; KeyError when there is none of that name."""
        return self._specs[name]

    def entries(self, name: str) -> dict[str, int]:
        """The entries of an enumeration with the integers that its register holds; none if it is something else."""
        entries = ENUM_ENTRIES.get(name, {})
        if self.has_ptp:
            return entries
        return {entry: value for entry, value in entries.items() if entry != "Action1"}

    def get(self, name: str) -> Value:
        """The value now; an enumeration as the name of its entry."""
        with self._lock:
            derived = self._derived.get(name)
            return self._values[name] if derived is None else derived()

    def set(self, name: str, value: Value) -> None:
        """Write a feature: a number between increments is rounded to the nearest, one out of range is refused.

        Raises FeatureError: "out_of_range" (also: no such enumeration entry), "read_only", or "locked" (by the
        acquisition or by an auto function).
        """
        spec = self._specs[name]
        with self._lock:
            if not spec.writable:
                raise FeatureError("read_only", f"{name} can only be read")
            if spec.locked_while is not None and self.locked(name):
                raise FeatureError("locked", "{} cannot be written while {} is {}".format(name, *spec.locked_while))
            self.update(name, self._checked(spec, value))

    def update(self, name: str, value: Value) -> None:
        """Set a feature as the camera itself does: no access check."""
        with self._lock:
            if name == "ChunkEnable":
                self._chunks[str(self._values["ChunkSelector"])] = bool(value)
            elif name == "LineInverter":
                self._inverted[str(self._values["LineSelector"])] = bool(value)
            elif name == "BalanceRatio":
                self._ratios[str(self._values["BalanceRatioSelector"])] = float(value)
            elif name in ("ExposureAuto", "GainAuto") and value == "Once":
                self._values[name] = "Off"  # auto functions keep the present value: finished at once
            else:
                self._values[name] = value
            if name in ("BinningHorizontal", "BinningVertical"):
                self._open_region()
            self._history.append((self._host_clock_ns(), self._snapshot()))

    def load_user_set(self) -> None:
        """Take the values of the selected user set; they outlast power-off. FeatureError while acquiring."""
        with self._lock:
            if self._values["TLParamsLocked"]:
                raise FeatureError("locked", "no user set can be loaded while acquiring")
            values, chunks, inverted, ratios = self._user_sets[str(self._values["UserSetSelector"])]
            self._values |= values
            self._chunks, self._inverted, self._ratios = dict(chunks), dict(inverted), dict(ratios)
            self._history.append((self._host_clock_ns(), self._snapshot()))

    def save_user_set(self) -> None:
        """Keep the present values in the selected user set; FeatureError for the default one."""
        with self._lock:
            selected = str(self._values["UserSetSelector"])
            if selected == "Default":
                raise FeatureError("read_only", "the default user set cannot be changed")
            self._user_sets[selected] = self._user_set()

    def _user_set(self) -> tuple[dict[str, Value], dict[str, bool], dict[str, bool], dict[str, float]]:
        values = {
            name: value
            for name, value in self._values.items()
            if self._specs[name].writable and name not in NOT_IN_USER_SETS
        }
        return values, dict(self._chunks), dict(self._inverted), dict(self._ratios)

    @property
    def shows_exposure(self) -> bool:
        """Whether Line1 is active while the camera exposes."""
        with self._lock:
            return self._values["LineSource"] == "ExposureActive"

    def locked(self, name: str) -> bool:
        """Whether a writable feature refuses writes at present."""
        condition = self._specs[name].locked_while
        return condition is not None and self.get(condition[0]) == condition[1]

    def limits(self, name: str) -> Limits:
        """Present bounds and increment of a number (the region shrinks with offset and binning)."""
        spec = self._specs[name]
        with self._lock:
            maximum = spec.maximum
            if name in _REGION:
                maximum = self._region_max(name) - float(self._values[_REGION[name]])
            return Limits(spec.minimum, maximum, spec.increment)

    def enabled_chunks(self) -> tuple[str, ...]:
        """Chunks that follow the image, in the order of `CHUNK_BYTES`; none unless ChunkModeActive."""
        with self._lock:
            return tuple(name for name, on in self._chunks.items() if on and self._values["ChunkModeActive"])

    def image_settings(self, at_ns: int) -> ImageSettings:
        """The settings that were in force at host time `at_ns` (CLOCK_MONOTONIC): later writes do not count."""
        with self._lock:
            for written_ns, settings in reversed(self._history):
                if written_ns <= at_ns:
                    return settings
            return self._history[0][1]

    def _checked(self, spec: Spec, value: Value) -> Value:
        """The value that the camera takes: of the right type, within the limits, a multiple of the increment."""
        if spec.type == "enumeration":
            if value not in self.entries(spec.name):
                raise FeatureError("out_of_range", f"{spec.name} has no entry {value!r}")
            return value
        if spec.type == "string":
            if len(str(value).encode()) > spec.maximum:
                raise FeatureError("out_of_range", f"{spec.name} holds at most {spec.maximum:g} bytes")
            return str(value)
        if spec.type == "boolean":
            return bool(value)
        return self._checked_number(spec, float(value))

    def _checked_number(self, spec: Spec, value: float) -> int | float:
        limits = self.limits(spec.name)
        if not limits.minimum <= value <= limits.maximum:
            raise FeatureError(
                "out_of_range",
                f"{spec.name} {value:g} {spec.unit} is not within {limits.minimum:g} to {limits.maximum:g}",
            )
        if limits.increment:
            steps = math.floor((value - limits.minimum) / limits.increment + 0.5)
            value = limits.minimum + steps * limits.increment
            if value > limits.maximum:
                value -= limits.increment
        return int(value) if spec.type == "integer" else value

    def _region_max(self, name: str) -> int:
        """Largest width (`name` Width or OffsetX) or height of a binned image, a multiple of the increment."""
        axis, sensor, binning = (
            ("Width", "SensorWidth", "BinningHorizontal")
            if name in ("Width", "OffsetX")
            else ("Height", "SensorHeight", "BinningVertical")
        )
        increment = int(self._specs[axis].increment)
        return int(self._values[sensor]) // int(self._values[binning]) // increment * increment

    def _open_region(self) -> None:
        """A new binning opens the region to all of the image."""
        self._values |= {
            "OffsetX": 0,
            "OffsetY": 0,
            "Width": self._region_max("Width"),
            "Height": self._region_max("Height"),
        }

    def _payload_bytes(self) -> int:
        pixel_format = PIXEL_FORMATS[str(self._values["PixelFormat"])]
        image = pixel_format.image_bytes(int(self._values["Width"]), int(self._values["Height"]))
        if not self._values["ChunkModeActive"]:
            return image
        chunks = sum(CHUNK_BYTES[name] + CHUNK_TRAILER_BYTES for name in self.enabled_chunks())
        return image + CHUNK_TRAILER_BYTES + chunks

    def _snapshot(self) -> ImageSettings:
        values = self._values
        return ImageSettings(
            exposure_time_us=float(values["ExposureTime"]),
            gain_db=float(values["Gain"]),
            black_level_percent=float(values["BlackLevel"]),
            gamma=float(values["Gamma"]) if values["GammaEnable"] else 1.0,
            pixel_format=str(values["PixelFormat"]),
            offset_x=int(values["OffsetX"]),
            offset_y=int(values["OffsetY"]),
            width=int(values["Width"]),
            height=int(values["Height"]),
            binning_horizontal=int(values["BinningHorizontal"]),
            binning_vertical=int(values["BinningVertical"]),
            reverse_x=bool(values["ReverseX"]),
            reverse_y=bool(values["ReverseY"]),
            balances_white=values["BalanceWhiteAuto"] != "Off",
            balance_ratios=(self._ratios["Red"], self._ratios["Green"], self._ratios["Blue"]),
        )
