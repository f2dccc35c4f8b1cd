"""The history while no pairs arrive, from the status."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from types import SimpleNamespace
from typing import Any

import pytest

from autoexpose_daemon.page import app
from autoexpose_daemon.page.pair_views import BUCKET_S, ExposureHistory
from tests.autoexpose_daemon.statuses import EXPOSING

AGE_S = 0.9
HEARD_TIME = (1000.0, 1000.0)
"""The range of exposure times in a status, us."""


async def recorded(pair_age_s: float) -> list[tuple[Any, ...]]:
    """Rows made of a status that is `AGE_S` old, when the newest pair is `pair_age_s` old."""
    history = ExposureHistory()
    client: Any = SimpleNamespace(status=EXPOSING, silent_s=AGE_S)
    views: Any = SimpleNamespace(pair_s=time.monotonic() - pair_age_s)
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(app._record_status(client, views, history), 0.1)
    return history.since(-math.inf)


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app, "_STATUS_PERIOD_S", 0.01)


def test_a_status_stands_where_it_was_heard() -> None:
    before_s = time.monotonic()
    (row,) = asyncio.run(recorded(pair_age_s=5.0))
    assert row[1] == HEARD_TIME
    assert before_s - AGE_S - BUCKET_S <= row[0] <= time.monotonic() - AGE_S


def test_a_status_older_than_the_newest_pair_leaves_no_mark() -> None:
    assert asyncio.run(recorded(pair_age_s=0.02)) == []
