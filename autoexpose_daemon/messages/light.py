"""The light of an earlier drive, as a message."""

from __future__ import annotations

from typing import Final

import numpy as np

from autoexpose_daemon.control.light_ahead import MOST_LEVELS, MOST_STOPS, LightSeries
from autoexpose_daemon.messages.read import DamagedMessageError, deserialise
from autoexpose_daemon.messages.types import LIGHT_AHEAD, TYPESTORE, header, serialise

LARGEST_LIGHT_BYTES: Final = 8 * MOST_LEVELS + 1024


def light_ahead(series: LightSeries, stamp_ns: int) -> bytes:
    """A LightAhead; the stamp is CLOCK_REALTIME, ns."""
    message_type = TYPESTORE.types[LIGHT_AHEAD]
    of_robot = header(stamp_ns, "base_link")
    return serialise(message_type(of_robot, series.levels, series.now, series.step_s, series.spread_s), LIGHT_AHEAD)


def read_light_ahead(data: bytes) -> LightSeries:
    """The series in a LightAhead.

    Raises
    ------
    DamagedMessageError
        When the message is something else, or not credible.
    """
    message = deserialise(data, LIGHT_AHEAD)
    levels = np.asarray(message.levels, np.float64)
    if not 0 <= message.now < len(levels) <= MOST_LEVELS:
        raise DamagedMessageError(f"a LightAhead of {len(levels)} levels that is at level {message.now}")
    if not np.abs(levels).max() <= MOST_STOPS:
        raise DamagedMessageError(f"a LightAhead with a level beyond {MOST_STOPS:g} stops")
    if not (1e-3 <= message.step_s <= 10.0 and 0.0 <= message.spread_s <= 10.0):
        raise DamagedMessageError(f"a LightAhead in steps of {message.step_s:g} s, spread {message.spread_s:g} s")
    return LightSeries(levels, int(message.now), float(message.step_s), float(message.spread_s))
