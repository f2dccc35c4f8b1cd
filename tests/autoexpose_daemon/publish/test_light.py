"""Light ahead over real sessions of zenoh: what comes in, what is refused, and what control makes of it."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.light_ahead import LightSeries
from autoexpose_daemon.messages.frames import DamagedMessageError
from autoexpose_daemon.messages.inputs import LARGEST_LIGHT_BYTES, light_ahead, read_light_ahead
from autoexpose_daemon.messages.keys import light_ahead_key
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.recording.recorder import ContinuousRecorder
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import line_of
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.recording.runs import replayed
from tests.autoexpose_daemon.scripted import scripted_daemon

pytestmark = pytest.mark.wire

SERIES = LightSeries(np.linspace(8.0, 12.0, 200), np.linspace(0.0, -3.0, 200), 100, 0.02, 0.05)


def series(
    levels: list[float], now: int = 0, step_s: float = 0.02, spread_s: float = 0.05, risen: list[float] | None = None
) -> bytes:
    light = np.zeros(len(levels)) if risen is None else np.array(risen)
    return light_ahead(LightSeries(np.array(levels), light, now, step_s, spread_s), 5)


def test_a_series_is_read_as_it_was_written() -> None:
    read = read_light_ahead(light_ahead(SERIES, 7_000_000_123))
    assert (read.levels == SERIES.levels).all() and (read.risen == SERIES.risen).all()
    assert (read.now, read.step_s, read.spread_s) == (SERIES.now, SERIES.step_s, SERIES.spread_s)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"garbage" * 60, "not a autoexpose_msgs/msg/LightAhead"),
        (series([]), "0 levels that is at level 0"),
        (series([9.0] * 513), "513 levels"),
        (series([9.0], now=1), "1 levels that is at level 1"),
        (series([math.nan, 9.0]), "a level or a rise of the light beyond 100 stops"),
        (series([9.0], risen=[math.nan]), "a level or a rise of the light beyond 100 stops"),
        (series([9.0], risen=[0.0, 1.0]), "1 levels in light of 2 places"),
        (series([9.0], step_s=0.0), "in steps of 0 s"),
        (series([9.0], spread_s=math.inf), "spread inf s"),
    ],
)
def test_what_is_no_series_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(DamagedMessageError, match=why):
        read_light_ahead(data)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_series_or_refused(data: bytes) -> None:
    try:
        read_light_ahead(data)
    except DamagedMessageError:
        return


def test_control_weighs_what_a_client_sends_and_its_recording_replays(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    at, file = endpoint(), tmp_path / "run.mcap"
    with (
        caplog.at_level(logging.WARNING),
        ContinuousRecorder(file, 600, PublishConfig()) as recorder,
        scripted_daemon(recorder, publish={"listen": [at]}) as (daemon, _, seen),
        StereoClient(connect=[at], name="repeat") as client,
    ):
        tally = daemon.telemetry.light_ahead
        assert tally is not None and tally.belief is None

        def is_believed() -> bool:
            client.next_pair(0.0)  # which connects
            client.send_light_ahead(SERIES)
            return tally.belief is not None

        wait_until(is_believed, "a decision by the series")
        assert "% trusted" in line_of(describe(daemon.telemetry, daemon.tuning.config))
        with open_session("client", Endpoints(connect=[at])) as other:
            wait_until(lambda: other.put(light_ahead_key("rig"), b"?") or tally.refused, "a refusal")
            other.put(light_ahead_key("rig"), bytes(LARGEST_LIGHT_BYTES + 1))
        wait_until(lambda: tally.belief is None, "the series to be too old")
        count = len(seen)
        wait_until(lambda: len(seen) > count, "more pairs")
    assert [message for message in caplog.messages if "refused" in message] == [
        "a message under autoexpose/rig/light_ahead is refused: not a autoexpose_msgs/msg/LightAhead: "
        + caplog.messages[-1].rpartition("LightAhead: ")[2]
    ]
    steps = replayed(file)
    assert {each.step.inputs.light_ahead is None for each in steps} == {True, False}
    assert all(each.same for each in steps[1:])
