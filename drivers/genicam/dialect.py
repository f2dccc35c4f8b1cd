"""Dialects of exposure time and gain: which nodes drive them on a camera, in which units, and without gamma."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from drivers.genicam.nodes import DECIBELS, EXACT, NodeMap, Quantity, hold, is_number, offered, switch, us_per_unit
from imaging.errors import ConfigurationError, NodeError, UnsupportedCameraError
from imaging.exposure import DB_PER_STOP, ExposureLimits, ExposureSetting
from imaging.gain_scale import FINE_DB, GainScale

TIME_NODES = ("ExposureTime", "ExposureTimeAbs")
"""SFNC 2 and SFNC 1 names."""
RAW_TIME, RAW_TIME_UNIT = "ExposureTimeRaw", "ExposureTimeBaseAbs"
"""A time in counts, and the node that holds the microseconds per count."""
GAIN_NODES = ("Gain", "GainAbs")
RAW_GAIN = "GainRaw"
GAINS = (*GAIN_NODES, RAW_GAIN)
UNDRIVEN_TIME_NODES = (RAW_TIME, "ExposureValue", "Shutter", "ShutterTime")
"""Other names seen in the field: known, so that the refusal can say what the camera offers instead."""
_NOT_BY_TIME = ("Off", "TriggerWidth", "TriggerControlled")
"""Entries of ExposureMode with which no node sets the exposure time."""

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

    `gain` is None when the camera has no gain whose dB are known: gain is then left alone and counts as 0 dB. Otherwise
    it counts less what makes up for the light that this camera misses, in every setting and in the limits.
    """

    time: Quantity
    gain: Quantity | None
    limitations: tuple[str, ...]

    def limits(self, nodes: NodeMap) -> ExposureLimits:
        """Bounds and increments as the camera's nodes give them now.

        Raises UnsupportedCameraError when they leave nothing to control.
        """
        (min_time_us, max_time_us), time_step_us = self.time.bounds(nodes), self.time.increment(nodes)
        if min_time_us <= 0:  # none is declared, or one that is no exposure time
            min_time_us = time_step_us or LEAST_TIME_US
        if max_time_us < min_time_us:
            raise UnsupportedCameraError(
                f"camera {nodes.serial}: its {self.time.node} takes {min_time_us:g} to {max_time_us:g} us, which is no "
                "exposure time"
            )
        if self.gain is None:
            return ExposureLimits(min_time_us, max_time_us, 0.0, 0.0, time_step_us)
        uneven_db = self.gain.uneven_steps(nodes)
        gain_step_db = 0.0 if uneven_db else self.gain.increment(nodes)
        min_gain_db, max_gain_db = self.gain.bounds(nodes)
        if min_gain_db <= -EXACT:  # none is declared: steps count from 0
            min_gain_db = LOWEST_GAIN_DB // gain_step_db * gain_step_db if gain_step_db else LOWEST_GAIN_DB
        return ExposureLimits(min_time_us, max_time_us, min_gain_db, max_gain_db, time_step_us, gain_step_db, uneven_db)

    def read(self, nodes: NodeMap) -> ExposureSetting:
        """The setting that the nodes hold now. Raises NodeError when a node reads what no setting has."""
        time_us = self.time.read(nodes)
        if time_us <= 0:
            raise NodeError(
                f"camera {nodes.serial}: node {self.time.node} reads {time_us:g} us, which is not an exposure time"
            )
        return ExposureSetting(time_us, 0.0 if self.gain is None else self.gain.read(nodes))

    def settle(self, nodes: NodeMap, limits: ExposureLimits) -> ExposureSetting:
        """Write the present setting back, or the nearest one within `limits`, and return what the nodes then hold.

        So what cannot be written shows when the camera is opened; and it may have been switched on with anything.
        """
        try:
            present = ExposureSetting(self.time.read(nodes), 0.0 if self.gain is None else self.gain.read(nodes))
        except NodeError:  # not a number
            present = limits.darkest
        near = limits.rounded(present)
        self.time.write(nodes, near.exposure_time_us)
        if self.gain is not None:
            self.gain.write(nodes, near.gain_db)
        return self.read(nodes)

    def write(self, nodes: NodeMap, setting: ExposureSetting, present: ExposureSetting | None) -> ExposureSetting:
        """Write what differs from `present` (None: everything), and return what the nodes read back.

        Raises NodeError when a node refuses the value, or reads back one that rounding does not explain.
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
        time_us, gain_db = asked.exposure_time_us, asked.gain_db
        for quantity, unit, wanted, got, rounding in (
            (self.time, "us", time_us, taken.exposure_time_us, TIME_ROUNDING * time_us),
            (self.gain, "dB", gain_db, taken.gain_db, GAIN_ROUNDING_DB),
        ):
            off = abs(got - wanted)
            # Increments are checked last: reading them may take a round trip.
            if quantity is not None and off > rounding and off > quantity.increment(nodes):
                set_to = f"node {quantity.node} was set to {wanted:g} {unit}"
                raise NodeError(f"camera {nodes.serial}: {set_to} and reads back {got:g} {unit}")


def find_dialect(
    nodes: NodeMap,
    gain_scale: GainScale | Literal["own numbers"] | None = None,
    count_us: float | None = None,
    offset_stops: float = 0.0,
) -> ExposureDialect:
    """Find the nodes that drive this camera's exposure; `gain_scale`, `count_us`, `offset_stops` as in `CameraSetup`.

    Raises UnsupportedCameraError when the camera offers no exposure time that can be written, in a known unit;
    ConfigurationError when the scale of its gain is for another gain, the length of a count for a time that has a unit,
    or an offset for a camera whose gain is not driven.
    """
    time = _find_time(nodes, count_us)
    gain, limitations = _find_gain(nodes, gain_scale)
    if offset_stops:
        if gain is None:
            raise ConfigurationError(
                f"camera {nodes.serial}: offset_stops needs a gain that is driven: {limitations[0]}, or remove it"
            )
        gain, rounded = _offset(nodes, gain, offset_stops)
        limitations += rounded
    return ExposureDialect(time, gain, limitations)


def gain_driven(nodes: NodeMap) -> bool:
    """Whether the camera's gain is driven because it is in dB."""
    return _find_gain(nodes, None)[0] is not None


