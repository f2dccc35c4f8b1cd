"""Signals end a camera whenever they come."""

from __future__ import annotations

import signal
import threading

import pytest

from fake_camera.signals import stopped_by_signals, wait_for


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_may_come_while_its_event_is_locked(number: signal.Signals) -> None:
    before = {known: signal.getsignal(known) for known in (signal.SIGTERM, signal.SIGINT)}
    try:
        stop = stopped_by_signals()
        with stop._cond:  # as within its wait()
            signal.raise_signal(number)
        assert stop.wait(10)
    finally:
        for known, handler in before.items():
            signal.signal(known, handler)


def test_a_signal_just_before_the_wait_ends_it() -> None:
    """Its handler runs only after a wait has returned."""

    class Interrupted(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            assert timeout is not None, "waits for good"
            was_set = self.is_set()
            self.set()
            return was_set

    stop = Interrupted()
    wait_for(stop)
    assert stop.is_set()
