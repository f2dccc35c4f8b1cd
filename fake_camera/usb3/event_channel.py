"""The event channel: messages that the camera sends unasked; so far only the test event."""

from __future__ import annotations

from collections.abc import Callable

from fake_camera.usb3.u3vcp import event
from fake_camera.usb3.usb.endpoint import InEndpoint

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
        self._event_id = 0

    def test(self) -> None:
        """Send the test event."""
        if self.enabled:
            self._event_id = self._event_id % 0xFFFF + 1
            self._endpoint.write(event(_TEST_EVENT, self._event_id, self._clock_ns()))