def switch_auto_off(nodes: NodeMap) -> None:
    """Switch the camera's automatic exposure and gain off, and have ExposureTime set the exposure.

    Raises NodeError when the camera exposes otherwise, and cannot be had to expose like that.
    """
    if "All" in offered(nodes, "GainSelector"):
        hold(nodes, "GainSelector", "All")
    modes = offered(nodes, "ExposureMode")
    if "Timed" in modes:
        hold(nodes, "ExposureMode", "Timed")
    elif modes and (mode := nodes.read("ExposureMode")) in _NOT_BY_TIME:
        raise NodeError(
            f"camera {nodes.serial}: its ExposureMode is {mode} and cannot be Timed, so no node sets its exposure time"
        )
    for name in ("ExposureAuto", "GainAuto"):
        if nodes.available(name):
            switch(nodes, name, False)


def _find_time(nodes: NodeMap, count_us: float | None) -> Quantity:
    there = [name for name in (*TIME_NODES, RAW_TIME) if is_number(nodes, name)]
    drivable = [name for name in there if nodes.writable(name)]
    lengths_us = {name: _own_length_us(nodes, name) for name in drivable}
    for name, length_us in lengths_us.items():
        if length_us is not None:
            if count_us is not None:
                raise ConfigurationError(
                    f"camera {nodes.serial}: the unit of its {name} is known: leave out exposure_count_us"
                )
            return Quantity(name, length_us, step=_base_us(nodes) if name != RAW_TIME else 0.0)
    if count_us is not None and drivable:
        return Quantity(drivable[0], count_us)
    raise UnsupportedCameraError(f"camera {nodes.serial}: {_why_no_time(nodes, there, drivable)}")


def _own_length_us(nodes: NodeMap, name: str) -> float | None:
    """Microseconds in one of what an exposure time is counted in; None if the camera does not say."""
    unit = nodes.unit(name)
    known_us = us_per_unit(unit)
    if name == RAW_TIME and (unit is None or known_us is None):  # no unit means microseconds only of a time
        return _base_us(nodes) or None
    return known_us


def _base_us(nodes: NodeMap) -> float:
    """Microseconds in a count of the raw exposure time; 0 if the camera does not say."""
    return float(nodes.read(RAW_TIME_UNIT)) if is_number(nodes, RAW_TIME_UNIT, "float") else 0.0


