"""What cameras call the features that are simulated, and in which units they are."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from fake_camera.genapi.description import NodeError
from fake_camera.genapi.evaluator import Evaluator

TIME_UNITS_US = {"s": 1e6, "ms": 1e3, "ns": 1e-3}
"""Microseconds per unit of time, by the names in descriptions; any other name, or none, means microseconds."""
EXPOSURE_TIMES = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")
TIME_BASE = "ExposureTimeBaseAbs"
"""Microseconds in a count of ExposureTimeRaw."""
GAINS = ("Gain", "GainAbs", "GainRaw")
FRAME_RATES = ("AcquisitionFrameRate", "AcquisitionFrameRateAbs")
FRAME_RATE_SWITCHES = ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled")
GAMMA_SWITCHES = ("GammaEnable", "GammaEnabled")
"""Names that vendors give these features, those in physical units first."""
CHUNK_CONTENTS = {
    "ExposureTime": "ExposureTime", "Gain": "Gain", "GainAll": "Gain", "FrameID": "FrameID", "FrameCounter": "FrameID",
    "Framecounter": "FrameID", "Timestamp": "Timestamp",
}  # fmt: skip
"""What simulated chunks contain, by the vendors' names for the entries of ChunkSelector."""
LIVE_COMMANDS = ("AcquisitionStart", "AcquisitionStop", "TimestampLatch", "TriggerSoftware")
NUMBERS = ("Integer", "Float", "IntReg", "MaskedIntReg", "FloatReg", "Converter", "IntConverter")
"""Kinds of nodes that hold a number."""


def spoken(evaluator: Evaluator, names: Sequence[str]) -> tuple[str, ...]:
    """Those of `names` that drive this camera; a raw one only if there is no other."""
    there = tuple(name for name in names if evaluator.kind(name) in NUMBERS)
    return tuple(name for name in there if not name.endswith("Raw")) or there


def in_db(evaluator: Evaluator, name: str) -> bool:
    """Whether the unit of a gain is dB."""
    return evaluator.node(name).text("Unit").lower() == "db"


def time_unit_us(evaluator: Evaluator, name: str) -> float:
    """Microseconds per unit of a time; of a count, where there is a time base."""
    if name == "ExposureTimeRaw" and evaluator.kind(TIME_BASE) in NUMBERS:
        with contextlib.suppress(NodeError):
            return evaluator.value(TIME_BASE) or 1.0
    return TIME_UNITS_US.get(evaluator.node(name).text("Unit"), 1.0)


def frame_trigger(evaluator: Evaluator) -> str:
    """The entry of TriggerSelector whose trigger starts a frame: FrameStart, or its older name."""
    entries = evaluator.node("TriggerSelector").entries if evaluator.kind("TriggerSelector") == "Enumeration" else {}
    return "ExposureStart" if "ExposureStart" in entries and "FrameStart" not in entries else "FrameStart"


def trigger_lines(evaluator: Evaluator) -> tuple[str, ...]:
    """The external lines among the trigger sources; the wire is plugged into the first."""
    return _sources(evaluator, ("Line", "Input"))


def action_signals(evaluator: Evaluator) -> tuple[str, ...]:
    """The action signals among the trigger sources; action commands raise the first."""
    return _sources(evaluator, ("Action",))


def _sources(evaluator: Evaluator, beginnings: tuple[str, ...]) -> tuple[str, ...]:
    if evaluator.kind("TriggerSource") != "Enumeration":
        return ()
    return tuple(entry for entry in evaluator.node("TriggerSource").entries if entry.startswith(beginnings))
