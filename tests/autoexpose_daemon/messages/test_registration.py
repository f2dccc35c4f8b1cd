"""What `repeat` says of a frame: there and back, and what is refused."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.messages.frames import DamagedMessageError
from autoexpose_daemon.messages.inputs import (
    FURTHEST_SHIFT_PX,
    MOST_MATCHES,
    RegisteredView,
    read_registration,
    registration,
)
from tests.autoexpose_daemon.messages.registered_view import registered_view

finite = st.floats(allow_nan=False, allow_infinity=False, width=32)
shifts = st.floats(-FURTHEST_SHIFT_PX, FURTHEST_SHIFT_PX, width=32)


@given(
    st.lists(st.tuples(finite, finite, shifts, st.booleans()), max_size=20), st.none() | finite, finite, st.text("abc ")
)
def test_a_view_arrives(
    matches: list[tuple[float, float, float, bool]], shift_px: float | None, turn_rad_s: float, stopped: str
) -> None:
    x_px, y_px, shifts_px, agreed = np.array(matches, np.float32).reshape(-1, 4).T
    sent = RegisteredView(
        1_700_000_000_000_000_005, 3.5, 40.0, 17, shift_px, x_px, y_px, shifts_px, agreed > 0, 0.4, turn_rad_s, stopped
    )
    came = read_registration(registration(sent))
    for field in fields(RegisteredView):
        assert np.array_equal(getattr(came, field.name), getattr(sent, field.name)), field.name
    assert came.votes == sum(match[3] for match in matches)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"x_px": np.zeros(3, np.float32)}, r"\[3, 40, 40, 40\] values for its matches"),
        (dict.fromkeys(("x_px", "y_px", "shifts_px", "agreed"), np.zeros(MOST_MATCHES + 1)), "values for its matches"),
        ({"distance_m": math.nan}, "not finite"),
        ({"shifts_px": np.full(40, math.inf)}, "not finite"),
        ({"shifts_px": np.full(40, -1e9)}, "shifted by more than 65536 px"),
    ],
)
def test_what_is_not_credible_is_refused(change: dict[str, object], reason: str) -> None:
    with pytest.raises(DamagedMessageError, match=reason):
        read_registration(registration(replace(registered_view(), **change)))  # type: ignore[arg-type]
