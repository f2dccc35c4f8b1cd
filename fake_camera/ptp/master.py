"""A PTP master: announces a clock, and sends its time; without sockets or clock of its own."""

from __future__ import annotations

from collections.abc import Callable

from fake_camera.ptp.messages import Grandmaster, Message, MessageType, PortIdentity

LOG_SYNC_INTERVAL = -3
LOG_ANNOUNCE_INTERVAL = -1
"""Binary logarithms of seconds: eight Sync and two Announce a second. Announce is never more frequent than Sync."""
_NS_PER_S = 1_000_000_000
_SEQUENCE_IDS = 1 << 16


class Master:
    """The only master there is: it listens to no other. Not thread-safe.

    `time_ns` gives its time at a time of the host (CLOCK_MONOTONIC, ns). Sync takes two steps: the time at which it
    left follows.
    """

    def __init__(
        self,
        identity: PortIdentity,
        time_ns: Callable[[int], int],
        log_sync_interval: int = LOG_SYNC_INTERVAL,
        domain: int = 0,
    ) -> None:
        self.identity = identity
        self._time_ns = time_ns
        self._domain = domain
        log_announce_interval = max(LOG_ANNOUNCE_INTERVAL, log_sync_interval)
        self._intervals = {MessageType.SYNC: log_sync_interval, MessageType.ANNOUNCE: log_announce_interval}
        self._sequence_ids = dict.fromkeys(self._intervals, 0)
        self._due_ns: dict[MessageType, int] = {}
        self._outbox: list[Message] = []

    def poll(self, host_ns: int) -> list[Message]:
        """Let time pass; returns what is to be sent now."""
        for kind, log_interval in self._intervals.items():
            if host_ns < self._due_ns.get(kind, host_ns):
                continue
            self._due_ns[kind] = host_ns + round(2.0**log_interval * _NS_PER_S)
            sequence_id = self._sequence_ids[kind]
            self._sequence_ids[kind] = (sequence_id + 1) % _SEQUENCE_IDS
            grandmaster = Grandmaster(self.identity.clock) if kind is MessageType.ANNOUNCE else None
            self._send(kind, sequence_id, log_interval=log_interval, grandmaster=grandmaster)
        sent, self._outbox = self._outbox, []
        return sent

    def receive(self, message: Message, host_ns: int) -> None:
        """Take a message that arrived at `host_ns`; a Delay_Req is answered with that time."""
        if message.type is MessageType.DELAY_REQ and message.domain == self._domain:
            self._send(
                MessageType.DELAY_RESP,
                message.sequence_id,
                self._time_ns(host_ns),
                log_interval=self._intervals[MessageType.SYNC],
                requester=message.source,
                correction=message.correction,
            )

    def sent(self, message: Message, host_ns: int) -> None:
        """A Sync left at `host_ns`: tell it."""
        self._send(
            MessageType.FOLLOW_UP,
            message.sequence_id,
            self._time_ns(host_ns),
            log_interval=message.log_interval,
        )

    def _send(
        self,
        kind: MessageType,
        sequence_id: int,
        time_ns: int = 0,
        *,
        log_interval: int,
        requester: PortIdentity | None = None,
        grandmaster: Grandmaster | None = None,
        correction: int = 0,
    ) -> None:
        self._outbox.append(
            Message(
                kind,
                self.identity,
                sequence_id,
                time_ns,
                self._domain,
                kind is MessageType.SYNC,
                correction,
                log_interval,
                requester,
                grandmaster,
            )
        )
