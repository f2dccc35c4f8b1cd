"""Ten virtual hours with drifting clocks and a PTP master that comes and goes: two minutes of one processor."""

from __future__ import annotations

from tests.autoexpose_daemon.virtual_ptp import PtpRun


def test_pairs_are_of_one_instant_for_ten_hours() -> None:
    """Half a period is 25 ms; while the master is away, the clocks drift apart by 90 ms."""
    run = PtpRun(rate_hz=20.0)
    run.begin()
    run.hours_with_outages(10)
