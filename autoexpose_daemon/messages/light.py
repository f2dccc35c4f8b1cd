"""The light of an earlier drive, as a message."""

from __future__ import annotations

from typing import Final

import numpy as np

from autoexpose_daemon.control.light_ahead import MOST_LEVELS, MOST_STOPS, LightSeries
from autoexpose_daemon.messages.read import DamagedMessageError, deserialise
from autoexpose_daemon.messages.types import LIGHT_AHEAD, TYPESTORE, header, serialise

LARGEST_LIGHT_BYTES: Final = 16 * MOST_LEVELS + 1024


def light_ahead(series: LightSeries, stamp_ns: int) -> bytes:
    """A LightAhead; the stamp is CLOCK_REALTIME, ns."""
    message_type = TYPESTORE.types[LIGHT_AHEAD]
    of_robot = header(stamp_ns, "base_link")
    message = message_type(of_robot, series.levels, series.risen, series.now, series.step_s, series.spread_s)
    return serialise(message, LIGHT_AHEAD)


def read_light_ahead(data: bytes) -> LightSeries:
    """The series in a LightAhead.

    Raises
    ------
    DamagedMessageError
        When the message is something else, or not credible.
    """
    message = deserialise(data, LIGHT_AHEAD)
    levels, risen = np.asarray(message.levels, np.float64), np.asarray(message.risen, np.float64)
    if not 0 <= message.now < len(levels) <= MOST_LEVELS:
        raise DamagedMessageError(f"a LightAhead of {len(levels)} levels that is at level {message.now}")
    if len(risen) != len(levels):
        raise DamagedMessageError(f"a LightAhead of {len(levels)} levels in light of {len(risen)} places")
    if not np.abs(np.concatenate([levels, risen])).max() <= MOST_STOPS:
        raise DamagedMessageError(f"a LightAhead with a level or a rise of the light beyond {MOST_STOPS:g} stops")
    if not (1e-3 <= message.step_s <= 10.0 and 0.0 <= message.spread_s <= 10.0):
        raise DamagedMessageError(f"a LightAhead in steps of {message.step_s:g} s, spread {message.spread_s:g} s")
    return LightSeries(levels, risen, int(message.now), float(message.step_s), float(message.spread_s))
