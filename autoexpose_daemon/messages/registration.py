"""Where a view lies against a taught path, as a message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.messages.read import DamagedMessageError, deserialise, stamp_ns
from autoexpose_daemon.messages.types import REGISTRATION, TYPESTORE, header, serialise

MOST_MATCHES: Final = 5000
"""A frame has some 500 features."""

FURTHEST_SHIFT_PX: Final = 1 << 16
"""No frame is wider; the page draws bars for all shifts up to the furthest."""

LARGEST_REGISTRATION_BYTES: Final = 13 * MOST_MATCHES + 1024
_LONGEST_REASON: Final = 200


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredView:
    """How a frame of `autoexpose repeat` lies against the taught path, and what the robot was then commanded.

    Attributes
    ----------
    stamp_ns
        The stamp of the frame, CLOCK_REALTIME.
    distance_m, length_m
        How far along the path the frame was taken, and how long the path is.
    local_map
        Which local map it was registered with, counted from 0 along the path.
    shift_px
        How far the frame is shifted to the right of the map; None: too few matches agreed.
    x_px, y_px
        Where in the frame each match lies, float32, (n,).
    shifts_px
        How far each match is shifted to the right of the map, float32, (n,).
    agreed
        Which of the matches agreed on a shift, bool, (n,).
    forward_m_s, turn_rad_s
        The command; positive to the left.
    stopped
        Why the robot is stopped, for a person; empty while it drives.
    """

    stamp_ns: int
    distance_m: float
    length_m: float
    local_map: int
    shift_px: float | None
    x_px: NDArray[np.float32]
    y_px: NDArray[np.float32]
    shifts_px: NDArray[np.float32]
    agreed: NDArray[np.bool_]
    forward_m_s: float
    turn_rad_s: float
    stopped: str

    @property
    def votes(self) -> int:
        """How many matches agreed."""
        return int(np.count_nonzero(self.agreed))


def registration(view: RegisteredView) -> bytes:
    """A Registration."""
    message_type = TYPESTORE.types[REGISTRATION]
    of_matches = (view.x_px, view.y_px, view.shifts_px)
    x_px, y_px, shifts_px = (np.ascontiguousarray(values, np.float32) for values in of_matches)
    agreed = np.ascontiguousarray(view.agreed, np.bool_)
    message = message_type(
        header=header(view.stamp_ns, "camera"),
        distance_m=view.distance_m, length_m=view.length_m, local_map=view.local_map,
        registered=view.shift_px is not None, shift_px=math.nan if view.shift_px is None else view.shift_px,
        matches=len(view.agreed), votes=view.votes,
        x_px=x_px, y_px=y_px, shifts_px=shifts_px, agreed=agreed,
        forward_m_s=view.forward_m_s, turn_rad_s=view.turn_rad_s, stopped=view.stopped,
    )  # fmt: skip
    return serialise(message, REGISTRATION)


def read_registration(data: bytes) -> RegisteredView:
    """The view in a Registration.

    Raises
    ------
    DamagedMessageError
        When the message is something else, or not credible.
    """
    message = deserialise(data, REGISTRATION)
    agreed = np.asarray(message.agreed, np.bool_)
    of_matches = [np.asarray(values, np.float32) for values in (message.x_px, message.y_px, message.shifts_px)]
    if len(agreed) > MOST_MATCHES or any(len(values) != len(agreed) for values in of_matches):
        raise DamagedMessageError(f"a Registration with {[*map(len, of_matches), len(agreed)]} values for its matches")
    numbers = [message.distance_m, message.length_m, message.forward_m_s, message.turn_rad_s]
    if message.registered:
        numbers.append(message.shift_px)
    if not (np.isfinite(numbers).all() and all(np.isfinite(values).all() for values in of_matches)):
        raise DamagedMessageError("a Registration with numbers that are not finite")
    x_px, y_px, shifts_px = of_matches
    if (np.abs(shifts_px) > FURTHEST_SHIFT_PX).any():
        raise DamagedMessageError(f"a Registration with a match that is shifted by more than {FURTHEST_SHIFT_PX} px")
    return RegisteredView(
        stamp_ns(message), float(message.distance_m), float(message.length_m), int(message.local_map),
        float(message.shift_px) if message.registered else None, x_px, y_px, shifts_px, agreed,
        float(message.forward_m_s), float(message.turn_rad_s), message.stopped[:_LONGEST_REASON],
    )  # fmt: skip
