"""Whether exposure and readout fit into the trigger period."""

from __future__ import annotations

from drivers.genicam.nodes import NodeMap
from drivers.setup import TriggerSetup

_READOUT_NODES = ("SensorReadoutTime", "ReadoutTimeAbs")
"""Readout time in us (Basler's names; other makers have no such node)."""


def timing_limitations(nodes: NodeMap, trigger: TriggerSetup) -> tuple[str, ...]:
    """Why the longest exposure and the readout do not fit, in words; empty if the camera reports no readout.

    The camera must have been armed: with TriggerOverlap ReadOut a frame is read out while the next one is exposed.
    """
    readout_us = next((nodes.read_float(name) for name in _READOUT_NODES if nodes.is_float(name)), None)
    if readout_us is None or trigger.rate_hz is None:
        return ()
    period_us = 1e6 / trigger.rate_hz
    overlaps = "ReadOut" in nodes.entries("TriggerOverlap") and nodes.read_entry("TriggerOverlap") == "ReadOut"
    left_us = period_us if overlaps else period_us - readout_us
    if readout_us > period_us:
        return (
            f"a readout of {readout_us:.0f} us does not fit into a trigger period of {period_us:.0f} us: lower "
            "trigger.rate_hz, or choose binning or a smaller region",
        )
    if trigger.longest_exposure_us <= left_us:
        return ()
    return (
        f"an exposure of {trigger.longest_exposure_us:g} us and a readout of {readout_us:.0f} us do not fit into a "
        f"trigger period of {period_us:.0f} us: lower exposure.max_time_us to {left_us:.0f}, or trigger.rate_hz",
    )
