"""Where a consumer tracks well, as a message."""

from __future__ import annotations

from typing import Final

import numpy as np

from autoexpose_daemon.control.picture.tracked_cells import COLUMNS, ROWS, TrackedCells
from autoexpose_daemon.messages.keys import CONSUMER_NAME
from autoexpose_daemon.messages.read import DamagedMessageError, deserialise, stamp_ns
from autoexpose_daemon.messages.types import TRACKED_CELLS, TYPESTORE, header, serialise
from imaging.frames import SIDES

LARGEST_TRACKING_BYTES: Final = 1024
"""A report takes some 300."""


def tracked_cells(report: TrackedCells) -> bytes:
    """A TrackedCells."""
    message_type = TYPESTORE.types[TRACKED_CELLS]
    counts = (np.ascontiguousarray(each, np.uint16).ravel() for each in (report.features, report.inliers))
    of_frame = header(report.stamp_ns, report.side)
    return serialise(message_type(of_frame, report.consumer, report.side, ROWS, COLUMNS, *counts), TRACKED_CELLS)


def read_tracked_cells(data: bytes) -> TrackedCells:
    """The report in a TrackedCells.

    Raises
    ------
    DamagedMessageError
        When the message is something else, or not credible.
    """
    message = deserialise(data, TRACKED_CELLS)
    if not CONSUMER_NAME.fullmatch(message.consumer):
        raise DamagedMessageError("a TrackedCells whose consumer is not 1 to 64 letters, digits, and any of _ . -")
    if message.side not in SIDES:
        raise DamagedMessageError(f"a TrackedCells of a camera named {message.side[:20]!a}: known are left and right")
    if (message.rows, message.columns) != (ROWS, COLUMNS):
        raise DamagedMessageError(f"a TrackedCells of {message.rows} rows and {message.columns} columns: not 6 and 8")
    features, inliers = (np.asarray(counts, np.uint16) for counts in (message.features, message.inliers))
    if features.size != inliers.size or features.size != ROWS * COLUMNS:
        raise DamagedMessageError(f"a TrackedCells of {features.size} and {inliers.size} counts: not {ROWS * COLUMNS}")
    try:
        return TrackedCells(
            message.consumer,
            stamp_ns(message),
            message.side,
            features.reshape(ROWS, COLUMNS),
            inliers.reshape(ROWS, COLUMNS),
        )
    except ValueError as error:
        raise DamagedMessageError(f"a TrackedCells with {error}") from error
