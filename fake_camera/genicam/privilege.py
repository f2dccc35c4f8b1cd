"""Who may control the camera: the control channel privilege and its heartbeat."""

from __future__ import annotations

from fake_camera.genicam.status import CommandError, Status

Peer = tuple[str, int]
"""Address and UDP port of a client."""

_EXCLUSIVE = 0b01
_CONTROL = 0b10
_MIN_HEARTBEAT_MS = 500  # the minimum of the GigE Vision standard
POWER_ON_HEARTBEAT_MS = 3000


class ControlPrivilege:
    """The privilege of at most one client to write, lost after the heartbeat timeout without a sign of life.

    Times are in seconds on any monotonic clock.
    """

    def __init__(self) -> None:
        self.holder: Peer | None = None
        self.value = 0
        self._heard_s = 0.0
        self._heartbeat_ms = POWER_ON_HEARTBEAT_MS

    @property
    def heartbeat_ms(self) -> int:
        """Silence (ms) after which the holder loses the privilege."""
        return self._heartbeat_ms

    @heartbeat_ms.setter
    def heartbeat_ms(self, timeout_ms: int) -> None:
        if timeout_ms < _MIN_HEARTBEAT_MS:
            raise CommandError(Status.INVALID_PARAMETER)
        self._heartbeat_ms = timeout_ms

    def hear(self, peer: Peer, now_s: float) -> None:
        """Note a sign of life from a client."""
        if peer == self.holder:
            self._heard_s = now_s

    def expired(self, now_s: float) -> bool:
        """Whether the holder has been silent for too long."""
        return self.holder is not None and now_s - self._heard_s > self._heartbeat_ms / 1000

    def check_read(self, peer: Peer) -> None:
        """Raise CommandError ACCESS_DENIED when another client has exclusive access."""
        if self.value & _EXCLUSIVE and peer != self.holder:
            raise CommandError(Status.ACCESS_DENIED)

    def check_write(self, peer: Peer) -> None:
        """Raise CommandError ACCESS_DENIED unless this client has control."""
        if peer != self.holder:
            raise CommandError(Status.ACCESS_DENIED)

    def request(self, peer: Peer, value: int, now_s: float) -> None:
        """Take (exclusive, control) or return (0) the privilege.

        Raises CommandError: ACCESS_DENIED when another client holds it, INVALID_PARAMETER for an unsupported bit.
        """
        if self.holder not in (None, peer):
            raise CommandError(Status.ACCESS_DENIED)
        if value & ~(_EXCLUSIVE | _CONTROL):
            raise CommandError(Status.INVALID_PARAMETER)
        self.value = value
        self.holder = peer if value else None
        self._heard_s = now_s

    def drop(self) -> None:
        """Take the privilege away from its holder."""
        self.holder, self.value = None, 0
