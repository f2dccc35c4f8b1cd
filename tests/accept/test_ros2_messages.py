"""`ros/autoexpose_msgs` as a ROS 2 user meets it: built by colcon, then spoken by rclpy of ROS 2 Jazzy.

rclpy and what builds packages come as wheels, into `build/ros2` (`ros2/install`); the command `ros2` is not among them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from random import SystemRandom
from typing import Any

import pytest

from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.messages.frames import MessageWriter
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN
from autoexpose_daemon.messages.types import (
    CAMERA_INFO,
    DIAGNOSTICS,
    EXPOSURE_INFO,
    IMAGE,
    LIGHT_AHEAD,
    REGISTRATION,
    TRACKED_CELLS,
    TYPESTORE,
    serialise,
)
from imaging.frames import CameraName
from tests import REPOSITORY
from tests.accept.ros2_environment import ros_environment
from tests.autoexpose_daemon.publish.steps import DECISION, endpoint, pair, publishing
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE
from tests.fuzz.of_robot import light_ahead_seeds, registration_seeds, tracked_cells_seeds

PACKAGE = REPOSITORY / "ros/autoexpose_msgs"
ROS = REPOSITORY / "build/ros2"
DOMAIN = SystemRandom().randint(100, LAST_ROS2_DOMAIN)
ENVIRONMENT = ros_environment(ROS, DOMAIN)

pytestmark = [pytest.mark.needs("cmake", "g++", "rosidl"), pytest.mark.timeout(300)]

READ_AND_WRITE = """
import json, sys
import autoexpose_msgs.msg
from rclpy.serialization import deserialize_message, serialize_message
for kind, cdr in json.load(sys.stdin).items():
    message = deserialize_message(bytes.fromhex(cdr), getattr(autoexpose_msgs.msg, kind.rpartition("/")[2]))
    print(kind, serialize_message(message).hex())
"""
LISTEN = """
import functools, json
import rclpy
from autoexpose_msgs.msg import ExposureInfo
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image
kinds = {
    "/rig/left/exposure": ExposureInfo,
    "/rig/left/camera_info": CameraInfo,
    "/rig/left/image_raw": Image,
    "/diagnostics": DiagnosticArray,
}
heard = {}
rclpy.init()
node = rclpy.create_node("listener")
for name, kind in kinds.items():
    keep = functools.partial(heard.setdefault, name)
    node.create_subscription(kind, name, keep, qos_profile_sensor_data, raw=True)
while heard.keys() != kinds.keys() or ("autoexpose", "/rig") not in node.get_node_names_and_namespaces():
    rclpy.spin_once(node, timeout_sec=0.1)
for name, kind in kinds.items():
    (publisher,) = node.get_publishers_info_by_topic(name)
    print(json.dumps({
        "cdr": heard[name].hex(),
        "again": serialize_message(deserialize_message(heard[name], kind)).hex(),
        "type": publisher.topic_type,
        "hash": str(publisher.topic_type_hash),
        "node": f"{publisher.node_namespace}/{publisher.node_name}",
    }))
"""


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made by the commands of docs/do/ros2.md."""
    assert (ROS / "bin/colcon").exists(), "no ROS 2 in build/ros2: `make accept` installs it"
    folder = tmp_path_factory.mktemp("ros2_ws")
    shutil.copytree(PACKAGE, folder / "src/autoexpose_msgs")
    command = ["colcon", "build", "--packages-select", "autoexpose_msgs"]
    built = subprocess.run(command, cwd=folder, env=ENVIRONMENT, text=True, capture_output=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder


def in_workspace(workspace: Path, code: str) -> subprocess.Popen[str]:
    """Python of ROS 2 after `source install/setup.bash`."""
    command = ["bash", "-c", f'source {workspace}/install/setup.bash && exec python -c "$0"', code]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=ENVIRONMENT, stdin=pipe, stdout=pipe, stderr=pipe, text=True)


def without_gaps(cdr: bytes, kind: str) -> bytes:
    """Fast CDR leaves between fields what was there before, where we write zeros; Cyclone DDS fills the last word."""
    return serialise(TYPESTORE.deserialize_cdr(cdr, kind), kind)


