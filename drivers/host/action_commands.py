"""Scheduled action commands: a GigE Vision camera acts when its clock shows a time. Aravis 0.8 sends none."""

from __future__ import annotations

import socket
import struct

from drivers.host.gvcp import PORT
from drivers.setup import ActionKeys

_COMMAND = struct.Struct(">BBHHHIIIQ")
_ACK = struct.Struct(">HHHH")
_KEY, _ACTION = 0x42, 0x0100
_SCHEDULED_ACK_REQUIRED = 0x81
_REQUEST_IDS = 0xFFFF  # 1 ... 65535: 0 is none
_STATUSES = {
    0x8013: "its clock was never set by a PTP master",
    0x8015: "it keeps no more of them",
    0x8016: "it came too late",
}


def action_command(keys: ActionKeys, device_time_ns: int, request_id: int) -> bytes:
    """A scheduled ACTION_CMD of GigE Vision 2.0, to act when the camera's clock shows `device_time_ns`."""
    payload_bytes = _COMMAND.size - 8
    return _COMMAND.pack(
        _KEY,
        _SCHEDULED_ACK_REQUIRED,
        _ACTION,
        payload_bytes,
        request_id,
        keys.device,
        keys.group,
        keys.mask,
        device_time_ns,
    )


def refusal(answer: bytes) -> str | None:
    """Why a camera did not take a command, in words; None if it did, or if the datagram is not such an answer."""
    if len(answer) < _ACK.size:
        return None
    status, answered, _, _ = _ACK.unpack_from(answer)
    if answered != _ACTION + 1 or not status:
        return None
    return _STATUSES.get(status, f"status 0x{status:04x}")


class ActionSender:
    """Sends scheduled action commands to one camera, without waiting for its answers.

    Raises
    ------
    OSError
        When the host has no route to the camera, or no socket to spare.
    """

    def __init__(self, camera_address: str, port: int = PORT) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((camera_address, port))
        except OSError:
            self._socket.close()
            raise
        self._sent = 0

    def send(self, keys: ActionKeys, device_time_ns: int) -> str | None:
        """Send one; returns why the camera refused an earlier one, each once. Raises OSError when it cannot be sent."""
        self._socket.send(action_command(keys, device_time_ns, self._sent % _REQUEST_IDS + 1))
        self._sent += 1
        while (answer := self._received()) is not None:
            if (why := refusal(answer)) is not None:
                return why  # others are read with the next commands
        return None

    def close(self) -> None:
        """Free the socket."""
        self._socket.close()

    def _received(self) -> bytes | None:
        try:
            return self._socket.recv(64)
        except OSError:  # nothing there, or the host reports that nobody listens
            return None
