"""The camera's features as declared, by their SFNC names.

The values are those of a Blackfly S with a Sony IMX287, at power-on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fake_camera.imaging import PIXEL_FORMATS
from fake_camera.ptp.slave import PortState

Value = int | float | bool | str
Type = Literal["integer", "float", "boolean", "string", "enumeration"]

ENUM_ENTRIES: dict[str, dict[str, int]] = {
    "PixelFormat": {name: pixel_format.pfnc_code for name, pixel_format in PIXEL_FORMATS.items()},
    "AcquisitionMode": {"Continuous": 0, "SingleFrame": 1},
    "ExposureMode": {"Timed": 0},
    "ExposureAuto": {"Off": 0, "Once": 1, "Continuous": 2},
    "GainSelector": {"All": 0},
    "GainAuto": {"Off": 0, "Once": 1, "Continuous": 2},
    "BalanceWhiteAuto": {"Off": 0, "Continuous": 2},
    "BalanceRatioSelector": {"Red": 0, "Green": 1, "Blue": 2},
    "TriggerSelector": {"FrameStart": 0},
    "TriggerMode": {"Off": 0, "On": 1},
    "TriggerSource": {"Software": 0, "Line0": 1, "Line3": 4, "Action1": 32},
    "TriggerActivation": {"RisingEdge": 3},
    "TriggerOverlap": {"Off": 0, "ReadOut": 1},
    "LineSelector": {"Line0": 0, "Line1": 1, "Line3": 3},
    "LineMode": {"Input": 0, "Output": 1},
    "LineSource": {"Off": 0, "ExposureActive": 3},
    "ChunkSelector": {"ExposureTime": 0, "Gain": 1, "FrameID": 2, "Timestamp": 3},
    "EventSelector": {"ExposureEnd": 0},
    "EventNotification": {"Off": 0, "On": 1},
    "UserSetSelector": {"Default": 0, "UserSet0": 1},
    "ActionUnconditionalMode": {"Off": 0, "On": 1},
    "PtpClockAccuracy": {"Unknown": 0xFE},
    "PtpStatus": {state.name: state.value for state in PortState},
    "PtpServoStatus": {"Unknown": 0, "Locked": 1},
}
"""Entries of the enumerations with the integers their registers hold."""

CHUNK_BYTES: dict[str, int] = {"ExposureTime": 8, "Gain": 8, "FrameID": 8, "Timestamp": 8}
"""Size of each chunk's data: two doubles (us, dB) and two 64-bit integers (count, ns)."""

CHUNK_TRAILER_BYTES = 8
"""Chunk id and length, which follow the data of each chunk and of the image."""


@dataclass(frozen=True, slots=True)
class Spec:
    """One feature as declared: `locked_while` names another feature and the value at which that locks this one.

    An integer that may be below 0 has 64 bits.
    """

    name: str
    type: Type
    initial: Value
    minimum: float = 0
    maximum: float = 0
    increment: float = 0
    unit: str = ""
    writable: bool = True
    locked_while: tuple[str, Value] | None = None


ACTION_QUEUE_SIZE = 10
"""Scheduled action commands that a camera keeps."""

_U32_MAX = 2**32 - 1
_ACQUIRING = ("TLParamsLocked", 1)


