"""How sessions end."""

from __future__ import annotations

import threading

import pytest

from autoexpose_daemon.publish import session
from autoexpose_daemon.publish.session import Endpoints, SessionHolder


class StuckThread(threading.Thread):
    """Never ends; remembers how long it was waited for."""

    def __init__(self, waited_s: list[float]) -> None:
        super().__init__()
        self._waited_s = waited_s

    def is_alive(self) -> bool:
        return True

    def join(self, timeout: float | None = None) -> None:
        assert timeout is not None
        self._waited_s.append(timeout)
        threading.Event().wait(timeout)


def test_a_client_may_be_closed_by_any_of_its_threads() -> None:
    """By the one in which the garbage collector finds it forgotten."""
    closed_in_time: list[bool] = []
    holder = SessionHolder("peer", Endpoints(), lambda _session: None, lambda _trouble: None)
    thread = threading.Thread(target=lambda: closed_in_time.append(holder.close()))
    holder._threads = [thread]
    thread.start()
    thread.join()
    assert closed_in_time
    assert holder.closed.is_set()


def test_threads_that_are_stuck_are_waited_for_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_JOIN_S", 0.1)
    holder = SessionHolder("peer", Endpoints(), lambda _session: None, lambda _trouble: None)
    waited_s: list[float] = []
    holder._threads = [StuckThread(waited_s) for _ in range(4)]
    assert not holder.close()
    assert len(waited_s) == 4
    assert sum(waited_s) < 0.2
