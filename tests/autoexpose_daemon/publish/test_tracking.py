"""Consumers steer over real sessions of zenoh: what comes in, what is refused, and what control makes of it."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.control.picture.tracked_cells import COLUMNS, ROWS, TrackedCells
from autoexpose_daemon.messages.frames import DamagedMessageError
from autoexpose_daemon.messages.inputs import LARGEST_TRACKING_BYTES, read_tracked_cells, tracked_cells
from autoexpose_daemon.messages.keys import tracking_key
from autoexpose_daemon.messages.types import TRACKED_CELLS, TYPESTORE, header, serialise
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.recording.recorder import ContinuousRecorder
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import line_of
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.recording.runs import replayed
from tests.autoexpose_daemon.scripted import scripted_daemon

pytestmark = pytest.mark.wire

FEATURES = np.full((ROWS, COLUMNS), 20, np.uint16)
INLIERS = np.where(np.arange(COLUMNS) < 4, FEATURES, 0).astype(np.uint16)


def message(**changes: Any) -> bytes:
    """A report with fields replaced."""
    fields = {"consumer": "slam", "side": "left", "rows": ROWS, "columns": COLUMNS}
    fields |= {"features": FEATURES.ravel(), "inliers": INLIERS.ravel()} | changes
    return serialise(TYPESTORE.types[TRACKED_CELLS](header(5, ""), **fields), TRACKED_CELLS)


def test_a_report_is_read_as_it_was_written() -> None:
    data = tracked_cells(TrackedCells("slam", 7_000_000_123, "right", FEATURES, INLIERS))
    read = read_tracked_cells(data)
    assert (read.consumer, read.stamp_ns, read.side) == ("slam", 7_000_000_123, "right")
    assert (read.features == FEATURES).all() and (read.inliers == INLIERS).all()
    assert len(data) < LARGEST_TRACKING_BYTES / 2


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"garbage" * 60, "not a autoexpose_msgs/msg/TrackedCells"),
        (message(consumer="not/a name"), "whose consumer is not 1 to 64 letters"),
        (message(side="middle"), "of a camera named 'middle'"),
        (message(rows=8, columns=6), "of 8 rows and 6 columns"),
        (message(inliers=INLIERS.ravel()[1:]), "of 48 and 47 counts"),
        (message(features=np.zeros(0, np.uint16), inliers=np.zeros(0, np.uint16)), "of 0 and 0 counts"),
        (message(features=INLIERS.ravel(), inliers=FEATURES.ravel()), "more inliers than features"),
        (message(features=np.full(48, 65_535, np.uint16)), "65535 features in a cell"),
    ],
)
def test_what_is_no_report_is_refused(data: bytes, why: str) -> None:
    with pytest.raises(DamagedMessageError, match=why):
        read_tracked_cells(data)


@given(st.binary(max_size=300))
def test_any_bytes_are_a_report_or_refused(data: bytes) -> None:
    try:
        read_tracked_cells(data)
    except DamagedMessageError:
        return


def test_a_consumer_steers_control_and_its_recording_replays(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    at, file = endpoint(), tmp_path / "run.mcap"
    with (
        caplog.at_level(logging.WARNING),
        ContinuousRecorder(file, 600, PublishConfig()) as recorder,
        scripted_daemon(recorder, publish={"listen": [at]}) as (daemon, _, seen),
        StereoClient(connect=[at], name="slam") as client,
    ):
        tally = daemon.telemetry.tracking
        assert tally is not None and not tally.by

        def is_steered() -> bool:
            pair = client.next_pair(0.1)
            if pair is not None and pair.decision is not None:
                client.send_tracking(pair.stamp_ns, FEATURES, INLIERS)
            return tally.by == ("slam",)

        wait_until(is_steered, "a decision that is steered")
        status = Status.from_json(describe(daemon.telemetry, daemon.tuning.config).to_json())
        assert status is not None and "steered by slam, age " in line_of(status)
        wait_until(lambda: client.send_tracking(1, FEATURES, INLIERS) or tally.refused["stale"], "a refusal")
        known = tally.reports + sum(tally.refused.values())
        for _ in range(40):
            client.send_tracking(1, FEATURES, INLIERS)
        wait_until(lambda: tally.reports + sum(tally.refused.values()) >= known + 40, "all of a burst to be counted")
        with open_session("client", Endpoints(connect=[at])) as other:
            wait_until(lambda: other.put(tracking_key("rig"), b"?") or tally.refused["damaged"], "a refusal")
            other.put(tracking_key("rig"), bytes(LARGEST_TRACKING_BYTES + 1))
        wait_until(lambda: not tally.by, "the report to be too old")
        count = len(seen)
        wait_until(lambda: len(seen) > count, "more pairs")
    said = [text for text in caplog.messages if "track" in text]
    assert len(said) == 2
    assert "a report of consumer slam on its tracking is ignored: its frame is older than 1 s" in said
    assert any("a message under autoexpose/rig/tracking is refused" in text for text in said)
    steps = replayed(file)
    assert {each.step.inputs.steering is None for each in steps} == {True, False}
    assert all(each.same for each in steps[1:])


def test_another_policy_takes_reports_and_is_not_steered() -> None:
    at = endpoint()
    with (
        scripted_daemon(publish={"listen": [at]}, control={"policy": "neves2009"}) as (daemon, _, _),
        StereoClient(connect=[at], name="slam") as client,
    ):
        tally = daemon.telemetry.tracking
        assert tally is not None

        def is_taken() -> bool:
            pair = client.next_pair(0.1)
            if pair is not None:
                client.send_tracking(pair.stamp_ns, FEATURES, INLIERS)
            return tally.reports > 2

        wait_until(is_taken, "reports")
        assert "steered by nobody   " in line_of(describe(daemon.telemetry, daemon.tuning.config))
