"""`ros/autoexpose_ros` beside a demo: built by colcon, visited by a foreign program of ROS 2, and what it costs.

    python -m tests.accept.ros2_node [--seconds 60]

Everything is in `build`: ROS 2 of wheels in `ros2`, the workspace in `ros2_ws`, and our client as its wheel has it in
`ros2_client`. With ROS2=kilted in the environment, the first two are `ros2-kilted` and `ros2_ws-kilted`.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from random import SystemRandom
from typing import IO, Any

import psutil

from autoexpose_daemon.client import MessageClient, StereoClient
from autoexpose_daemon.client.control_client import ControlClient
from autoexpose_daemon.config.document import PublishConfig
from autoexpose_daemon.demo.reference_step import reference_step_ms
from autoexpose_daemon.messages.frames import read_angular_rate
from autoexpose_daemon.messages.keys import LAST_ROS2_DOMAIN
from tests import REPOSITORY
from tests.accept.ros2_environment import ros_environment
from tests.autoexpose_daemon.publish.steps import endpoint, publishing
from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE
from tools.stage_package import stage

_SUFFIX = f"-{release}" if (release := os.environ.get("ROS2", "jazzy")) != "jazzy" else ""
ROS = REPOSITORY / f"build/ros2{_SUFFIX}"
WORKSPACE = REPOSITORY / f"build/ros2_ws{_SUFFIX}"
CLIENT = REPOSITORY / "build/ros2_client"
DOMAIN = SystemRandom().randint(100, LAST_ROS2_DOMAIN - 1)
ENVIRONMENT = ros_environment(ROS, DOMAIN)
NODE = f"{WORKSPACE}/install/autoexpose_ros/lib/autoexpose_ros/rig"
FOREIGN = str(Path(__file__).with_name("ros2") / "foreign.py")
RATE_HZ = 20
PATIENCE_S = 60.0
FAST_HZ, MEASURED_S = 60.0, 15.0

LISTEN = """
import sys, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image
from autoexpose_msgs.msg import ExposureInfo
rclpy.init()
node, counts = rclpy.create_node("listener"), {}
def hear(kind, name):
    def count(_): counts[name] = counts.get(name, 0) + 1
    qos = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(kind, name, count, qos, raw=True)
for camera in ("left", "right"):
    for kind, name in ((Image, "image_raw"), (CameraInfo, "camera_info"), (ExposureInfo, "exposure")):
        hear(kind, f"/rig/{camera}/{name}")
while len(counts) < 6:
    rclpy.spin_once(node, timeout_sec=0.1)
print("hears all", flush=True)
try:
    rclpy.spin(node)
except KeyboardInterrupt:
    pass
