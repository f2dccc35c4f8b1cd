"""The features of a described camera that have an effect: decoded from its registers into those of the device."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from fake_camera.device.features import FeatureError, Features
from fake_camera.genapi.description import NodeError
from fake_camera.genapi.dialect import (
    CHUNK_CONTENTS,
    EXPOSURE_TIMES,
    FRAME_RATE_SWITCHES,
    FRAME_RATES,
    GAINS,
    GAMMA_SWITCHES,
    TIME_BASE,
    action_signals,
    frame_trigger,
    in_db,
    spoken,
    time_unit_us,
    trigger_lines,
)
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.raw_gain import RawGain, RawGainLaw
from fake_camera.genapi.solve import assign
from fake_camera.imaging import PIXEL_FORMATS, ExposedFrame

EXPOSURE_RANGE_US = (1.0, 1e7)
"""What the sensor can do, even if a description's limits allow more."""
GAIN_RANGE_DB = (-100.0, 100.0)
"""Likewise; a description may have no limits at all, and 1e30 dB is no factor."""
FRAME_RATE_RANGE_HZ = (0.01, 1000.0)
"""Likewise; 0 is no rate, though some descriptions allow it."""
_TOLERANCE = 1e-6  # for limits that went through formulas


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """One feature: where its registers are, a check of its value, and what the value changes."""

    places: tuple[tuple[int, int], ...]
    check: Callable[[], None]
    apply: Callable[[], None]

    def touched_by(self, address: int, count: int) -> bool:
        """Whether a write there changes the feature."""
        return any(start < address + count and address < start + length for start, length in self.places)


