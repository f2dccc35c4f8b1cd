"""A bulk IN endpoint, which matches the camera's transfers with the host's read requests."""

from __future__ import annotations

import errno
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from fake_camera.usb3.usb.descriptors import MAX_PACKET_BYTES

Complete = Callable[[int, memoryview], None]
"""Called with the result of a read: 0 or a negative errno as Linux has it for URBs, and the data."""

_NOTHING = memoryview(b"")


@dataclass(slots=True, eq=False)
class ReadRequest:
    """A transfer that the host asks for, of at most `length` bytes."""

    length: int
    complete: Complete


class InEndpoint:
    """One endpoint; safe to use from any thread.

    A transfer of the camera ends with a short packet, which also ends the read that it fills; one longer than the read
    continues in the next. `complete` is called under the endpoint's lock, so that data stay in order.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._requests: deque[ReadRequest] = deque()
        self._transfers: deque[memoryview] = deque()
        self._halted = False

    @property
    def halted(self) -> bool:
        """Whether the endpoint answers with a stall."""
        return self._halted

    @property
    def backlog_bytes(self) -> int:
        """Bytes that the camera has sent and the host has not fetched."""
        with self._lock:
            return sum(len(transfer) for transfer in self._transfers)

    def submit(self, request: ReadRequest) -> None:
        """The host asks for data."""
        with self._lock:
            if self._halted:
                request.complete(-errno.EPIPE, _NOTHING)
                return
            self._requests.append(request)
            self._match()

    def cancel(self, request: ReadRequest) -> bool:
        """Cancel a request of the host; False when it has been answered."""
        with self._lock:
            if request not in self._requests:
                return False
            self._requests.remove(request)
            return True

    def write(self, *transfers: bytes | memoryview) -> None:
        """Send transfers in order, with none in between; a halted endpoint discards them."""
        with self._lock:
            if not self._halted:
                self._transfers.extend(memoryview(transfer) for transfer in transfers)
                self._match()

    def flush(self) -> None:
        """Drop what the host has not fetched."""
        with self._lock:
            self._transfers.clear()

    def reset(self) -> None:
        """The camera is unplugged: drop all transfers and requests."""
        with self._lock:
            self._halted = False
            self._transfers.clear()
            self._requests.clear()

    def halt(self) -> None:
        """Stall until the host clears the halt; what has not been fetched is lost."""
        with self._lock:
            self._halted = True
            self._transfers.clear()
            while self._requests:
                self._requests.popleft().complete(-errno.EPIPE, _NOTHING)

    def clear_halt(self) -> None:
        """Answer again."""
        with self._lock:
            self._halted = False

    def _match(self) -> None:
        while self._requests and self._transfers:
            request, transfer = self._requests.popleft(), self._transfers.popleft()
            rest = transfer[request.length :]
            if rest:
                self._transfers.appendleft(rest)
            # A packet that does not fit into the rest of the host's buffer is babble to the host controller.
            babble = bool(rest) and request.length % MAX_PACKET_BYTES != 0
            request.complete(-errno.EOVERFLOW if babble else 0, transfer[: request.length])
