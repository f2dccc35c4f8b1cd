"""IMU, light ahead and steering over real zenoh: what comes in, what is refused, and what control makes of it."""

from __future__ import annotations

import contextlib
import logging
import math
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from autoexpose_daemon.client import StereoClient
from autoexpose_daemon.config.document import ImuConfig, PublishConfig
from autoexpose_daemon.messages.inputs import (
    LARGEST_LIGHT_BYTES,
    LARGEST_TRACKING_BYTES,
)
from autoexpose_daemon.messages.keys import check_key_expression, rig_key
from autoexpose_daemon.messages.types import IMU, TYPESTORE
from autoexpose_daemon.publish.inbound import LARGEST_IMU_BYTES, ImuSubscriber
from autoexpose_daemon.publish.session import Endpoints, open_session
from autoexpose_daemon.recording.recorder import ContinuousRecorder
from autoexpose_daemon.runtime.inputs import AngularRate
from autoexpose_daemon.status.counters import Counts
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.document import Status
from autoexpose_daemon.status.panel import line_of
from imaging.errors import ConfigurationError
from tests.autoexpose_daemon.messages.test_inputs import FEATURES, INLIERS, SERIES
from tests.autoexpose_daemon.publish.processes import router, router_file
from tests.autoexpose_daemon.publish.steps import endpoint, wait_until
from tests.autoexpose_daemon.recording.runs import replayed
from tests.autoexpose_daemon.samples import imu_message
from tests.autoexpose_daemon.scripted import scripted_daemon
from tests.meanwhile import meanwhile

pytestmark = pytest.mark.wire

TURNING = imu_message((0.3, -0.4, 1.2))  # 1.3 rad/s
KEY = "imu/data"


@contextlib.contextmanager
def imu_at(address: str, data: bytes = TURNING, key: str = KEY) -> Iterator[None]:
    """An IMU's own process, so to say: sends a sample 200 times a second to those who connect to it."""
    with open_session("peer", Endpoints(listen=[address])) as session:

        def send(stop: threading.Event) -> None:
            while not stop.wait(0.005):
                session.put(key, data)

        with meanwhile(send):
            yield


@contextlib.contextmanager
def listening(config: ImuConfig) -> Iterator[AngularRate]:
    rate = AngularRate(config, Counts())
    with ImuSubscriber(config, rate):
        yield rate


def test_samples_come_in_and_an_imu_that_was_restarted_is_found_again() -> None:
    at = endpoint()
    with listening(ImuConfig(key=KEY, connect=(at,), max_age_s=10)) as rate:
        wait_until(lambda: rate.no_source, "why there are no samples")
        assert rate.no_source.startswith(f"zenoh, {at}: ")
        for _ in range(2):
            before = rate.tally.samples
            with imu_at(at):
                wait_until(lambda: rate.tally.samples > before + 5, "samples")  # noqa: B023  called at once
                assert rate(0) == pytest.approx(1.3)
                assert rate.no_source == ""


def test_samples_come_in_through_a_router_from_a_peer_as_ros2_nodes_are(tmp_path: Path) -> None:
    at = endpoint()
    key = f"0/{KEY}/sensor_msgs::msg::dds_::Imu_/{TYPESTORE.hash_rihs01(IMU)}"
    with (
        router(router_file(tmp_path, at)),
        open_session("peer", Endpoints(connect=[at])) as node,
        listening(ImuConfig(key=f"0/{KEY}/sensor_msgs::msg::dds_::Imu_/*", connect=(at,), max_age_s=10)) as rate,
    ):

        def a_sample_comes() -> bool:
            node.put(key, TURNING)
            return rate(0) == pytest.approx(1.3)

        wait_until(a_sample_comes, "a sample")


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "not a sensor_msgs/msg/Imu"),
        (b"garbage" * 60, "not a sensor_msgs/msg/Imu"),
        (TURNING[:200], "not a sensor_msgs/msg/Imu"),
        (imu_message((math.nan, 0, 0)), "an Imu that turns at nan rad/s"),
        (imu_message((0, -math.inf, 0)), "an Imu that turns at inf rad/s"),
        (imu_message((0, 1e300, 1e300)), "an Imu that turns at"),
        (imu_message((0, 0, 101)), "an Imu that turns at 101 rad/s"),
        (imu_message((0, 0, 1), unknown=True), "an Imu that measures no angular velocity"),
    ],
)
def test_what_is_no_angular_rate_is_refused_in_one_line(
    data: bytes, why: str, caplog: pytest.LogCaptureFixture
) -> None:
    at = endpoint()
    with caplog.at_level(logging.WARNING), imu_at(at, data), listening(ImuConfig(key=KEY, connect=(at,))) as rate:
        wait_until(lambda: rate.tally.refused > 3, "messages")
        assert rate(0) is None
    assert rate.tally.samples == 0
    said, _ = caplog.messages
    assert said.startswith(f"a message under {KEY} is refused: {why}")
    assert said.isprintable()


