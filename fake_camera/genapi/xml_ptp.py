"""PTP in a described camera: the data set that its registers show, by SFNC's names and by FLIR's."""

from __future__ import annotations

import contextlib

from fake_camera.device.features import Features
from fake_camera.genapi.description import NodeError
from fake_camera.genapi.evaluator import Evaluator
from fake_camera.genapi.solve import assign

LATCHES = ("PtpDataSetLatch", "GevIEEE1588DataSetLatch")
"""What commands that latch the data set are called."""

_SHOWN = {
    "PtpStatus": ("PtpStatus", "GevIEEE1588StatusLatched"),
    "PtpServoStatus": ("PtpServoStatus",),
    "PtpOffsetFromMaster": ("PtpOffsetFromMaster", "GevIEEE1588OffsetFromMasterLatched"),
    "PtpClockID": ("PtpClockID", "GevIEEE1588ClockId"),
    "PtpParentClockID": ("PtpParentClockID", "GevIEEE1588ParentClockIdLatched"),
    "PtpGrandmasterClockID": ("PtpGrandmasterClockID",),
}


def show_data_set(evaluator: Evaluator, features: Features) -> None:
    """Write the latched data set into the registers of the nodes that show it."""
    for feature, names in _SHOWN.items():
        value = features.get(feature)
        for name in names:
            with contextlib.suppress(NodeError):
                number = _number(evaluator, name, value)
                if number is not None:
                    assign(evaluator, name, number)


def _number(evaluator: Evaluator, name: str, value: object) -> int | None:
    """The number by which a node shows a value; None if it does not."""
    if evaluator.kind(name) is None:
        return None
    if isinstance(value, str):
        entry = evaluator.node(name).entries.get(value)
        return None if entry is None else entry.integer("Value", 0)
    assert isinstance(value, int)
    return value
