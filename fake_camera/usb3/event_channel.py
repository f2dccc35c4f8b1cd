"""The event channel: messages that the camera sends unasked."""

from __future__ import annotations

from collections.abc import Callable

from fake_camera.genicam.events import EXPOSURE_END
from fake_camera.imaging import ExposedFrame
from fake_camera.usb3.u3vcp import event
from fake_camera.usb3.usb.endpoint import InEndpoint

MEMORY_BYTES = 4096
"""The camera's memory for events that the host has not fetched."""

_TEST_EVENT = 0x4FFF


class EventChannel:
    """Sends events to `endpoint` while it is enabled; `clock_ns` is the device's clock."""

    def __init__(self, endpoint: InEndpoint, clock_ns: Callable[[], int]) -> None:
        self._endpoint = endpoint
        self._clock_ns = clock_ns
        self.reset()

    def reset(self) -> None:
        """Back to the power-on state: no events."""
        self.enabled = False
        self._request_id = 0

    def test(self) -> None:
        """Send the test event."""
        self._send(_TEST_EVENT, self._clock_ns())

    def exposure_ended(self, frame: ExposedFrame) -> None:
        """Send the event of an exposure that has ended."""
        self._send(EXPOSURE_END, frame.exposure_end_ns, frame.frame_id.to_bytes(8, "little"))

    def _send(self, event_id: int, device_time_ns: int, data: bytes = b"") -> None:
        if self.enabled and self._endpoint.backlog_bytes < MEMORY_BYTES:  # a host that fetches none loses the newest
            self._request_id = self._request_id % 0xFFFF + 1
            self._endpoint.write(event(event_id, self._request_id, device_time_ns, data))