def _why_no_time(nodes: NodeMap, there: list[str], drivable: list[str]) -> str:
    if drivable:
        unit = nodes.unit(drivable[0])
        count = (
            "counts in steps of unknown length"
            if unit is None
            else f"is in {unit!r}, which is not a known unit of time"
        )
        advice = "give the microseconds in one as exposure_count_us of this camera (docs/look-up/configuration.md)"
        return f"its {drivable[0]} {count}: {advice}"
    if there:
        return f"its {' and '.join(there)} cannot be written"
    others = [name for name in UNDRIVEN_TIME_NODES if nodes.available(name)]
    offer = f"it offers only {', '.join(others)}" if others else "it offers no other known exposure node"
    return f"neither {' nor '.join(TIME_NODES)} can be written; {offer}"


def _find_gain(
    nodes: NodeMap, gain_scale: GainScale | Literal["own numbers"] | None
) -> tuple[Quantity | None, tuple[str, ...]]:
    there = [Quantity(name) for name in GAINS if is_number(nodes, name)]
    stuck = {gain.node: why for gain in there if (why := _why_stuck(nodes, gain)) is not None}
    drivable = [gain for gain in there if gain.node not in stuck]
    for gain in drivable:
        if gain.node != RAW_GAIN and (nodes.unit(gain.node) or "").strip().lower() in DECIBELS:
            _check_scale(nodes, gain_scale, f"its {gain.node} is in dB already")
            return gain, ()
    if not drivable:
        _check_scale(nodes, gain_scale, "it has no gain that is a number and can be written")
        return None, (_why_no_gain(nodes, stuck),)
    own = drivable[0]
    if gain_scale is None:
        units = nodes.unit(own.node) or ("raw units" if own.node == RAW_GAIN else "numbers without a unit")
        text = f"gain ({own.node}) is in {units} and not driven, so that dim light stays dark: run `autoexpose "
        return None, (f"{text}calibrate gain --camera {nodes.serial}`",)
    if isinstance(gain_scale, GainScale):
        if gain_scale.node != own.node:
            _check_scale(nodes, gain_scale, f"its gain is {own.node}, not {gain_scale.node}")
        own = replace(own, gain_scale=gain_scale)
    return own, ()


def _offset(nodes: NodeMap, gain: Quantity, offset_stops: float) -> tuple[Quantity, tuple[str, ...]]:
    """The gain less what makes up for missing light, and what of that it cannot, in words.

    In whole steps where all are alike, so that the steps of this camera's gain remain those of the others.
    """
    wanted_db = offset_db = offset_stops * DB_PER_STOP
    step_db = gain.increment(nodes) if gain.gain_scale is None else 0.0
    if step_db:
        offset_db = round(wanted_db / step_db) * step_db
    if abs(offset_db - wanted_db) > FINE_DB:
        made_up = f"offset_stops {offset_stops:g} is {wanted_db:.2f} dB, made up for by {offset_db:.2f} dB"
        return replace(gain, offset=offset_db), (f"{made_up}: its gain has steps of {step_db:g} dB",)
    return replace(gain, offset=offset_db), ()


def _why_stuck(nodes: NodeMap, gain: Quantity) -> str | None:
    """Why a gain cannot be driven; None if it can."""
    if not nodes.writable(gain.node):
        return "cannot be written"
    try:
        low, high = gain.bounds(nodes)
    except NodeError as error:
        return f"has no bounds ({error})"
    return None if low < high else f"takes {low:g} to {high:g}"


def _why_no_gain(nodes: NodeMap, stuck: dict[str, str]) -> str:
    for name, why in stuck.items():
        return f"gain ({name}) {why}: left at its present value"
    for name in GAIN_NODES:
        if nodes.available(name):
            return f"gain ({name}) is not a number: left at its present value"
    return "no gain node: exposure time alone is driven"


def _check_scale(nodes: NodeMap, gain_scale: object, why: str) -> None:
    """Refuse a scale that this camera's gain does not need or fit."""
    if gain_scale is not None:
        raise ConfigurationError(f"camera {nodes.serial}: {why}: a gain calibration does not apply to it")


SWITCHES = ("GammaEnable", "GammaEnabled")
"""Names of the switch by vendor: Basler and FLIR's newer cameras, FLIR's older ones."""


def switch_gamma_off(nodes: NodeMap) -> tuple[str, ...]:
    """Switch gamma off, or set it to 1, and return the limitations, in words."""
    try:
        for name in SWITCHES:
            if nodes.available(name):
                switch(nodes, name, False)
                return ()
        if is_number(nodes, "Gamma", "float"):
            hold(nodes, "Gamma", 1.0)
    except NodeError as error:
        return (f"gamma cannot be switched off, so grey levels are not proportional to light ({error})",)
    return ()