def test_what_is_too_large_is_not_looked_at() -> None:
    at, large = endpoint(), bytes(LARGEST_IMU_BYTES + 1)
    config = ImuConfig(key="imu/*", connect=(at,))
    with imu_at(at, large, "imu/image"), listening(config) as rate:
        with open_session("client", Endpoints(connect=[at])) as other:
            wait_until(lambda: other.put(KEY, TURNING) or rate.tally.samples > 0, "a sample")
        assert rate.tally.refused == 0


def check_replay(file: Path, field: str) -> None:
    """It is bit for bit, of decisions with and without the input."""
    steps = replayed(file)
    assert {getattr(each.step.inputs, field) is None for each in steps} == {True, False}
    assert all(each.same for each in steps[1:])


CHUNKS = st.sampled_from(
    ["imu", "**", "*", "a*", "@a", "data", "$*", "", "x" * 600, "a#", "a?", "a$", " ", "\x00", "ü"]
)


@given(st.lists(CHUNKS, min_size=1, max_size=5).map("/".join) | st.text(max_size=8))
@example("**/*")
@example("**/**")
def test_every_key_that_a_configuration_may_name_is_one_of_zenohs(key: str) -> None:
    try:
        check_key_expression(key)
    except ConfigurationError as error:
        assert "is not a key expression of zenoh" in str(error)
        assert str(error).isprintable()
    else:
        zenoh.KeyExpr(key)


def test_control_goes_by_the_imu_and_without_it_by_flow_and_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its recording is replayed bit for bit."""
    at, file = endpoint(), tmp_path / "run.mcap"
    imu = {"key": KEY, "connect": [at], "max_age_s": 0.5}
    control = {"policy": "neves2009", "focal_length_px": 600}
    with (
        caplog.at_level(logging.INFO, "autoexpose_daemon.runtime.inputs"),
        ContinuousRecorder(file, 600, PublishConfig()) as recorder,
        scripted_daemon(recorder, control=control, motion={"imu": imu}) as (daemon, _, seen),
    ):

        def status() -> Status:
            return describe(daemon.telemetry, daemon.tuning.config)

        wait_until(lambda: status().counts.decisions_without_imu > 5, "decisions without the IMU")
        with imu_at(at):
            wait_until(lambda: not status().reasons, "an IMU that is there")
            assert seen[-1][1] is not None
            assert seen[-1][1].motion_px == pytest.approx(1.3 * 600 / 60)
            assert "imu 1.30 rad/s" in line_of(status())
        silent = f"image speed comes from optical flow: no IMU sample as {KEY} for more than 0.5 s"
        wait_until(lambda: silent in status().reasons, "flow")
        assert re.search(r"decisions without the IMU: \d+; .*imu not used", line_of(status()))
        wait_until(lambda: seen[-1][1] is not None and seen[-1][1].motion_px < 10, "the speed by flow")
    assert [message.partition(": ")[0] for message in caplog.messages if "image speed" in message] == [
        "image speed comes from optical flow",
        "image speed comes from the IMU",
        "image speed comes from optical flow",
    ]
    check_replay(file, "angular_rate_rad_s")


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
            wait_until(lambda: other.put(rig_key("rig", "light_ahead"), b"?") or tally.refused, "a refusal")
            other.put(rig_key("rig", "light_ahead"), bytes(LARGEST_LIGHT_BYTES + 1))
        wait_until(lambda: tally.belief is None, "the series to be too old")
        count = len(seen)
        wait_until(lambda: len(seen) > count, "more pairs")
    assert [message for message in caplog.messages if "refused" in message] == [
        "a message under autoexpose/rig/light_ahead is refused: not a autoexpose_msgs/msg/LightAhead: "
        + caplog.messages[-1].rpartition("LightAhead: ")[2]
    ]
    check_replay(file, "light_ahead")


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
            wait_until(lambda: other.put(rig_key("rig", "tracking"), b"?") or tally.refused["damaged"], "a refusal")
            other.put(rig_key("rig", "tracking"), bytes(LARGEST_TRACKING_BYTES + 1))
        wait_until(lambda: not tally.by, "the report to be too old")
        count = len(seen)
        wait_until(lambda: len(seen) > count, "more pairs")
    said = [text for text in caplog.messages if "track" in text]
    assert len(said) == 2
    assert "a report of consumer slam on its tracking is ignored: its frame is older than 1 s" in said
    assert any("a message under autoexpose/rig/tracking is refused" in text for text in said)
    check_replay(file, "steering")
