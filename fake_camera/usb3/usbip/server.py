"""A device behind USB/IP: the sockets that it listens on, and its connections."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from fake_camera.device.device import Device
from fake_camera.device.unix_socket import listen
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.usb3.usb_device import UsbDevice
from fake_camera.usb3.usbip.connection import Claims, Connection


class Usb3Server:
    """Serves one device on a Unix socket, and on a TCP port if given; with `xml` as that describes it.

    While the camera is unplugged nothing listens, so that a connection means a plugged-in camera.
    """

    def __init__(self, device: Device, path: Path, tcp_port: int | None = None, xml: XmlCamera | None = None) -> None:
        """Listen; OSError when the path or the port cannot be used."""
        self._usb = UsbDevice(device, xml)
        self._claims = Claims(self._usb.released)
        self._sockets: list[Callable[[], socket.socket]] = [lambda: listen(path, "socket")]
        if tcp_port is not None:
            self._sockets.append(lambda: _listen_tcp(tcp_port))
        self._path = path
        self._lock = threading.Lock()
        self._listeners: list[socket.socket] = []
        self._connections: set[Connection] = set()
        try:
            self._plug()
        except OSError:
            self._unplug()
            raise
        device.on_power_off(self._unplug)
        device.on_power_on(self._power_on)

    def close(self) -> None:
        """Stop listening for good, hang up, and remove the socket file."""
        self._sockets.clear()
        self._unplug()

    def _power_on(self) -> None:
        """The camera restarts: the host sees it go and come back."""
        self._unplug()
        self._usb.reset()
        try:
            self._plug()
        except OSError as error:  # another process has taken the path or the port meanwhile
            self._unplug()
            print(f"the camera stays unplugged: {error}", file=sys.stderr, flush=True)

    def _plug(self) -> None:
        with self._lock:
            for open_socket in self._sockets:
                listener = open_socket()
                self._listeners.append(listener)
                threading.Thread(target=self._accept, args=(listener,), name="usbip", daemon=True).start()

    def _unplug(self) -> None:
        with self._lock:
            for listener in self._listeners:
                with contextlib.suppress(OSError):
                    listener.shutdown(socket.SHUT_RDWR)
                listener.close()
            if self._listeners:
                self._path.unlink(missing_ok=True)
            self._listeners.clear()
            connections, self._connections = self._connections, set()
        for connection in connections:
            connection.hang_up()
        self._claims.forget()

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):  # the camera was unplugged
            while True:
                stream, _ = listener.accept()
                connection = Connection(stream, self._usb, self._claims)
                with self._lock:
                    if listener not in self._listeners:
                        stream.close()
                        return
                    self._connections.add(connection)
                threading.Thread(target=self._serve, args=(connection,), name="usbip", daemon=True).start()

    def _serve(self, connection: Connection) -> None:
        connection.serve()
        with self._lock:
            self._connections.discard(connection)


def _listen_tcp(port: int) -> socket.socket:
    try:
        return socket.create_server(("127.0.0.1", port))
    except OSError as error:
        raise OSError(f"TCP port {port} cannot be opened: {error.strerror or error}") from error
