"""Which features the daemon itself drives, so that nobody else may set them."""

from __future__ import annotations

from collections.abc import Iterator

from drivers.genicam.dialect import GAINS, RAW_TIME, TIME_NODES
from drivers.genicam.gamma import SWITCHES
from drivers.genicam.trigger import ACTION_NODES, PTP_SWITCHES, RATE_NODES, RATE_SWITCHES, SOFTWARE_TRIGGER
from drivers.setup import CameraSetup, FeatureSetting
from imaging.errors import ConfigurationError

_DRIVEN = "the daemon drives it: "
_TIME = f"{_DRIVEN}set exposure.min_time_us and exposure.max_time_us instead"
_GAIN = f"{_DRIVEN}set exposure.min_gain_db and exposure.max_gain_db instead"
_RATE = f"{_DRIVEN}set trigger.rate_hz instead"
_REMOVE = f"{_DRIVEN}remove it"

_ALWAYS = {
    **dict.fromkeys((*TIME_NODES, RAW_TIME, "ExposureMode", "ExposureAuto"), _TIME),
    "GainAuto": _GAIN,
    "BalanceWhiteAuto": "it stays Off, so that the colours keep their proportions: remove it",
    **dict.fromkeys((*SWITCHES, "Gamma"), "gamma is off, so that grey levels are proportional to light: remove it"),
    "TriggerMode": f"{_DRIVEN}set trigger.mode instead",
    "TriggerSource": f"{_DRIVEN}set trigger.mode and trigger.line instead",
    "TriggerActivation": f"{_DRIVEN}for falling edges set LineInverter of the trigger's line instead",
    "TriggerOverlap": _REMOVE,
    **dict.fromkeys((*RATE_SWITCHES, "AcquisitionFrameRateAuto"), _RATE),
    "PixelFormat": f"{_DRIVEN}set image.pixel_format instead",
    **dict.fromkeys(("ChunkModeActive", "ChunkEnable"), _REMOVE),
    "GevSCPSPacketSize": f"{_DRIVEN}set transport.packet_size_bytes instead",
    **dict.fromkeys(("GevCCP", "GevSCPHostPort", "GevSCDA", "TLParamsLocked"), _REMOVE),
    **dict.fromkeys(("AcquisitionMode", "AcquisitionStart", "AcquisitionStop", "AcquisitionAbort"), _REMOVE),
    "DeviceReset": "the camera would restart whenever it is opened: remove it",
    "UserSetSave": "it would wear out the camera's memory whenever it is opened: save once, with the maker's program",
}
"""Advice by the name of each feature that is driven on every camera, here or by Aravis for the stream, or harmful."""
_BINNED = ("BinningHorizontal", "BinningVertical", "Width", "Height", "OffsetX", "OffsetY")
_SHARE = ("GevSCPD", "DeviceLinkThroughputLimit", "DeviceLinkThroughputLimitMode")
_OUTPUT = ("LineMode", "LineSource")


def refuse_driven(setup: CameraSetup, gain_driven: bool = False) -> Iterator[ConfigurationError]:
    """What is wrong with each feature of a setup that the daemon drives itself.

    A gain that is not in dB is driven only with a scale: `gain_driven` says whether the camera's is in dB, False if
    that is not known.
    """
    for feature in setup.features:
        words = advice(feature, setup, gain_driven)
        if words is not None:
            yield ConfigurationError(f"{feature.key} cannot be set here: {words}")


def advice(feature: FeatureSetting, setup: CameraSetup, gain_driven: bool) -> str | None:
    """What to do instead of setting a feature; None for one that is free."""
    if feature.name in _ALWAYS:
        return _ALWAYS[feature.name]
    trigger, line = setup.trigger, feature.entry("LineSelector")
    own_rate = trigger.mode == "free_run" and trigger.rate_hz is not None
    own_line = trigger.output_line is not None and line in (None, trigger.output_line)
    driven = [
        (_GAIN, GAINS, gain_driven or setup.gain_scale is not None),
        (_RATE, RATE_NODES, own_rate),
        (_REMOVE, (SOFTWARE_TRIGGER,), trigger.mode == "software"),
        (_REMOVE, (*PTP_SWITCHES, *ACTION_NODES), trigger.mode == "ptp"),
        (f"{_DRIVEN}set trigger.output_line instead", _OUTPUT, own_line),
        ("image.binning sets it: remove that, or this", _BINNED, setup.binning is not None),
        ("transport.plan sets it: remove that, or this", _SHARE, setup.link_share is not None),
    ]
    return next((words for words, names, applies in driven if applies and feature.name in names), None)
