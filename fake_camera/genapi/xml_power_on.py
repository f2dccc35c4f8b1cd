"""Power-on state of a camera known only by its description: features available, within limits, at usual values."""

from __future__ import annotations

from math import inf

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
from fake_camera.genapi.opener import Opener, Wished
from fake_camera.genapi.settle import settle
from fake_camera.genapi.solve import assign
from fake_camera.imaging import PIXEL_FORMATS

_LOCKED = "TLParamsLocked"

_EXPOSURE_US = Wished(10.0, 1e6, 1.0, 5000.0)
_TIME_BASE_US = Wished(1.0, 100.0, 1.0, 10.0)
_GAIN_DB = Wished(0.0, 36.0, 0.01, 0.0)
_RAW_GAIN = Wished(0, 240, 1, 0)
_RATE_HZ = Wished(1.0, 200.0, 0.01, 30.0)
_GAMMA = Wished(0.25, 4.0, 0.01, 0.8)
_PACKET_BYTES = Wished(220, 9000, 4, 9000)


def power_on(evaluator: Evaluator, sensor_width: int, sensor_height: int) -> tuple[str, ...]:
    """Set the registers of a camera; returns the features that could not be made available."""
    opener = Opener(evaluator)
    _image(opener, sensor_width, sensor_height)
    _exposure(opener)
    # A selector that the client holds stays where it stands: what it selects there must exist, too.
    for entry in dict.fromkeys((opener.entry("GainSelector"), "All")):
        with opener.selecting("GainSelector", entry):
            _gain(opener)
    for entry in dict.fromkeys((opener.entry("TriggerSelector"), frame_trigger(evaluator))):
        with opener.selecting("TriggerSelector", entry):
            _trigger(opener)
    _chunks(opener)
    with opener.at(_LOCKED, 1):  # clients lock the transport parameters before they start
        opener.command("AcquisitionStart")
        opener.command("AcquisitionStop")
    opener.command("TimestampLatch")
    opener.switch("PtpEnable", False)
    for name in ("PayloadSize", "TimestampLatchValue"):
        opener.open(name, writable=False)
    settle(opener)
    return tuple(dict.fromkeys(opener.failed))


def _image(opener: Opener, width: int, height: int) -> None:
    for axis, size in (("Width", width), ("Height", height)):
        for name in (f"Sensor{axis}", f"{axis}Max"):
            opener.number(name, Wished(8, size, 1, size), writable=False)
    for name, offset, size, step in (("Width", "OffsetX", width, 4), ("Height", "OffsetY", height, 2)):
        opener.number(name, Wished(8, size, step, size))
        opener.number(offset, Wished(0, inf, step, 0))  # its maximum follows from the size: `Animation`
    opener.choice("PixelFormat", tuple(PIXEL_FORMATS))
    opener.number("GevSCPSPacketSize", _PACKET_BYTES)


def _exposure(opener: Opener) -> None:
    opener.choice("ExposureMode", ("Timed",))
    opener.choice("ExposureAuto", ("Off", "Continuous"))
    opener.number(TIME_BASE, _TIME_BASE_US)
    for name in spoken(opener.evaluator, EXPOSURE_TIMES):
        opener.number(name, _EXPOSURE_US.over(time_unit_us(opener.evaluator, name)))
    for name in FRAME_RATE_SWITCHES:
        opener.switch(name, True)
    for name in spoken(opener.evaluator, FRAME_RATES):
        opener.number(name, _RATE_HZ)
    opener.choice("AcquisitionMode", ("Continuous",))
    switches = [name for name in GAMMA_SWITCHES if opener.evaluator.kind(name)]
    for name in switches:
        opener.switch(name, True)  # Gamma itself may be locked otherwise
    opener.number("Gamma", _GAMMA)
    for name in switches:
        assign(opener.evaluator, name, 0)


def _gain(opener: Opener) -> None:
    opener.choice("GainAuto", ("Off", "Continuous"))
    for name in spoken(opener.evaluator, GAINS):
        opener.number(name, _GAIN_DB if in_db(opener.evaluator, name) else _RAW_GAIN)


def _trigger(opener: Opener) -> None:
    opener.choice("TriggerMode", ("Off", "On"))
    lines = trigger_lines(opener.evaluator)
    actions = action_signals(opener.evaluator)
    opener.choice("TriggerSource", (*lines, "Software", "Freerun", "FixedRate", *actions))
    with opener.selecting("TriggerMode", "On", now=False):  # some exist only then
        opener.choice("TriggerActivation", ("RisingEdge",))
        opener.choice("TriggerOverlap", ("Off", "ReadOut"))
        with opener.selecting("TriggerSource", "Software", now=False):
            opener.command("TriggerSoftware")


def _chunks(opener: Opener) -> None:
    opener.switch("ChunkModeActive", True)  # some selectors exist only while chunks are on
    if opener.evaluator.kind("ChunkSelector") == "Enumeration":
        for entry in CHUNK_CONTENTS:
            with opener.selecting("ChunkSelector", entry) as offered:
                if offered:
                    opener.switch("ChunkEnable", False)
    if opener.evaluator.kind("ChunkModeActive"):
        assign(opener.evaluator, "ChunkModeActive", 0)
