"""The grid of trigger times: its period, by which an outage is counted."""

from __future__ import annotations

import pytest

from drivers.triggers.rate import TriggerGrid

NOMINAL_NS = 1e9 / 60


@pytest.mark.parametrize("apart_ns", [100_000, 5_000_000])
@pytest.mark.parametrize("first", [0, 1])
def test_cameras_that_start_apart_do_not_change_the_period(apart_ns: int, first: int) -> None:
    """Nor does it matter whose frame arrives first."""
    period_ns = NOMINAL_NS * (1 + 20e-6)
    grid = TriggerGrid(NOMINAL_NS, 0)
    for trigger in range(3000):
        times_ns = [round(trigger * period_ns), round(trigger * period_ns) + apart_ns]
        for time_ns in (times_ns[first], times_ns[1 - first]):
            grid.observe(grid.locate(time_ns), time_ns)
    assert grid.period_ns == pytest.approx(period_ns, rel=1e-6)
