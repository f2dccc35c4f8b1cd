"""Ten virtual hours with drifting clocks and a PTP master that comes and goes: a minute or two of one processor."""

from __future__ import annotations

import pytest

from tests.autoexpose_daemon.virtual import PtpRun


@pytest.mark.timeout(900)
def test_pairs_are_of_one_instant_for_ten_hours() -> None:
    """Half a period is 62 ms; while the master is away, the clocks drift apart by 90 ms."""
    run = PtpRun(rate_hz=8.0)
    run.begin()
    run.hours_with_outages(10)
