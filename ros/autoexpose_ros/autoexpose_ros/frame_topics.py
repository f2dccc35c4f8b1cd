"""The topics of the cameras: the daemon's messages go out as they came, on threads that wait for nothing else."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from autoexpose_client import MessageClient
from autoexpose_msgs.msg import ExposureInfo
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from autoexpose_ros.jpeg import Compression, JpegThread

TOPICS = {
    "image": ("image_raw", Image),
    "camera_info": ("camera_info", CameraInfo),
    "exposure": ("exposure", ExposureInfo),
}
"""For each camera: the last part of the daemon's key, and the topic's name and type."""


class _Outlet:
    """A topic to publish on, on any thread. At a signal rclpy takes topics away while messages still arrive."""

    def __init__(self, node: Node, kind: Any, name: str, qos: QoSProfile) -> None:
        self.publisher = node.create_publisher(kind, name, qos)
        self._context = node.context

    def is_heard(self) -> bool:
        try:
            return bool(self.publisher.get_subscription_count())
        except Exception:
            if self._context.ok():
                raise
            return False

    def publish(self, cdr: bytes) -> None:
        try:
            self.publisher.publish(cdr)
        except Exception:
            if self._context.ok():
                raise


@dataclass
class _Topic:
    """A topic of a camera, and what else is made of its messages."""

    outlet: _Outlet
    compressed: _Outlet | None = None
    jpeg: JpegThread | None = None

    def take(self, cdr: bytes) -> None:
        """Publish a message; called on the thread of its key."""
        if self.compressed is None or self.jpeg is None:
            self.outlet.publish(cdr)
            return
        if self.outlet.is_heard():
            self.outlet.publish(cdr)
        self.jpeg.offer(cdr)

    def is_heard(self) -> bool:
        return self.outlet.is_heard() or (self.compressed is not None and self.compressed.is_heard())


class FrameTopics:
    """Publishes what the cameras send while it is active; all methods are called on the executor's thread.

    Only what somebody hears is fetched from the daemon, which makes no messages that nobody fetches.
    """

    def __init__(self, node: Node, client: MessageClient, qos: QoSProfile, compression: Compression | None) -> None:
        self.active = False
        self._node, self._client, self._qos, self._compression = node, client, qos, compression
        self._topics: dict[str, _Topic] = {}
        self._fetched: set[str] = set()

    def offer(self, cameras: Iterable[str]) -> None:
        """Have topics for these cameras; those of earlier ones stay."""
        for camera in cameras:
            for part, (name, kind) in TOPICS.items():
                if f"{camera}/{part}" not in self._topics:
                    outlet = _Outlet(self._node, kind, f"~/{camera}/{name}", self._qos)
                    self._topics[f"{camera}/{part}"] = topic = _Topic(outlet)
                    if part == "image" and self._compression is not None:
                        self._compress(topic, camera, self._compression)

    def tend(self) -> None:
        """Fetch what is heard, and no longer what is not; to be called some times a second."""
        for key, topic in self._topics.items():
            wanted = self.active and topic.is_heard()
            if wanted and key not in self._fetched:
                self._fetched.add(key)
                self._client.subscribe(key, topic.take)
            elif not wanted and key in self._fetched:
                self._fetched.remove(key)
                self._client.unsubscribe(key)

    def close(self) -> None:
        """Take the topics back; the client must have been closed."""
        for topic in self._topics.values():
            if topic.jpeg is not None:
                topic.jpeg.close()
            for outlet in filter(None, (topic.outlet, topic.compressed)):
                self._node.destroy_publisher(outlet.publisher)
        self._topics.clear()

    def _compress(self, topic: _Topic, camera: str, compression: Compression) -> None:
        log = self._node.get_logger()

        def complain(why: str) -> None:
            log.warning(f"{camera}: {why}", throttle_duration_sec=60.0)

        topic.compressed = _Outlet(self._node, CompressedImage, f"~/{camera}/image_raw/compressed", self._qos)
        topic.jpeg = JpegThread(compression, topic.compressed.publish, topic.compressed.is_heard, complain)
