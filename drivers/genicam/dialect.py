"""Dialects of exposure time and gain: which nodes drive them on a camera, and in which units."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from drivers.errors import ConfigurationError, NodeError, UnsupportedCameraError
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.exposure.gain_scale import GainScale
from drivers.genicam.nodes import NodeMap
from drivers.genicam.quantity import DECIBELS, EXACT, MICROSECONDS, Quantity, find_quantity, is_number

TIME_NODES = ("ExposureTime", "ExposureTimeAbs")
"""SFNC 2 and SFNC 1 names."""
RAW_TIME, RAW_TIME_UNIT = "ExposureTimeRaw", "ExposureTimeBaseAbs"
"""A time in counts, and the node that holds the microseconds per count."""
GAIN_NODES = ("Gain", "GainAbs")
RAW_GAIN = "GainRaw"
UNDRIVEN_TIME_NODES = (RAW_TIME, "ExposureValue", "Shutter", "ShutterTime")
"""Other names seen in the field: known, so that the refusal can say what the camera offers instead."""

LEAST_TIME_US = 1.0
"""Of a camera that declares no exposure time above 0 as its least, and no increment."""
LOWEST_GAIN_DB = -200.0
"""Of a camera that declares no least gain."""
TIME_ROUNDING = 0.1
GAIN_ROUNDING_DB = 0.5
"""Cameras round exposure time to sensor lines and gain to steps without declaring it; more than a tenth of the time
(0.14 stops), or half a dB, is not rounding but a refusal."""


@dataclass(frozen=True, slots=True)
class ExposureDialect:
    """The nodes that drive exposure time (us) and gain (dB) of one camera, and its limitations in words.

    `gain` is None when the camera has no gain whose dB are known: gain is then left alone and counts as 0 dB.
    """

    time: Quantity
    gain: Quantity | None
    limitations: tuple[str, ...]

    def limits(self, nodes: NodeMap) -> ExposureLimits:
        """Bounds and increments as the camera's nodes give them now."""
        (min_time_us, max_time_us), time_step_us = self.time.bounds(nodes), self.time.increment(nodes)
        if min_time_us <= 0:  # none is declared, or one that is no exposure time
            min_time_us = time_step_us or LEAST_TIME_US
        if self.gain is None:
            return ExposureLimits(min_time_us, max_time_us, 0.0, 0.0, time_step_us)
        uneven_db = self.gain.uneven_steps(nodes)
        gain_step_db = 0.0 if uneven_db else self.gain.increment(nodes)
        min_gain_db, max_gain_db = self.gain.bounds(nodes)
        if min_gain_db <= -EXACT:  # none is declared: steps count from 0
            min_gain_db = LOWEST_GAIN_DB // gain_step_db * gain_step_db if gain_step_db else LOWEST_GAIN_DB
        return ExposureLimits(min_time_us, max_time_us, min_gain_db, max_gain_db, time_step_us, gain_step_db, uneven_db)

    def read(self, nodes: NodeMap) -> ExposureSetting:
        """The setting that the nodes hold now."""
        time_us = self.time.read(nodes)
        if time_us <= 0:
            raise NodeError(
                f"camera {nodes.serial}: node {self.time.node} reads {time_us:g} us, which is not an exposure time"
            )
        return ExposureSetting(time_us, 0.0 if self.gain is None else self.gain.read(nodes))

    def write(self, nodes: NodeMap, setting: ExposureSetting, present: ExposureSetting | None) -> ExposureSetting:
        """Write what differs from `present` (None: everything), and return what the nodes read back.

        Raises
        ------
        NodeError
            When a node refuses the value, or reads back one that rounding does not explain.
        """
        if self.gain is None and setting.gain_db != 0.0:
            raise NodeError(
                f"camera {nodes.serial}: it has no gain known in dB, so {setting.gain_db:g} dB cannot be "
                "set; ask for 0 dB"
            )
        if present is None or setting.exposure_time_us != present.exposure_time_us:
            self.time.write(nodes, setting.exposure_time_us)
        if self.gain is not None and (present is None or setting.gain_db != present.gain_db):
            self.gain.write(nodes, setting.gain_db)
        taken = self.read(nodes)
        self._check_rounding(nodes, setting, taken)
        return taken

    def _check_rounding(self, nodes: NodeMap, asked: ExposureSetting, taken: ExposureSetting) -> None:
        # Increments are checked last: reading them may take a round trip.
        off_us = abs(taken.exposure_time_us - asked.exposure_time_us)
        if off_us > TIME_ROUNDING * asked.exposure_time_us and off_us > self.time.increment(nodes):
            raise NodeError(
                f"camera {nodes.serial}: node {self.time.node} was set to {asked.exposure_time_us:g} us "
                f"and reads back {taken.exposure_time_us:g} us"
            )
        if self.gain is None:
            return
        off_db = abs(taken.gain_db - asked.gain_db)
        if off_db > GAIN_ROUNDING_DB and off_db > self.gain.increment(nodes):
            raise NodeError(
                f"camera {nodes.serial}: node {self.gain.node} was set to {asked.gain_db:g} dB "
                f"and reads back {taken.gain_db:g} dB"
            )


