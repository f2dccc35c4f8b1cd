"""A program of ROS 2 that knows nothing of this project but its generated messages: what it finds in the node `/rig`.

    python foreign.py SECONDS FILE

It says on its standard output what it is doing, one line each: `ok: ...` or `missing: ...`, and `please: ...` where
somebody else is to do something. FILE gets the sums of all images, in JSON, and SECONDS are how long it listens.
"""

from __future__ import annotations

import json
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from autoexpose_msgs.msg import ExposureInfo, LightAhead, TrackedCells
from autoexpose_msgs.srv import Shot
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, Imu
from sensor_msgs.srv import SetCameraInfo
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

CAMERAS = ("left", "right")
PATIENCE_S = 30.0
FRAMES = QoSProfile(depth=200, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Visitor:
    """Looks at the node."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("visitor")
        self.missing = 0
        self.sums: dict[str, dict[int, int]] = {camera: {} for camera in CAMERAS}
        self.newest: dict[str, Any] = {}
        self.counts: dict[str, int] = {}

    def listen(self) -> None:
        for camera in CAMERAS:
            self._hear(Image, f"/rig/{camera}/image_raw", lambda cdr, camera=camera: self._sum(camera, cdr))
            self._hear(CameraInfo, f"/rig/{camera}/camera_info")
            self._hear(ExposureInfo, f"/rig/{camera}/exposure")
        self._hear(CompressedImage, "/rig/left/image_raw/compressed")
        self._hear(DiagnosticArray, "/diagnostics", qos=10)
        self._hear(TFMessage, "/tf_static", qos=LATCHED)

    def _hear(self, kind: Any, name: str, take: Callable[[bytes], None] | None = None, qos: Any = FRAMES) -> None:
        def heard(cdr: bytes) -> None:
            self.newest[name] = kind, cdr
            self.counts[name] = self.counts.get(name, 0) + 1
            if take is not None:
                take(cdr)

        self.node.create_subscription(kind, name, heard, qos, raw=True)

    def message(self, name: str) -> Any:
        if name not in self.newest:
            return None
        kind, cdr = self.newest[name]
        return deserialize_message(cdr, kind)

    def _sum(self, camera: str, cdr: bytes) -> None:
        image = deserialize_message(cdr, Image)
        stamp_ns = image.header.stamp.sec * 1_000_000_000 + image.header.stamp.nanosec
        self.sums[camera][stamp_ns] = zlib.crc32(image.data)

    def check(self, what: str, fine: object, found: object = "") -> None:
        self.missing += not fine
        print(f"ok: {what}" if fine else f"missing: {what}: {found}", flush=True)

    def until(self, condition: Callable[[], object], patience_s: float = PATIENCE_S) -> bool:
        end_s = time.monotonic() + patience_s
        while time.monotonic() < end_s:
            if condition():
                return True
            rclpy.spin_once(self.node, timeout_sec=0.1)
        return bool(condition())

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        """The response of a service of the node; None if there is none in time."""
        client = self.node.create_client(kind, name)
        try:
            if not self.until(client.service_is_ready):
                return None
            done = client.call_async(kind.Request(**fields))
            self.until(done.done)
            return done.result() if done.done() else None
        finally:
            self.node.destroy_client(client)

    def state(self) -> str:
        answer = self.call(GetState, "/rig/get_state")
        return "" if answer is None else answer.current_state.label

    def change(self, label: str) -> bool:
        request = ChangeState.Request()
        request.transition.label = label
        answer = self.call(ChangeState, "/rig/change_state", transition=request.transition)
        return answer is not None and answer.success

    def value(self, name: str) -> Any:
        answer = self.call(GetParameters, "/rig/get_parameters", names=[name])
        return None if not answer or not answer.values else rclpy.parameter.parameter_value_to_python(answer.values[0])

    def set(self, name: str, value: Any) -> Any:
        message = Parameter(name, value=value).to_parameter_msg()
        return self.call(SetParameters, "/rig/set_parameters", parameters=[message]).results[0]


def walk_up(visitor: Visitor) -> None:
    here = visitor.until(lambda: ("rig", "/") in visitor.node.get_node_names_and_namespaces())
    visitor.check("the node /rig", here, visitor.node.get_node_names())
    visitor.check("it is unconfigured", visitor.state() == "unconfigured", visitor.state())
    visitor.check("it configures", visitor.change("configure") and visitor.state() == "inactive", visitor.state())
    visitor.listen()
    visitor.until(lambda: "/tf_static" in visitor.newest)  # it has heard from the daemon
    visitor.until(lambda: False, 2.0)
    images = {camera: len(sums) for camera, sums in visitor.sums.items()}
    visitor.check("inactive, it publishes no images", not any(images.values()), images)
    visitor.check("it activates", visitor.change("activate") and visitor.state() == "active", visitor.state())
    visitor.check("images of every camera", visitor.until(lambda: all(visitor.sums.values())), visitor.counts)
    for camera in CAMERAS:
        for name in (f"/rig/{camera}/camera_info", f"/rig/{camera}/exposure"):
            visitor.check(name, visitor.until(lambda name=name: name in visitor.newest), visitor.counts)


def look_at_transforms(visitor: Visitor) -> None:
    def of(camera: str) -> Any:
        message = visitor.message("/tf_static")
        found = {} if message is None else {it.child_frame_id: it for it in message.transforms}
        return found.get(f"rig_{camera}_optical_frame")

    def stands() -> bool:
        right = of("right")
        turned, place = right.transform.rotation, right.transform.translation
        beside = right.header.frame_id == "rig_left_optical_frame" and abs(turned.w - 1.0) < 1e-6
        return beside and abs(place.x - 0.08) < 1e-6 and abs(place.y) + abs(place.z) < 1e-6

    left = of("left")
    good = left is not None and left.header.frame_id == "rig_left_link" and left.transform.rotation.x == -0.5
    visitor.check("/tf_static: from the link to the left camera", good, left)
    visitor.check("/tf_static: a baseline of 80 mm to the right camera", visitor.until(stands), of("right"))


def look_at_diagnostics(visitor: Visitor) -> None:
    visitor.until(lambda: "/diagnostics" in visitor.newest)
    message = visitor.message("/diagnostics")
    names = [] if message is None else [status.name for status in message.status]
    visitor.check(
        "/diagnostics of rig and cameras", names == ["rig: exposure", "rig: left camera", "rig: right camera"], names
    )
    values = {} if len(names) < 2 else {value.key: value.value for value in message.status[1].values}
    visitor.check("the temperature in /diagnostics", values.get("temperature degrees C") == "46.0", values)


def set_parameters(visitor: Visitor) -> None:
    wanted = [
        "ev",
        "lock",
        "policy",
        "min_time_us",
        "max_time_us",
        "min_gain_db",
        "max_gain_db",
        "left.region",
        "right.region",
    ]
    answer = visitor.call(ListParameters, "/rig/list_parameters")
    visitor.check("parameters of control", {*wanted} <= {*answer.result.names}, answer.result.names)
    (described,) = visitor.call(DescribeParameters, "/rig/describe_parameters", names=["ev"]).descriptors
    ranges = [(it.from_value, it.to_value) for it in described.floating_point_range]
    visitor.check("ev has a range and words", ranges == [(-3.0, 3.0)] and "stops" in described.description, described)
    for name, value in (
        ("ev", -1.0),
        ("max_time_us", 4000.0),
        ("policy", "neves2009"),
        ("lock", True),
        ("lock", False),
    ):
        result = visitor.set(name, value)
        visitor.check(f"{name} {value} is taken", result.successful and visitor.value(name) == value, result.reason)
    result = visitor.set("left.region", "0,0,720,270")
    visitor.check(
        "a region is taken", result.successful and visitor.value("left.region") == "0,0,720,270", result.reason
    )
    for name, value, word in (
        ("ev", 9.0, ""),
        ("policy", "no-such", "choose one of"),
        ("max_time_us", 1e6, "us"),
        ("left.region", "1,2", "rectangle"),
    ):
        result, before = visitor.set(name, value), visitor.value(name)
        refused = not result.successful and word in result.reason and before != value
        visitor.check(f"{name} {value} is refused with a sentence", refused, result)
    for name, value in (("policy", "belief"), ("max_time_us", 7500.0), ("ev", 0.0), ("left.region", "")):
        visitor.check(f"{name} is set back", visitor.set(name, value).successful)
    print("please: ev 0.5", flush=True)
    visitor.check(
        "a change by others is followed", visitor.until(lambda: visitor.value("ev") == 0.5), visitor.value("ev")
    )
    visitor.set("ev", 0.0)


def call_services(visitor: Visitor) -> None:
    answer = visitor.call(Trigger, "/rig/lock")
    fine = answer is not None and answer.success and visitor.until(lambda: visitor.value("lock"))
    visitor.check("service lock, which the parameter follows", fine, answer)
    answer = visitor.call(Trigger, "/rig/unlock")
    fine = answer is not None and answer.success and visitor.until(lambda: visitor.value("lock") is False)
    visitor.check("service unlock", fine, answer)
    shot = visitor.call(Shot, "/rig/shot", exposure_time_us=500.0, gain_db=3.0)
    fine = shot is not None and shot.success and [*shot.cameras] == [*CAMERAS] and abs(shot.exposure_time_us - 500) < 1
    visitor.check("service shot", fine, shot)
    shot = visitor.call(Shot, "/rig/shot", exposure_time_us=1e9)
    visitor.check(
        "a shot out of bounds is refused", shot is not None and not shot.success and "us" in shot.message, shot
    )


def look_at_compressed(visitor: Visitor) -> None:
    name = "/rig/left/image_raw/compressed"
    visitor.until(lambda: visitor.counts.get(name, 0) >= 5)
    began_s, before = time.monotonic(), visitor.counts.get(name, 0)
    visitor.until(lambda: False, 4.0)
    rate_hz = (visitor.counts.get(name, 0) - before) / (time.monotonic() - began_s)
    visitor.check("five compressed images a second", 3.0 < rate_hz < 6.0, rate_hz)
    message = visitor.message(name)
    jpeg = message is not None and bytes(message.data[:2]) == b"\xff\xd8" and bytes(message.data[-2:]) == b"\xff\xd9"
    visitor.check("they are JPEG", jpeg and message.header.frame_id == "rig_left_optical_frame", message)


def camera_info(focal_px: float, baseline_m: float = 0.0) -> CameraInfo:
    unturned = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    info = CameraInfo(width=720, height=540, distortion_model="plumb_bob", d=[0.01, 0.0, 0.0, 0.0, 0.0], r=unturned)
    info.k = [focal_px, 0.0, 359.5, 0.0, focal_px, 269.5, 0.0, 0.0, 1.0]
    shift = -focal_px * baseline_m
    info.p = [focal_px, 0.0, 359.5, shift, 0.0, focal_px, 269.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    return info


def calibrate(visitor: Visitor) -> None:
    """As camera_calibration does: the left camera first, then the right one."""
    for camera, info in (("left", camera_info(861.5)), ("right", camera_info(861.5, 0.08))):
        name = f"/rig/{camera}/camera_info"
        answer = visitor.call(SetCameraInfo, f"/rig/{camera}/set_camera_info", camera_info=info)
        visitor.check(f"set_camera_info of {camera}", answer is not None and answer.success, answer)

        def arrives(name: str = name, info: CameraInfo = info) -> bool:
            came = visitor.message(name)
            return all([*getattr(came, each)] == [*getattr(info, each)] for each in ("d", "k", "r", "p"))

        visitor.check(f"{name} is the one that was set", visitor.until(arrives), visitor.message(name))
    for info, word in ((camera_info(5.0), "focal"), (CameraInfo(width=640, height=480), "distortion_model")):
        answer = visitor.call(SetCameraInfo, "/rig/left/set_camera_info", camera_info=info)
        refused = answer is not None and not answer.success and word in answer.status_message
        visitor.check("a wrong one is refused with a sentence", refused, answer)


def send(visitor: Visitor) -> None:
    """What the robot has to say."""
    stamp = visitor.message("/rig/left/image_raw").header.stamp
    imu, light = Imu(), LightAhead(levels=[1.0, 2.0], risen=[0.0, 0.0], now=0, step_s=0.1, spread_s=0.2)
    imu.header.frame_id, imu.angular_velocity.z = "imu_link", 0.25
    cells = TrackedCells(consumer="visitor", side="left", rows=6, columns=8, features=[9] * 48, inliers=[5] * 48)
    for name, message in (("imu", imu), ("light_ahead", light), ("tracked_cells", cells)):
        message.header.stamp = stamp
        publisher = visitor.node.create_publisher(type(message), f"/rig/{name}", 10)
        visitor.check(
            f"the node listens to {name}", visitor.until(lambda publisher=publisher: publisher.get_subscription_count())
        )
        for _ in range(10):  # the first may be lost before the other end knows the publisher
            publisher.publish(message)
            visitor.until(lambda: False, 0.1)
    print("please: have the imu, light_ahead and tracking arrived?", flush=True)


def walk_down(visitor: Visitor) -> None:
    visitor.check("it deactivates", visitor.change("deactivate") and visitor.state() == "inactive", visitor.state())
    visitor.until(lambda: False, 1.0)
    before = dict(visitor.counts)
    visitor.until(lambda: False, 1.0)
    still = [name for name, count in visitor.counts.items() if "image" in name and count != before[name]]
    visitor.check("it publishes no more", not still, still)
    visitor.check("it cleans up", visitor.change("cleanup") and visitor.state() == "unconfigured", visitor.state())
    topics = [name for name, _ in visitor.node.get_topic_names_and_types() if visitor.node.count_publishers(name)]
    visitor.check("its topics are gone", not any("image_raw" in name for name in topics), topics)


def main() -> int:
    seconds, file = float(sys.argv[1]), Path(sys.argv[2])
    rclpy.init()
    visitor = Visitor()
    walk_up(visitor)
    print("please: measure", flush=True)
    end_s = time.monotonic() + seconds
    looks = (
        look_at_diagnostics, look_at_compressed, calibrate, look_at_transforms, set_parameters, call_services, send,
    )  # fmt: skip
    for look in looks:
        try:
            look(visitor)
        except Exception as error:
            visitor.check(look.__name__, False, repr(error))
    visitor.until(lambda: time.monotonic() > end_s, seconds + 1.0)
    print("please: measured", flush=True)
    walk_down(visitor)
    file.write_text(json.dumps(visitor.sums))
    print(f"heard: {json.dumps(visitor.counts)}", flush=True)
    return int(visitor.missing > 0)


if __name__ == "__main__":
    sys.exit(main())