def specs(model: str, serial: str, sensor_width: int, sensor_height: int, pixel_format: str) -> list[Spec]:
    """The table of features of one camera."""

    def fixed(name: str, type_: Type, value: Value, unit: str = "") -> Spec:
        return Spec(name, type_, value, unit=unit, writable=False)

    def choice(name: str, initial: str, locked_while: tuple[str, Value] | None = None) -> Spec:
        return Spec(name, "enumeration", initial, locked_while=locked_while)

    return [
        fixed("DeviceVendorName", "string", "Autoexpose"),
        fixed("DeviceModelName", "string", model),
        fixed("DeviceSerialNumber", "string", serial),
        fixed("DeviceVersion", "string", "1.0"),
        fixed("DeviceFirmwareVersion", "string", "1.0"),
        Spec("DeviceUserID", "string", "", maximum=15, unit="bytes"),
        fixed("DeviceTemperature", "float", 46.0, "C"),
        fixed("SensorWidth", "integer", sensor_width, "px"),
        fixed("SensorHeight", "integer", sensor_height, "px"),
        fixed("WidthMax", "integer", sensor_width, "px"),
        fixed("HeightMax", "integer", sensor_height, "px"),
        Spec("Width", "integer", sensor_width, 8, sensor_width, 4, "px", locked_while=_ACQUIRING),
        Spec("Height", "integer", sensor_height, 8, sensor_height, 2, "px", locked_while=_ACQUIRING),
        Spec("OffsetX", "integer", 0, 0, sensor_width, 4, "px", locked_while=_ACQUIRING),
        Spec("OffsetY", "integer", 0, 0, sensor_height, 2, "px", locked_while=_ACQUIRING),
        Spec("BinningHorizontal", "integer", 1, 1, 4, 1, locked_while=_ACQUIRING),
        Spec("BinningVertical", "integer", 1, 1, 4, 1, locked_while=_ACQUIRING),
        choice("PixelFormat", pixel_format, _ACQUIRING),
        fixed("PayloadSize", "integer", 0, "bytes"),
        choice("AcquisitionMode", "Continuous", _ACQUIRING),
        Spec("AcquisitionFrameRateEnable", "boolean", True),
        Spec(
            "AcquisitionFrameRate",
            "float",
            30.0,
            1.0,
            300.0,
            unit="Hz",
            locked_while=("AcquisitionFrameRateEnable", False),
        ),
        fixed("SensorReadoutTime", "float", 0.0, "us"),
        choice("ExposureMode", "Timed"),
        Spec("ExposureTime", "float", 5000.0, 10.0, 1e6, 1.0, "us", locked_while=("ExposureAuto", "Continuous")),
        choice("ExposureAuto", "Continuous"),
        choice("GainSelector", "All"),
        Spec("Gain", "float", 0.0, 0.0, 47.0, unit="dB", locked_while=("GainAuto", "Continuous")),
        choice("GainAuto", "Continuous"),
        choice("BalanceWhiteAuto", "Continuous"),
        Spec("BlackLevel", "float", 0.0, 0.0, 12.5, unit="%"),
        Spec("Gamma", "float", 0.8, 0.25, 4.0),
        Spec("GammaEnable", "boolean", False),
        choice("TriggerSelector", "FrameStart"),
        choice("TriggerMode", "Off"),
        choice("TriggerSource", "Line0"),
        choice("TriggerActivation", "RisingEdge"),
        choice("TriggerOverlap", "Off"),
        choice("LineSelector", "Line0"),
        fixed("LineMode", "enumeration", "Input"),
        choice("LineSource", "Off", ("LineMode", "Input")),
        Spec("TLParamsLocked", "integer", 0, 0, 1, 1),
        Spec("ChunkModeActive", "boolean", False, locked_while=_ACQUIRING),
        choice("ChunkSelector", "ExposureTime"),
        Spec("ChunkEnable", "boolean", False, locked_while=_ACQUIRING),
        choice("EventSelector", "ExposureEnd"),
        choice("EventNotification", "Off"),
        fixed("Timestamp", "integer", 0, "ns"),
        fixed("TimestampLatchValue", "integer", 0, "ns"),
        Spec("ReverseX", "boolean", False, locked_while=_ACQUIRING),
        Spec("ReverseY", "boolean", False, locked_while=_ACQUIRING),
        Spec("LineInverter", "boolean", False),
        choice("UserSetSelector", "Default"),
        choice("BalanceRatioSelector", "Red"),
        Spec("BalanceRatio", "float", 1.0, 0.0, 4.0, locked_while=("BalanceWhiteAuto", "Continuous")),
    ]


def ptp_specs(clock: int) -> list[Spec]:
    """The features of a camera with action commands and a PTP clock of this identity (EUI-64)."""

    def latched(name: str, type_: Type, value: Value, unit: str = "") -> Spec:
        return Spec(name, type_, value, -(2**63), 2**63 - 1, unit=unit, writable=False)

    return [
        Spec("ActionDeviceKey", "integer", 0, 0, _U32_MAX, 1),
        Spec("ActionSelector", "integer", 1, 1, 1, 1),
        Spec("ActionGroupKey", "integer", 0, 0, _U32_MAX, 1),
        Spec("ActionGroupMask", "integer", 0, 0, _U32_MAX, 1),
        Spec("ActionUnconditionalMode", "enumeration", "Off"),
        Spec("ActionQueueSize", "integer", ACTION_QUEUE_SIZE, writable=False),
        Spec("PtpEnable", "boolean", False),
        Spec("PtpClockAccuracy", "enumeration", "Unknown", writable=False),
        Spec("PtpStatus", "enumeration", "Disabled", writable=False),
        Spec("PtpServoStatus", "enumeration", "Unknown", writable=False),
        latched("PtpOffsetFromMaster", "integer", 0, "ns"),
        latched("PtpClockID", "integer", clock),
        latched("PtpParentClockID", "integer", clock),
        latched("PtpGrandmasterClockID", "integer", clock),
    ]