def examples() -> Iterator[tuple[str, bytes]]:
    """A message of each of our types, by our own encoders."""
    wanted: set[tuple[CameraName, str]] = {("left", "exposure")}
    (exposure,) = MessageWriter("rig", 2).messages(pair(7), {"left": DECISION}, 3, 0, wanted)
    yield EXPOSURE_INFO, bytes(exposure.data)
    yield LIGHT_AHEAD, next(light_ahead_seeds())
    yield REGISTRATION, next(registration_seeds())
    yield TRACKED_CELLS, next(tracked_cells_seeds())


def test_rosidl_computes_the_hashes_that_we_announce(workspace: Path) -> None:
    descriptions = sorted((workspace / "install/autoexpose_msgs/share/autoexpose_msgs/msg").glob("*.json"))
    assert len(descriptions) == len(list((PACKAGE / "msg").iterdir()))
    for file in descriptions:
        hashes = {row["type_name"]: row["hash_string"] for row in json.loads(file.read_text())["type_hashes"]}
        assert f"autoexpose_msgs/msg/{file.stem}" in hashes
        assert hashes == {name: TYPESTORE.hash_rihs01(name) for name in hashes}


def test_ros_reads_our_messages_and_writes_the_same(workspace: Path) -> None:
    sent = dict(examples())
    with in_workspace(workspace, READ_AND_WRITE) as ros:
        written, errors = ros.communicate(json.dumps({kind: cdr.hex() for kind, cdr in sent.items()}), timeout=60)
    assert ros.returncode == 0, errors
    came = {kind: bytes.fromhex(cdr) for kind, cdr in map(str.split, written.splitlines())}
    assert {kind: without_gaps(cdr, kind) for kind, cdr in came.items()} == sent


def test_rclpy_hears_frames_and_how_they_were_exposed(workspace: Path) -> None:
    at = endpoint()
    command = [*AUTOEXPOSE, "ros2", "--connect", at]
    of_bridge = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_LOCALHOST_ONLY": "1"}
    with (
        publishing(PublishConfig(listen=(at,)), period_s=0.1),
        subprocess.Popen(command, env=of_bridge, stdout=subprocess.PIPE) as bridge,
        in_workspace(workspace, LISTEN) as ros,
    ):
        try:
            told, errors = ros.communicate(timeout=60)
        finally:
            ros.kill()
            bridge.terminate()
    assert ros.returncode == 0, errors
    heard = {row["type"]: row for row in map(json.loads, told.splitlines())}
    assert heard.keys() == {EXPOSURE_INFO, CAMERA_INFO, IMAGE, DIAGNOSTICS}
    for kind, row in heard.items():
        assert row["hash"] == TYPESTORE.hash_rihs01(kind)
        assert row["node"] == "/rig/autoexpose"
        cdr, again = bytes.fromhex(row["cdr"]), bytes.fromhex(row["again"])
        assert without_gaps(again, kind) == without_gaps(cdr, kind)
    exposure: Any = TYPESTORE.deserialize_cdr(bytes.fromhex(heard[EXPOSURE_INFO]["cdr"]), EXPOSURE_INFO)
    assert (exposure.exposure_time_us, exposure.gain_db, exposure.reason) == (1000.0, 6.0, DECISION.reason)


def test_the_rosidl_of_debian_takes_the_definitions(tmp_path: Path) -> None:
    """Older than that of Jazzy: from before types had hashes."""
    files = sorted(f"msg/{file.name}" for file in (PACKAGE / "msg").iterdir())
    command = ["/usr/bin/rosidl", "generate", "--output-path", str(tmp_path), "--type", "c", "--type", "cpp"]
    subprocess.run([*command, "autoexpose_msgs", *files], cwd=PACKAGE, check=True, capture_output=True)
    for name in ("exposure_info", "light_ahead", "registration", "tracked_cells"):
        assert (tmp_path / f"c/msg/{name}.h").exists()
        assert (tmp_path / f"cpp/msg/{name}.hpp").exists()
