from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from drivers.rig.pace import LATE_PERIODS, Pacer, Slots

RATES_HZ = st.floats(0.1, 1000.0)
PAUSES = st.lists(st.floats(0.001, 50.0), min_size=1, max_size=60)
"""Between two looks, in periods."""


@given(RATES_HZ, st.integers(0, 10**16), PAUSES)
def test_each_slot_is_used_once_and_in_time_or_counted_as_missed(
    rate_hz: float, first_ns: int, pauses: list[float]
) -> None:
    slots = Slots.at_rate(rate_hz, first_ns)
    now_ns = first_ns + 123
    pacer = Pacer(slots, now_ns)
    next_slot = slots.first_from(now_ns)
    for pause in pauses:
        now_ns += round(pause * slots.period_ns)
        while pacer.due_ns <= now_ns:
            give, missed = pacer.take(now_ns)
            next_slot += missed
            if give:
                assert 0 <= now_ns - slots.time_ns(next_slot) <= slots.open_ns + 2
                next_slot += 1
        assert slots.time_ns(next_slot) == pacer.due_ns > now_ns


def test_a_pause_makes_no_burst_and_no_slot_drifts() -> None:
    slots = Slots.at_rate(60.0, 1_000)
    pacer = Pacer(slots, 0)
    assert pacer.take(1_000) == (True, 0)
    in_slot_600 = slots.time_ns(600) + 1_000_000
    assert pacer.take(in_slot_600) == (True, 599)
    assert pacer.take(in_slot_600) == (False, 0)
    after_slot_700 = slots.time_ns(700) + math.ceil(LATE_PERIODS * slots.period_ns) + 1
    assert pacer.take(after_slot_700) == (False, 100)
    assert slots.time_ns(60 * 3600 * 24 * 365) == 1_000 + 3600 * 24 * 365 * 1_000_000_000
