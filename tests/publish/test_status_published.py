"""What other processes are told of a daemon: over zenoh, from a daemon on two fake cameras, in real time."""

from __future__ import annotations

import pytest

from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.config import Config
from autoexpose_daemon.config_publish import PublishConfig
from autoexpose_daemon.describe import describe
from autoexpose_daemon.publish.keys import status_key
from autoexpose_daemon.publish.publisher import Publisher
from autoexpose_daemon.states import State
from autoexpose_daemon.status import Status
from autoexpose_daemon.telemetry import Telemetry
from tests.autoexpose_daemon.stereo import running_daemon, stereo_cameras
from tests.publish.steps import PATIENCE_S, endpoint, wait_until

CONFIG = Config.model_validate({"cameras": {"left": {"serial": "L"}, "right": {"serial": "R"}}})

pytestmark = pytest.mark.realtime


def test_the_status_is_told_once_a_second_and_at_the_end() -> None:
    at = endpoint()
    settings = {"control": {"policy": "neves2009"}, "publish": {"listen": [at], "rig": "scout"}}
    with stereo_cameras() as cameras, StatusClient("scout", [at]) as client:
        with running_daemon(cameras, settings) as run:
            wait_until(lambda: latest(client).state is State.EXPOSING and latest(client).pairs > 30, "pairs")
            status = latest(client)
            assert (status.rig, status.policy, status.ending) == ("scout", "neves2009", False)
            assert {side: camera.camera for side, camera in status.cameras.items()} == run.daemon.telemetry.cameras
            assert 0 < status.rate_hz < 90
            assert status.command_to_effect_ms.count > 0
            assert set(client.responses) == {"left", "right"}
        wait_until(lambda: latest(client).ending, "the last word")
        assert latest(client).pairs == run.daemon.tally.pairs


def latest(client: StatusClient) -> Status:
    wait_until(lambda: client.status is not None, "a status")
    assert client.status is not None
    return client.status


def test_it_is_told_without_a_single_pair() -> None:
    at = endpoint()
    said = describe(Telemetry(), CONFIG)
    with (
        Publisher(PublishConfig(listen=(at,)), 2, lambda _last: {status_key("rig"): said.to_json()}),
        StatusClient(connect=[at]) as client,
    ):
        assert [client.wait(PATIENCE_S), client.wait(PATIENCE_S)] == [said, said]
