from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from fake_camera.ptp.clock import Clock

S = 1_000_000_000
EPOCH = 1_700_000_000 * S
ppm = st.floats(-500, 500)


def test_it_drifts_from_where_it_was_set() -> None:
    clock = Clock(3 * S, EPOCH, 40.0)
    assert clock.time_ns(3 * S) == EPOCH
    assert clock.time_ns(1003 * S) - EPOCH == 1000 * S + 40_000_000
    clock.set(7, 1003 * S)
    assert clock.time_ns(1004 * S) == 7 + S + 40_000


@given(ppm, ppm, st.integers(0, 10**14), st.integers(0, 10**14))
def test_the_host_time_is_found_for_the_time_it_shows(drift: float, steered: float, at_ns: int, host_ns: int) -> None:
    clock = Clock(0, EPOCH, drift)
    clock.steer(steered, at_ns)
    assert abs(clock.host_ns(clock.time_ns(host_ns)) - host_ns) <= 2


@given(ppm, ppm, st.integers(0, 10**14))
def test_steering_and_warmth_change_the_rate_but_not_the_time(drift: float, steered: float, at_ns: int) -> None:
    clock = Clock(0, EPOCH, drift)
    before_ns = clock.time_ns(at_ns)
    clock.steer(steered, at_ns)
    clock.drift(-drift, at_ns)
    assert clock.time_ns(at_ns) == before_ns
    gained_ns = clock.time_ns(at_ns + S) - before_ns - S
    assert abs(gained_ns - (steered - drift) * 1e3) <= 500  # parts per million of each other


def test_steered_against_its_drift_it_keeps_time() -> None:
    clock = Clock(0, EPOCH, -60.0)
    clock.steer(60.0, 0)
    assert abs(clock.time_ns(3600 * S) - EPOCH - 3600 * S) < 20_000