"""


def build() -> None:
    """Build both packages, and lay out the client."""
    if not (ROS / "bin/colcon").exists():
        raise SystemExit("no ROS 2 in build/ros2: `make test-ros2` installs it")
    stage("autoexpose-client", CLIENT)
    source = WORKSPACE / "src"
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    for package in (*(REPOSITORY / "ros").iterdir(), Path(__file__).with_name("ros2") / "tf2_msgs"):
        shutil.copytree(package, source / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    built = subprocess.run(
        ["colcon", "build"], cwd=WORKSPACE, env=ENVIRONMENT, text=True, capture_output=True, check=False
    )
    if built.returncode:
        raise SystemExit(built.stdout + built.stderr)


@contextlib.contextmanager
def in_ros(*command: Any, **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """A program of ROS 2, after `source install/setup.bash`."""
    script = f'source {WORKSPACE}/install/setup.bash && export PYTHONPATH={CLIENT}:$PYTHONPATH && exec "$@"'
    process = subprocess.Popen(
        ["bash", "-c", script, "ros", *map(str, command)], env=ENVIRONMENT, text=True, start_new_session=True, **streams
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(10)
        process.kill()
        if process.stdout is not None:
            process.stdout.close()


def cpu_s(process: subprocess.Popen[Any]) -> float:
    return sum(psutil.Process(process.pid).cpu_times()[:2])


class Visit:
    """What the foreign program and our own client have received of a demo."""

    def __init__(self, seconds: float, folder: Path) -> None:
        self.said: list[str] = []
        self.failed = True
        self.core_share = 0.0
        self.sums: dict[str, dict[int, int]] = {"left": {}, "right": {}}
        self._ours: dict[str, dict[int, int]] = {"left": {}, "right": {}}
        self._heard = queue.SimpleQueue[bytes]()
        file = folder / "sums.json"
        options = ["--ros-args", "-p", "reliability:=reliable", "-p", "depth:=100", "-p", "compressed:=true"]
        demo = [*AUTOEXPOSE, "demo", "--publish", "--rate-hz", str(RATE_HZ), "--seconds", str(seconds + 90)]
        with contextlib.ExitStack() as running:
            quiet = subprocess.DEVNULL
            showing = subprocess.Popen(demo, stdout=quiet)
            running.callback(showing.wait, 20)
            running.callback(showing.send_signal, signal.SIGINT)
            ours = running.enter_context(StereoClient())
            if ours.next_pair(PATIENCE_S) is None:
                raise SystemExit("the demo shows nothing: it says why above")
            threading.Thread(target=self._follow, args=(ours,), daemon=True).start()
            self._node = running.enter_context(in_ros(NODE, *options))
            self._bytes = running.enter_context(MessageClient())
            self._bytes.subscribe("imu", self._heard.put)
            self._statuses: dict[str, Any] = {}
            self._bytes.subscribe("status", lambda data: self._statuses.update(json.loads(data)))
            foreign = running.enter_context(in_ros("python", FOREIGN, seconds, file, stdout=subprocess.PIPE))
            assert foreign.stdout is not None
            self._attend(foreign.stdout)
            self.failed = foreign.wait(20) != 0
        if file.exists():
            told = json.loads(file.read_text())
            self.sums = {camera: {int(stamp): sum_ for stamp, sum_ in sums.items()} for camera, sums in told.items()}

    def compare(self) -> tuple[int, int, int]:
        """Images received and the same, those sent meanwhile, and those that differ."""
        same = sent = different = 0
        for camera, sums in self.sums.items():
            if sums:
                first, last = min(sums), max(sums)
                meanwhile = {stamp: sum_ for stamp, sum_ in self._ours[camera].items() if first <= stamp <= last}
                sent += len(meanwhile)
                same += sum(sums.get(stamp) == sum_ for stamp, sum_ in meanwhile.items())
                different += sum(stamp in sums and sums[stamp] != sum_ for stamp, sum_ in meanwhile.items())
        return same, sent, different

    def _follow(self, ours: StereoClient) -> None:
        for pair in ours:
            for camera, frame in (("left", pair.left), ("right", pair.right)):
                if frame is not None:
                    self._ours[camera][pair.stamp_ns] = zlib.crc32(frame.pixels.tobytes())

    def _attend(self, lines: IO[str]) -> None:
        """Do what the program asks for."""
        used_s = began_s = 0.0
        for line in lines:
            print(line, end="", flush=True)
            self.said.append(line.strip())
            match line.strip().removeprefix("please: "):
                case "measure":
                    used_s, began_s = cpu_s(self._node), time.monotonic()
                case "measured":
                    self.core_share = (cpu_s(self._node) - used_s) / (time.monotonic() - began_s)
                case "ev 0.5":
                    with ControlClient(name="others") as control:
                        control.ev(0.5)
                case "have the imu, light_ahead and tracking arrived?":
                    self._look_at_inputs()

    def _look_at_inputs(self) -> None:
        fine = read_angular_rate(self._heard.get(timeout=10)) == 0.25
        self.said.append(f"{'ok' if fine else 'missing'}: the IMU's message has arrived as it was")
        end_s = time.monotonic() + 10
        while not (arrived := self._arrived()) and time.monotonic() < end_s:
            time.sleep(0.1)
        self.said.append(f"{'ok' if arrived else 'missing'}: the daemon has heard of light ahead and tracking")
        print(*self.said[-2:], sep="\n", flush=True)

    def _arrived(self) -> bool:
        light, tracking = self._statuses.get("light_ahead"), self._statuses.get("tracking")
        return bool(
            light and light["messages"] and tracking and tracking["reports"] + sum(tracking["refused"].values())
        )


def core_share() -> float:
    """What the node uses of a core for two images of 720x540 at 60 Hz, with their camera infos and exposures."""
    at = endpoint()
    node = (NODE, "--ros-args", "-p", "autostart:=true", "-p", f"connect:={at}")
    with (
        publishing(PublishConfig(listen=(at,)), 1 / FAST_HZ, tell=_status),
        in_ros(*node) as process,
        in_ros("python", "-c", LISTEN, stdout=subprocess.PIPE) as listener,
    ):
        assert listener.stdout is not None
        assert listener.stdout.readline().strip() == "hears all"
        used_s, began_s = cpu_s(process), time.monotonic()
        time.sleep(MEASURED_S)
        return (cpu_s(process) - used_s) / (time.monotonic() - began_s)


def _status(_last: bool) -> dict[str, str]:
    camera = {"camera": "made up", "applied": None, "misfit": None}
    requests = {"locked": None, "ev_stops": 0.0, "taken": 0, "bounds": None}
    told = {"version": 1, "rig": "rig", "state": "exposing", "reasons": [], "policy": "belief", "requests": requests}
    told |= {"cameras": {"left": camera, "right": camera}, "rate_hz": FAST_HZ, "counts": {}, "lost": {}}
    return {"autoexpose/rig/status": json.dumps(told)}


def main() -> int:
    """Build, visit, measure; 0 if nothing is missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    build()
    with tempfile.TemporaryDirectory() as folder:
        visit = Visit(seconds, Path(folder))
    same, sent, different = visit.compare()
    share, step_ms = core_share(), reference_step_ms(50)
    print(f"{share:.1%} of a core for two images of 720x540 at {FAST_HZ:g} Hz, literal step {step_ms:.1f} ms")
    missing = [line for line in visit.said if line.startswith("missing: ")]
    checks = sum(line.startswith("ok: ") for line in visit.said)
    print(
        f"ros2: {same} images received of {sent} sent, {different} differ, {checks} checks, "
        f"missing: {len(missing) or 'none'}; {visit.core_share:.1%} of a core at {RATE_HZ} Hz"
    )
    for line in missing:
        print(line)
    return int(visit.failed or bool(missing) or same != sent or different > 0 or same < 1000)


if __name__ == "__main__":
    sys.exit(main())
