"""The node: finds the daemon when it is configured, publishes while it is active."""

from __future__ import annotations

import sys
import time
import traceback
from collections import deque
from pathlib import Path
from typing import Any

import rclpy
from autoexpose_client import AutoexposeError, MessageClient
from autoexpose_msgs.msg import LightAhead, TrackedCells
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from sensor_msgs.msg import Imu
from tf2_msgs.msg import TFMessage

from autoexpose_ros.controls import Controls
from autoexpose_ros.diagnostics import entries
from autoexpose_ros.frame_topics import FrameTopics
from autoexpose_ros.jpeg import Compression
from autoexpose_ros.status import Status, read_status
from autoexpose_ros.transforms import Transform, transforms

_SILENT_S = 5.0
"""A daemon that has been silent this long counts as down; it sends its status once a second."""

_TEND_S = 0.25
_DIAGNOSE_S = 1.0

INPUTS = {"imu": (Imu, "imu"), "tracked_cells": (TrackedCells, "tracking"), "light_ahead": (LightAhead, "light_ahead")}
"""For each topic that the daemon hears of: its type, and the daemon's key."""

_RELIABILITY = {"best_effort": ReliabilityPolicy.BEST_EFFORT, "reliable": ReliabilityPolicy.RELIABLE}


class RigNode(LifecycleNode):
    """A rig of cameras. Parameters of the connection and of what is published are read when it is configured."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("rig", **kwargs)
        self._declare("rig", "", "`publish.rig` of the daemon's configuration; empty: the node's name")
        self._declare("connect", "", "zenoh endpoints of the daemon, with blanks between them; empty: this machine's")
        self._declare("zenoh_file", "", "a configuration file of zenoh instead, for TLS and the like")
        self._declare("autostart", False, "configure and activate at the start, without a lifecycle manager")
        self._declare("reliability", "best_effort", "of frames: best_effort, or reliable, which serves both kinds")
        self._declare("depth", 5, "how many messages of a topic wait to be sent", 1, 1000)
        self._declare("compressed", False, "offer image_raw/compressed, too: JPEG; needs OpenCV")
        self._declare("compressed_rate_hz", 5.0, "images compressed a second, at most, of each camera", 0.1, 100.0)
        self._declare("compressed_quality", 80, "of the JPEG", 1, 100)
        self._statuses: deque[Status] = deque(maxlen=1)
        self._news = self.create_guard_condition(self._take_status)
        self._inputs = MutuallyExclusiveCallbackGroup()
        self._open: list[Any] = []  # what ends with the configuration: pairs of who destroys, and what
        self._client: MessageClient | None = None
        self._frames: FrameTopics | None = None
        self._controls: Controls | None = None
        self._status: Status | None = None
        self._transforms: list[Transform] = []

    def start(self) -> bool:
        """Configure and activate; whether that went well."""
        success = TransitionCallbackReturn.SUCCESS
        return self.trigger_configure() == success and self.trigger_activate() == success

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin to look for the daemon, with topics and services that can be seen already."""
        try:
            self._configure()
        except (AutoexposeError, ValueError) as error:
            self.get_logger().error(str(error))
            self._unconfigure()
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self.get_logger().error(traceback.format_exc())  # rclpy would keep it to itself
            raise
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish what somebody hears."""
        self._activate(True)
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Publish no more."""
        self._activate(False)
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the daemon."""
        self._unconfigure()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let go of the daemon for good."""
        self._unconfigure()
        return super().on_shutdown(state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Begin again after an error of ours."""
        self._unconfigure()
        return TransitionCallbackReturn.SUCCESS

    def close(self) -> None:
        """Let go of the daemon; the node is not used any more."""
        self._unconfigure()
        self.destroy_node()

    def _configure(self) -> None:
        given = self._given
        reliability = _RELIABILITY.get(given("reliability"))
        if reliability is None:
            raise ValueError(f"reliability is {given('reliability')}: give one of {', '.join(_RELIABILITY)}")
        qos = QoSProfile(depth=given("depth"), reliability=reliability)
        compression = None
        if given("compressed"):
            compression = Compression(given("compressed_rate_hz"), given("compressed_quality"))
        where = {"connect": endpoints} if (endpoints := given("connect").split()) else {}
        file = Path(given("zenoh_file")) if given("zenoh_file") else None
        self._client = MessageClient(
            given("rig") or self.get_name(), zenoh_file=file, on_trouble=self._on_trouble, **where
        )
        self._heard_s = time.monotonic()
        self._frames = FrameTopics(self, self._client, qos, compression)
        self._controls = Controls(self, self._client)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._static = self.create_publisher(TFMessage, "/tf_static", latched)
        timers = [
            self.create_timer(_TEND_S, self._frames.tend),
            self.create_timer(_DIAGNOSE_S, self._look_after_daemon),
        ]
        subscriptions = [
            self.create_subscription(
                kind, f"~/{name}", self._passing_on(key), qos_profile_sensor_data, raw=True, callback_group=self._inputs
            )
            for name, (kind, key) in INPUTS.items()
        ]
        self._open = [(self.destroy_publisher, it) for it in (self._diagnostics, self._static)]
        self._open += [(self.destroy_timer, it) for it in timers]
        self._open += [(self.destroy_subscription, it) for it in subscriptions]
        self._client.subscribe("status", self._hear)
        self._client.__enter__()

    def _unconfigure(self) -> None:
        if self._client is not None:
            self._client.close()
        for part in filter(None, (self._frames, self._controls)):
            part.close()
        for destroy, entity in self._open:
            destroy(entity)
        self._client = self._frames = self._controls = self._status = None
        self._open, self._transforms = [], []
        self._statuses.clear()

    def _activate(self, active: bool) -> None:
        if self._frames is not None:
            self._frames.active = active
            self._frames.tend()

    def _on_trouble(self, trouble: str) -> None:
        """On zenoh's thread."""
        self.get_logger().info(f"no connection yet: {trouble}; trying again" if trouble else "connected")

    def _hear(self, data: bytes) -> None:
        """On the thread of the status."""
        status = read_status(data)
        if status is not None:
            self._statuses.append(status)
            self._news.trigger()

    def _take_status(self) -> None:
        if not self._statuses or self._frames is None or self._controls is None:
            return
        self._status, self._heard_s = self._statuses.pop(), time.monotonic()
        self._frames.offer(self._status.cameras)
        self._frames.tend()
        self._controls.follow(self._status)
        self._diagnose()
        found = list(transforms(self._status))
        if found != self._transforms:
            self._transforms = found
            self._static.publish(TFMessage(transforms=list(map(self._message, found))))

    def _look_after_daemon(self) -> None:
        if time.monotonic() - self._heard_s > _SILENT_S and self._controls is not None:
            self._status = None
            self._controls.follow(None)
            self._diagnose()

    def _diagnose(self) -> None:
        rig = self._given("rig") or self.get_name()
        told = [
            DiagnosticStatus(
                level=bytes([entry.level]),
                name=entry.name,
                message=entry.message,
                hardware_id=entry.hardware_id,
                values=[KeyValue(key=key, value=value) for key, value in entry.values.items()],
            )
            for entry in entries(rig, self._status)
        ]
        message = DiagnosticArray(status=told)
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _message(self, transform: Transform) -> TransformStamped:
        message = TransformStamped(child_frame_id=transform.child)
        message.header.frame_id, message.header.stamp = transform.parent, self.get_clock().now().to_msg()
        place, turned = message.transform.translation, message.transform.rotation
        place.x, place.y, place.z = transform.translation_m
        turned.x, turned.y, turned.z, turned.w = transform.rotation_xyzw
        return message

    def _passing_on(self, key: str) -> Any:
        def pass_on(cdr: bytes) -> None:
            if self._client is not None:
                self._client.send(key, bytes(cdr))

        return pass_on

    def _declare(self, name: str, value: Any, words: str, low: float | None = None, high: float | None = None) -> None:
        descriptor = ParameterDescriptor(description=words)
        if isinstance(value, int) and low is not None:
            descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
        elif low is not None:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
        self.declare_parameter(name, value, descriptor)

    def _given(self, name: str) -> Any:
        return self.get_parameter(name).value


def main() -> None:
    """Run the node until it is interrupted."""
    rclpy.init()
    node = RigNode()
    executor = MultiThreadedExecutor(3)  # one each for services, for what is passed on, and for the rest
    try:
        if node.get_parameter("autostart").value and not node.start():
            sys.exit(1)
        rclpy.spin(node, executor)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.close()
        rclpy.try_shutdown()