class Animation:
    """Ties the registers of a described camera to the features of the device behind it.

    Attributes
    ----------
    watches
        The features whose writes have an effect.
    chunk_mode
        Whether chunk data follow the images.
    """

    def __init__(
        self, evaluator: Evaluator, features: Features, banked: Mapping[str, tuple[str, ...]], law: RawGainLaw
    ) -> None:
        self._evaluator = evaluator
        self._features = features
        self._banked = {name: selector for selector, names in banked.items() for name in names}
        self._law = law
        self._lines = trigger_lines(evaluator)
        self._actions = action_signals(evaluator)
        self.chunk_mode = False
        self._chunks: dict[str, bool] = {}
        self.watches = [*self._exposure(), *self._gain(), *self._gamma(), *self._rate()]
        self.watches += [*self._image(), *self._trigger(), *self._chunk_data()]
        if features.has_ptp:
            self.watches += [*self._copied("PtpEnable", "PtpEnable"), *self._action_key()]

    @property
    def enabled_chunks(self) -> tuple[str, ...]:
        """The enabled entries of ChunkSelector, of those that are simulated."""
        return tuple(entry for entry, enabled in self._chunks.items() if enabled)

    def chunk_value(self, content: str, frame: ExposedFrame) -> float:
        """What a chunk says of a frame, in the units of its node."""
        match content:
            case "ExposureTime":
                return frame.settings.exposure_time_us / time_unit_us(self._evaluator, "ChunkExposureTime")
            case "Gain":
                gain_db = frame.settings.gain_db
                return gain_db if self._raw_gain is None else self._raw_gain.number(gain_db)
            case "FrameID":
                return frame.frame_id
            case _:
                return frame.device_time_ns

    def _exposure(self) -> Iterator[Watch]:
        names = spoken(self._evaluator, EXPOSURE_TIMES)
        for name in names:

            def apply(name: str = name) -> None:
                exposure_us = self._evaluator.value(name) * time_unit_us(self._evaluator, name)
                low, high = EXPOSURE_RANGE_US
                self._features.update("ExposureTime", float(min(max(exposure_us, low), high)))
                for other in names:
                    if other != name:
                        assign(self._evaluator, other, exposure_us / time_unit_us(self._evaluator, other))

            yield from self._watch(name, apply)
            yield from self._watch(TIME_BASE, apply)

    def _gain(self) -> Iterator[Watch]:
        with self._evaluator.selecting_entry("GainSelector", "All"):
            names = spoken(self._evaluator, GAINS)
            in_decibels = not names or in_db(self._evaluator, names[0])
            self._raw_gain = None if in_decibels else self._find_raw_gain(names[0])
        if names:
            yield from self._watch(names[0], lambda: self._apply_gain(names[0]), ("GainSelector", "All"))

    def _find_raw_gain(self, name: str) -> RawGain:
        with contextlib.suppress(NodeError):
            low, high = self._evaluator.limits(name)
            if low < high < float("inf"):
                return RawGain(float(low), float(high), self._law)
        return RawGain(law=self._law)

    def _apply_gain(self, name: str) -> None:
        value = float(self._evaluator.value(name))
        gain_db = value if self._raw_gain is None else self._raw_gain.gain_db(value)
        low, high = GAIN_RANGE_DB
        self._features.update("Gain", min(max(gain_db, low), high))

    def _rate(self) -> Iterator[Watch]:
        self._features.update("AcquisitionFrameRateEnable", True)
        for name in spoken(self._evaluator, FRAME_RATES)[:1]:

            def apply(name: str = name) -> None:
                low, high = FRAME_RATE_RANGE_HZ
                self._features.update("AcquisitionFrameRate", min(max(float(self._evaluator.value(name)), low), high))

            yield from self._watch(name, apply)
        for name in FRAME_RATE_SWITCHES:
            yield from self._copied(name, "AcquisitionFrameRateEnable")

    def _gamma(self) -> Iterator[Watch]:
        switches = [name for name in GAMMA_SWITCHES if self._evaluator.kind(name)]
        self._features.update("GammaEnable", not switches)
        self._features.update("Gamma", 1.0)
        for name in switches:
            yield from self._copied(name, "GammaEnable")
        yield from self._copied("Gamma", "Gamma")

    def _image(self) -> Iterator[Watch]:
        for size, offset in (("Width", "OffsetX"), ("Height", "OffsetY")):

            def apply(size: str = size, offset: str = offset) -> None:
                whole = int(self._features.get(f"Sensor{size}"))
                wished = int(self._evaluator.value(size))
                start = int(self._evaluator.value(offset)) if self._evaluator.kind(offset) else 0
                self._features.update(size, min(max(wished, 8), whole))
                self._features.update(offset, min(max(start, 0), whole - int(self._features.get(size))))

                self._make_room(size, offset)

            yield from self._watch(size, apply)
            yield from self._watch(offset, apply)

        yield from self._watch("PixelFormat", lambda: self._features.update("PixelFormat", self._entry("PixelFormat")))

    def _make_room(self, size: str, offset: str) -> None:
        """Set the largest size and offset that leave the image on the sensor, if each is in a register of its own."""
        whole = int(self._features.get(f"Sensor{size}"))
        limits = {name: self._evaluator.limit_node(name, "Max") for name in (size, offset)}
        shared = {self._evaluator.target(name) for name in (f"Sensor{size}", f"{size}Max")}
        for name, other in ((size, offset), (offset, size)):
            if limits[name] and limits[name] != limits[other] and self._evaluator.target(limits[name]) not in shared:
                with contextlib.suppress(NodeError):
                    self._evaluator.set(limits[name], whole - int(self._features.get(other)))

    def _trigger(self) -> Iterator[Watch]:
        selection = ("TriggerSelector", frame_trigger(self._evaluator))
        self._features.update("TriggerMode", "Off")
        for name in ("TriggerMode", "TriggerSource"):
            yield from self._watch(name, self._apply_trigger, selection)
        yield from self._watch(
            "TriggerOverlap", lambda: self._features.update("TriggerOverlap", self._entry("TriggerOverlap")), selection
        )

    def _apply_trigger(self) -> None:
        source = self._entry("TriggerSource") if self._evaluator.kind("TriggerSource") else ""
        mode = self._entry("TriggerMode") if self._evaluator.kind("TriggerMode") else "Off"
        free = source in ("Freerun", "FixedRate")  # free run, by another name
        self._features.update("TriggerMode", "Off" if free else mode)
        if source in self._lines[:1]:
            source = "Line0"
        elif source in self._actions[:1]:
            source = "Action1"
        self._features.update("TriggerSource", source)

    def _action_key(self) -> Iterator[Watch]:
        name = "ActionDeviceKey"
        return self._watch(name, lambda: self._features.update(name, int(self._evaluator.value(name))))

    def _chunk_data(self) -> Iterator[Watch]:
        def apply_mode() -> None:
            self.chunk_mode = bool(self._evaluator.value("ChunkModeActive"))

        if self._evaluator.kind("ChunkSelector") != "Enumeration":
            return
        yield from self._watch("ChunkModeActive", apply_mode)
        for entry in self._evaluator.node("ChunkSelector").entries:
            if entry in CHUNK_CONTENTS and self._evaluator.kind(f"Chunk{entry}"):

                def apply(entry: str = entry) -> None:
                    self._chunks[entry] = bool(self._evaluator.value("ChunkEnable"))

                yield from self._watch("ChunkEnable", apply, ("ChunkSelector", entry))

    def _watch(self, name: str, apply: Callable[[], None], selection: tuple[str, str] | None = None) -> Iterator[Watch]:
        """Watch a feature, if it exists; with `selection`, its value at that entry of its selector."""
        if self._evaluator.kind(name) in (None, "Category"):
            return
        with self._selecting(selection):
            places = tuple((field.address, field.length) for field in self._evaluator.fields(name).values())

        def applied() -> None:
            with contextlib.suppress(ValueError, ArithmeticError, FeatureError):  # a meaningless value changes nothing
                if not self._elsewhere(name, selection):
                    with self._selecting(selection):
                        apply()

        def check() -> None:
            with self._selecting(selection), contextlib.suppress(NodeError):
                self._check(name)

        yield Watch(places, check, applied)

    def _selecting(self, selection: tuple[str, str] | None) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext() if selection is None else self._evaluator.selecting_entry(*selection)

    def _elsewhere(self, name: str, selection: tuple[str, str] | None) -> bool:
        """Whether the register now holds the feature's value for another entry of the selector."""
        if selection is None or self._banked.get(name) != selection[0]:
            return False
        entries = self._evaluator.node(selection[0]).entries
        return selection[1] in entries and self._entry(selection[0]) != selection[1]

    def _check(self, name: str) -> None:
        """Refuse a number outside its limits, and an entry that does not exist."""
        if self._evaluator.node(name).kind == "Enumeration":
            entry = self._entry(name)
            if name == "PixelFormat":
                if entry not in PIXEL_FORMATS:
                    raise FeatureError("out_of_range", f"pixel format {entry} is not simulated")
                _check_halves(entry, int(self._features.get("Width")))
            return
        value = self._evaluator.value(name)
        if name == "Width":
            _check_halves(str(self._features.get("PixelFormat")), int(value))
        low, high = self._evaluator.limits(name)
        slack = _TOLERANCE * max(abs(value), 1.0)
        if not low - slack <= value <= high + slack:
            raise FeatureError("out_of_range", f"{name} {value:g} is not within {low:g} to {high:g}")

    def _entry(self, name: str) -> str:
        """The present entry of an enumeration."""
        value = self._evaluator.value(name)
        for entry, node in self._evaluator.node(name).entries.items():
            if node.integer("Value", 0) == value:
                return entry
        raise FeatureError("out_of_range", f"{name} has no entry with the value {value:g}")

    def _copied(self, name: str, feature: str) -> Iterator[Watch]:
        """Watch a feature whose value is copied to a `feature` of the device."""

        def apply() -> None:
            value = self._evaluator.value(name)
            self._features.update(feature, bool(value) if feature.endswith("Enable") else float(value))

        return self._watch(name, apply)


def _check_halves(pixel_format: str, width: int) -> None:
    """Refuse half a pair of pixels that share their chroma."""
    if PIXEL_FORMATS[pixel_format].colours == "YUYV" and width % 2:
        raise FeatureError("out_of_range", f"{pixel_format} has no images of {width} pixels across: an even number")