def find_dialect(nodes: NodeMap, gain_scale: GainScale | Literal["own numbers"] | None = None) -> ExposureDialect:
    """Find the nodes that drive this camera's exposure; `gain_scale` as in `drivers.config.setup.CameraSetup`.

    Raises
    ------
    UnsupportedCameraError
        When the camera offers no exposure time in a known unit.
    ConfigurationError
        When the scale of its gain is for another gain.
    """
    time = _find_time(nodes)
    gain, limitations = _find_gain(nodes, gain_scale)
    return ExposureDialect(time, gain, limitations)


def gain_driven(nodes: NodeMap) -> bool:
    """Whether the camera's gain is driven because it is in dB."""
    return _find_gain(nodes, None)[0] is not None


def switch_auto_off(nodes: NodeMap) -> None:
    """Switch the camera's automatic exposure and gain off, and have ExposureTime set the exposure."""
    for name, entry in (("ExposureMode", "Timed"), ("ExposureAuto", "Off"), ("GainAuto", "Off")):
        if entry in nodes.entries(name) and nodes.read_entry(name) != entry:
            nodes.write_entry(name, entry)
    if "All" in nodes.entries("GainSelector"):
        nodes.write_entry("GainSelector", "All")


def _find_time(nodes: NodeMap) -> Quantity:
    refusals = []
    for name in TIME_NODES:
        if not is_number(nodes, name):
            continue
        if nodes.unit(name) in MICROSECONDS:
            step_us = nodes.read_float(RAW_TIME_UNIT) if nodes.is_float(RAW_TIME_UNIT) else 0.0
            return Quantity(name, MICROSECONDS[nodes.unit(name)], nodes.is_integer(name), step=step_us)
        refusals.append(f"its {name} is in {nodes.unit(name)!r}, which is not a known unit of time")
    if is_number(nodes, RAW_TIME):
        scale = _length_of_count_us(nodes)
        if scale is not None:
            return Quantity(RAW_TIME, scale, nodes.is_integer(RAW_TIME))
        refusals.append(f"its {RAW_TIME} counts in steps of unknown length, as it has no {RAW_TIME_UNIT}")
    if not refusals:
        others = [name for name in UNDRIVEN_TIME_NODES if nodes.available(name)]
        offer = f"it offers only {', '.join(others)}" if others else "it offers no other known exposure node"
        refusals = [f"neither {' nor '.join(TIME_NODES)} can be written; {offer}"]
    raise UnsupportedCameraError(f"camera {nodes.serial}: {'; '.join(refusals)}")


def _length_of_count_us(nodes: NodeMap) -> float | None:
    """Microseconds per count of the raw exposure time; None if the camera does not say."""
    unit = nodes.unit(RAW_TIME)
    if unit is not None and unit in MICROSECONDS:
        return MICROSECONDS[unit]
    return nodes.read_float(RAW_TIME_UNIT) if nodes.is_float(RAW_TIME_UNIT) else None


def _find_gain(
    nodes: NodeMap, gain_scale: GainScale | Literal["own numbers"] | None
) -> tuple[Quantity | None, tuple[str, ...]]:
    for name in GAIN_NODES:
        if is_number(nodes, name) and (nodes.unit(name) or "").lower() in DECIBELS:
            _check_scale(nodes, gain_scale, f"its {name} is in dB already")
            return Quantity(name, integer=nodes.is_integer(name)), ()
    own = find_quantity(nodes, (*GAIN_NODES, RAW_GAIN))
    if own is None:
        _check_scale(nodes, gain_scale, "it has no gain that is a number")
        for name in GAIN_NODES:
            if nodes.available(name):
                return None, (f"gain ({name}) is not a number: left at its present value",)
        return None, ("no gain node: exposure time alone is driven",)
    if gain_scale is None:
        units = nodes.unit(own.node) or ("raw units" if own.node == RAW_GAIN else "numbers without a unit")
        text = f"gain ({own.node}) is in {units} and not driven, so that dim light stays dark: run `autoexpose "
        return None, (f"{text}calibrate gain --camera {nodes.serial}`",)
    if isinstance(gain_scale, GainScale):
        if gain_scale.node != own.node:
            _check_scale(nodes, gain_scale, f"its gain is {own.node}, not {gain_scale.node}")
        own = replace(own, gain_scale=gain_scale)
    return own, ()


def _check_scale(nodes: NodeMap, gain_scale: object, why: str) -> None:
    """Refuse a scale that this camera's gain does not need or fit."""
    if gain_scale is not None:
        raise ConfigurationError(f"camera {nodes.serial}: {why}: a gain calibration does not apply to it")
