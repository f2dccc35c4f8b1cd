"""`ros/autoexpose_msgs` as a ROS 2 user meets it: built by colcon, then spoken by rclpy of ROS 2 Jazzy.

rclpy and what builds packages come as wheels, into `build/ros2` (`ros2/install`); the command `ros2` is not among them.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from random import SystemRandom

import pytest

from autoexpose_daemon.messages.frames import TOPICS, MessageWriter
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN
from autoexpose_daemon.messages.types import (
    LIGHT_AHEAD,
    REGISTRATION,
    TRACKED_CELLS,
    TYPESTORE,
    serialise,
)
from imaging.frames import CameraName
from tests import REPOSITORY
from tests.accept.ros2_environment import ros_environment
from tests.autoexpose_daemon.publish.steps import DECISION, pair
from tests.fuzz.of_robot import light_ahead_seeds, registration_seeds, tracked_cells_seeds

PACKAGE = REPOSITORY / "ros/autoexpose_msgs"
ROS = REPOSITORY / "build/ros2"
DOMAIN = SystemRandom().randint(100, LAST_ROS2_DOMAIN)
ENVIRONMENT = ros_environment(ROS, DOMAIN)

pytestmark = [pytest.mark.needs("cmake", "g++", "rosidl"), pytest.mark.timeout(300)]

READ_AND_WRITE = """
import importlib, json, sys
from rclpy.serialization import deserialize_message, serialize_message
for kind, cdr in json.load(sys.stdin).items():
    package, _, name = kind.split("/")
    message = deserialize_message(bytes.fromhex(cdr), getattr(importlib.import_module(f"{package}.msg"), name))
    print(kind, serialize_message(message).hex())
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
    """Fast CDR leaves between fields what was there before, where we write zeros."""
    return serialise(TYPESTORE.deserialize_cdr(cdr, kind), kind)


def examples() -> Iterator[tuple[str, bytes]]:
    """A message of each type of frames and of each of ours, by our own encoders."""
    wanted: set[tuple[CameraName, str]] = {("left", topic) for topic in TOPICS}
    for message in MessageWriter("rig", 2).messages(pair(7), {"left": DECISION}, 3, 0, wanted):
        yield TOPICS[message.topic], bytes(message.data)
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


def test_the_rosidl_of_debian_takes_the_definitions(tmp_path: Path) -> None:
    """Older than that of Jazzy: from before types had hashes."""
    files = sorted(f"msg/{file.name}" for file in (PACKAGE / "msg").iterdir())
    command = ["/usr/bin/rosidl", "generate", "--output-path", str(tmp_path), "--type", "c", "--type", "cpp"]
    subprocess.run([*command, "autoexpose_msgs", *files], cwd=PACKAGE, check=True, capture_output=True)
    for name in ("exposure_info", "light_ahead", "registration", "tracked_cells"):
        assert (tmp_path / f"c/msg/{name}.h").exists()
        assert (tmp_path / f"cpp/msg/{name}.hpp").exists()
