"""Which nodes drive this camera's exposure, and in which units: the dialects of exposure time and gain."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import NodeError, UnsupportedCameraError
from drivers.exposure import ExposureLimits, ExposureSetting
from drivers.nodes import NodeMap

TIME_NODES = ("ExposureTime", "ExposureTimeAbs")
"""SFNC 2 and SFNC 1 names, both in microseconds."""
UNDRIVEN_TIME_NODES = ("ExposureTimeRaw", "ExposureValue", "Shutter", "ShutterTime")
"""Other names seen in the field: known, so that the refusal can say what the camera offers instead."""
MICROSECONDS = frozenset({None, "us", "µs", "μs", "usec", "microseconds"})
"""No unit counts as microseconds, as the SFNC prescribes for these names."""

TIME_ROUNDING = 0.1
GAIN_ROUNDING_DB = 0.5
"""Cameras round exposure time to sensor lines and gain to steps without declaring it; more than a tenth of the time
(0.14 stops), or half a dB, is no rounding but a value refused."""


@dataclass(frozen=True, slots=True)
class ExposureDialect:
    """The nodes that drive exposure time (us) and gain (dB) of one camera, and what it lacks in words.

    `gain_node` is None when the camera has no gain in dB: gain is then left alone and counts as 0 dB.
    """

    time_node: str
    gain_node: str | None
    lacks: tuple[str, ...]

    def limits(self, nodes: NodeMap) -> ExposureLimits:
        """Bounds and increments as the camera's nodes give them now."""
        time_us = nodes.float_bounds(self.time_node)
        time_step_us = nodes.float_increment(self.time_node)
        if self.gain_node is None:
            return ExposureLimits(*time_us, 0.0, 0.0, time_step_us)
        gain_db = nodes.float_bounds(self.gain_node)
        return ExposureLimits(*time_us, *gain_db, time_step_us, nodes.float_increment(self.gain_node))

    def read(self, nodes: NodeMap) -> ExposureSetting:
        """The setting that the nodes hold."""
        gain_db = 0.0 if self.gain_node is None else nodes.read_float(self.gain_node)
        return ExposureSetting(nodes.read_float(self.time_node), gain_db)

    def write(self, nodes: NodeMap, setting: ExposureSetting, present: ExposureSetting | None) -> ExposureSetting:
        """Write what differs from `present` (None: everything), and return what the nodes read back.

        Raises
        ------
        NodeError
            When a node refuses the value, or reads back one that rounding does not explain.
        """
        if self.gain_node is None and setting.gain_db != 0.0:
            raise NodeError(
                f"camera {nodes.serial}: it has no gain in dB, so {setting.gain_db:g} dB cannot be set; ask for 0 dB"
            )
        if present is None or setting.exposure_time_us != present.exposure_time_us:
            nodes.write_float(self.time_node, setting.exposure_time_us)
        if self.gain_node is not None and (present is None or setting.gain_db != present.gain_db):
            nodes.write_float(self.gain_node, setting.gain_db)
        taken = self.read(nodes)
        self._check_rounding(nodes, setting, taken)
        return taken

    def _check_rounding(self, nodes: NodeMap, asked: ExposureSetting, taken: ExposureSetting) -> None:
        allowed_us = max(TIME_ROUNDING * asked.exposure_time_us, nodes.float_increment(self.time_node))
        if abs(taken.exposure_time_us - asked.exposure_time_us) > allowed_us:
            raise NodeError(
                f"camera {nodes.serial}: node {self.time_node} was set to {asked.exposure_time_us:g} us "
                f"and reads back {taken.exposure_time_us:g} us"
            )
        if self.gain_node is None:
            return
        allowed_db = max(GAIN_ROUNDING_DB, nodes.float_increment(self.gain_node))
        if abs(taken.gain_db - asked.gain_db) > allowed_db:
            raise NodeError(
                f"camera {nodes.serial}: node {self.gain_node} was set to {asked.gain_db:g} dB "
                f"and reads back {taken.gain_db:g} dB"
            )


def find_dialect(nodes: NodeMap) -> ExposureDialect:
    """Find the nodes that drive this camera's exposure.

    Raises
    ------
    UnsupportedCameraError
        When no exposure time in microseconds is offered.
    """
    gain_node, lacks = _find_gain(nodes)
    return ExposureDialect(_find_time(nodes), gain_node, lacks)


def switch_auto_off(nodes: NodeMap) -> None:
    """Take exposure and gain from the camera's own automatics, and let the exposure time rule the exposure."""
    for name, entry in (("ExposureMode", "Timed"), ("ExposureAuto", "Off"), ("GainAuto", "Off")):
        if entry in nodes.entries(name) and nodes.read_entry(name) != entry:
            nodes.write_entry(name, entry)
    if "All" in nodes.entries("GainSelector"):
        nodes.write_entry("GainSelector", "All")


def _find_time(nodes: NodeMap) -> str:
    for name in TIME_NODES:
        if not nodes.available(name):
            continue
        if not nodes.is_float(name):
            raise UnsupportedCameraError(
                f"camera {nodes.serial}: its {name} is not a floating-point number; this dialect is not driven yet"
            )
        if nodes.unit(name) not in MICROSECONDS:
            raise UnsupportedCameraError(
                f"camera {nodes.serial}: its {name} is in {nodes.unit(name)!r} and not in microseconds; "
                "this dialect is not driven yet"
            )
        return name
    others = [name for name in UNDRIVEN_TIME_NODES if nodes.available(name)]
    offer = f"it offers only {', '.join(others)}" if others else "it offers no other exposure node known here"
    raise UnsupportedCameraError(f"camera {nodes.serial}: neither {' nor '.join(TIME_NODES)} can be written; {offer}")


def _find_gain(nodes: NodeMap) -> tuple[str | None, tuple[str, ...]]:
    if nodes.is_float("Gain") and (nodes.unit("Gain") or "").lower() == "db":
        return "Gain", ()
    if not any(nodes.available(name) for name in ("Gain", "GainAbs", "GainRaw")):
        return None, ("no gain node: exposure time alone is driven",)
    return None, ("gain has no dB scale: left at its present value, exposure time alone is driven",)
