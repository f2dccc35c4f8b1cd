from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.rig.supervision import LATE_PERIODS, Pacer, Slots

RATES_HZ = st.floats(0.1, 1000.0)
PAUSES = st.lists(st.floats(0.001, 50.0), min_size=1, max_size=60)
"""Between two looks, in periods."""


@given(RATES_HZ, st.integers(0, 10**16), PAUSES)
def test_each_slot_is_used_once_and_in_time_or_counted_as_missed(
    rate_hz: float, first_ns: int, pauses: list[float]
) -> None:
    slots = Slots.at_once(rate_hz, first_ns)
    now_ns = first_ns + 123
    pacer = Pacer(slots, now_ns)
    next_slot = slots.first_from(now_ns)
    for pause in pauses:
        now_ns += round(pause * slots.period_ns)
        while pacer.due_ns <= now_ns:
            slot, missed = pacer.take(now_ns)
            next_slot += missed
            if slot is not None:
                assert slot == next_slot
                assert 0 <= now_ns - slots.time_ns(next_slot) <= slots.closes_ns + 2
                next_slot += 1
        assert slots.time_ns(next_slot) == pacer.due_ns > now_ns


def test_a_pause_makes_no_burst_and_no_slot_drifts() -> None:
    slots = Slots.at_once(60.0, 1_000)
    pacer = Pacer(slots, 0)
    assert pacer.take(1_000) == (0, 0)
    in_slot_600 = slots.time_ns(600) + 1_000_000
    assert pacer.take(in_slot_600) == (600, 599)
    assert pacer.take(in_slot_600) == (None, 0)
    after_slot_700 = slots.time_ns(700) + math.ceil(LATE_PERIODS * slots.period_ns) + 1
    assert pacer.take(after_slot_700) == (None, 100)
    assert slots.time_ns(60 * 3600 * 24 * 365) == 1_000 + 3600 * 24 * 365 * 1_000_000_000


def test_scheduled_triggers_are_sent_ahead_as_far_as_the_queue_of_the_camera_allows() -> None:
    epoch_ns = 1_700_000_000_000_000_000
    for queue, lead_ms in ((1, 15.0), (2, 31.667), (3, 48.333), (10, 50.0)):
        slots = Slots.ahead(60.0, 1_000, epoch_ns, queue)
        assert -slots.opens_ns == pytest.approx(lead_ms * 1e6, abs=1e3)
        assert slots.device_time_ns(60) == epoch_ns + 1_000_000_000
    pacer = Pacer(slots, 1_000)
    assert pacer.due_ns >= 1_000
    sent = []
    while (slot := pacer.take(200_000_000)[0]) is not None:  # after a pause: those that are still to come
        sent.append(slot)
    assert sent == [13, 14]
    assert all(2_000_000 <= slots.time_ns(slot) - 200_000_000 <= 50_000_000 for slot in sent)
