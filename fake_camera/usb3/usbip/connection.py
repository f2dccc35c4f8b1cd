"""One connection of a USB/IP client: its pending transfers, and the interfaces it has claimed."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Callable

from fake_camera.usb3.usb.descriptors import INTERFACE_OF, INTERFACES
from fake_camera.usb3.usb.endpoint import InEndpoint, ReadRequest
from fake_camera.usb3.usb_device import Setup, StallError, UsbDevice
from fake_camera.usb3.usbip import messages

_LONGEST_TRANSFER_BYTES = 64 << 20


class Claims:
    """Which connection has claimed which interface; `released` is called for an interface that becomes free."""

    def __init__(self, released: Callable[[int], None]) -> None:
        self._released = released
        self._lock = threading.Lock()
        self._holders: dict[int, Connection] = {}

    def claim(self, holder: Connection, *interfaces: int) -> bool:
        """Claim all of these; if another connection holds one, claim none and return False."""
        with self._lock:
            if any(self._holders.get(interface, holder) is not holder for interface in interfaces):
                return False
            self._holders.update(dict.fromkeys(interfaces, holder))
            return True

    def release(self, holder: Connection, *interfaces: int) -> None:
        """Release those of `interfaces` that `holder` has claimed."""
        with self._lock:
            freed = [interface for interface in interfaces if self._holders.get(interface) is holder]
            for interface in freed:
                del self._holders[interface]
        for interface in freed:
            self._released(interface)

    def forget(self) -> None:
        """Drop all claims: the camera is unplugged."""
        with self._lock:
            self._holders.clear()


class Connection:
    """A client on a stream socket.

    On a Unix socket many clients may import the camera at once and claim its interfaces; a client on TCP is a Linux
    host, which takes the whole camera.
    """

    def __init__(self, stream: socket.socket, usb: UsbDevice, claims: Claims) -> None:
        self._socket = stream
        self._usb = usb
        self._claims = claims
        self._local = stream.family == socket.AF_UNIX
        self._hung_up = False
        self._sending = threading.Lock()
        self._pending: dict[int, tuple[InEndpoint | None, ReadRequest]] = {}

    def serve(self) -> None:
        """Answer until the client hangs up or violates the protocol."""
        with self._socket, contextlib.suppress(OSError, EOFError, messages.ProtocolError):
            if self._imported():
                while not self._hung_up:
                    self._answer(messages.parse(self._receive(messages.HEADER_BYTES)))
        for sequence in list(self._pending):
            self._cancel(sequence)
        self._claims.release(self, *INTERFACES)

    def hang_up(self) -> None:
        """Cut the connection; pending transfers are never answered."""
        self._hung_up = True
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def _imported(self) -> bool:
        """Answer the request before the transfers; whether transfers may follow."""
        _version, code, _status = messages.OPERATION.unpack(self._receive(messages.OPERATION.size))
        if code == messages.REQUEST_DEVICE_LIST:
            self._send(messages.device_list_reply())
            return False
        if code != messages.REQUEST_IMPORT:
            raise messages.ProtocolError(f"operation {code:#x}")
        bus_id = self._receive(messages.BUS_ID_BYTES).rstrip(b"\0").decode("ascii", "replace")
        accepted = bus_id == messages.BUS_ID and (self._local or self._claims.claim(self, *INTERFACES))
        if not self._local:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._send(messages.import_reply(accepted))
        return accepted

    def _answer(self, message: messages.Submit | messages.Unlink | messages.Claim) -> None:
        match message:
            case messages.Submit():
                if message.length > _LONGEST_TRANSFER_BYTES:
                    raise messages.ProtocolError(f"{message.length} bytes")
                if message.sequence in self._pending:
                    raise messages.ProtocolError(f"sequence number {message.sequence} twice")
                self._submit(message, self._receive(message.data_bytes))
            case messages.Unlink():
                cancelled = self._cancel(message.unlinked)
                self._send(messages.unlinked(message.sequence, -errno.ECONNRESET if cancelled else 0))
            case messages.Claim():
                self._claim(message)

    def _claim(self, message: messages.Claim) -> None:
        if not self._local:
            raise messages.ProtocolError("a claim over TCP")
        status = 0
        if not message.claims:
            self._claims.release(self, message.interface)
        elif message.interface not in INTERFACES:
            status = -errno.ENOENT
        elif not self._claims.claim(self, message.interface):
            status = -errno.EBUSY
        self._send(messages.claimed(message.sequence, status))

    def _submit(self, submit: messages.Submit, data: bytes) -> None:
        if submit.endpoint & 0x0F == 0:
            self._request(submit)
            return
        interface = INTERFACE_OF.get(submit.endpoint)
        if interface is None:
            self._complete(submit.sequence, -errno.ENOENT)
        elif not self._claims.claim(self, interface):  # as in Linux, using an interface claims it
            self._complete(submit.sequence, -errno.EBUSY)
        elif submit.endpoint & 0x80:
            self._read(submit)
        else:
            self._write(submit, data)

    def _request(self, submit: messages.Submit) -> None:
        setup = Setup.from_bytes(submit.setup)
        try:
            answer = self._usb.request(setup)
        except StallError:
            self._complete(submit.sequence, -errno.EPIPE)
            return
        self._complete(submit.sequence, 0, answer, 0 if setup.request_type & 0x80 else setup.length)

    def _read(self, submit: messages.Submit) -> None:
        def complete(status: int, data: memoryview) -> None:
            del self._pending[submit.sequence]
            self._complete(submit.sequence, status, data)

        endpoint = self._usb.endpoints[submit.endpoint]
        request = ReadRequest(submit.length, complete)
        self._pending[submit.sequence] = endpoint, request
        endpoint.submit(request)

    def _write(self, submit: messages.Submit, data: bytes) -> None:
        status = self._usb.write(data)
        if status is None:
            self._pending[submit.sequence] = None, ReadRequest(submit.length, lambda _status, _data: None)
        else:
            self._complete(submit.sequence, status, accepted_bytes=len(data) if status == 0 else 0)

    def _cancel(self, sequence: int) -> bool:
        """Cancel a transfer; False when it has been answered."""
        endpoint, request = self._pending.get(sequence, (None, None))
        if request is None or (endpoint is not None and not endpoint.cancel(request)):
            return False
        del self._pending[sequence]
        return True

    def _complete(self, sequence: int, status: int, data: bytes | memoryview = b"", accepted_bytes: int = 0) -> None:
        with contextlib.suppress(OSError):  # the client has gone; its own thread finds out
            self._send(messages.submitted(sequence, status, len(data) or accepted_bytes), data)

    def _send(self, header: bytes, data: bytes | memoryview = b"") -> None:
        with self._sending:
            sent = self._socket.sendmsg([header, data])
            rest = memoryview(header)[sent:], memoryview(data)[max(0, sent - len(header)) :]
            for part in rest:
                self._socket.sendall(part)

    def _receive(self, count: int) -> bytes:
        """Exactly `count` bytes; EOFError when the client hangs up before."""
        data = bytearray()
        while len(data) < count:
            part = self._socket.recv(count - len(data))
            if not part:
                raise EOFError
            data += part
        return bytes(data)
