"""The control channel: answers GVCP commands, as far as the client's privilege allows."""

from __future__ import annotations

import threading
from collections.abc import Callable

from fake_camera.genicam.privilege import POWER_ON_HEARTBEAT_MS, ControlPrivilege, Peer
from fake_camera.genicam.registers import RegisterMap
from fake_camera.genicam.status import CommandError, Status
from fake_camera.gige import gvcp
from fake_camera.gige.bootstrap import CONTROL_PRIVILEGE
from fake_camera.gige.gvcp import Action, Command, Request, Resend

_ONCE = (Command.WRITEREG, Command.WRITEMEM, Command.ACTION)


class ControlChannel:
    """Executes commands; thread-safe.

    `resend` sends stream packets again; `released` is called when control has been returned or lost. `act` carries out
    action commands, or returns None for those that are not for this camera; without it the camera does not know them.
    """

    def __init__(
        self,
        registers: RegisterMap,
        privilege: ControlPrivilege,
        resend: Callable[[Resend], None],
        released: Callable[[], None],
        act: Callable[[Action], Status | None] | None = None,
    ) -> None:
        self._registers = registers
        self._privilege = privilege
        self._resend = resend
        self._released = released
        self._act = act
        self._lock = threading.RLock()
        self._last: dict[bool, tuple[Peer, bytes, bytes | None]] = {}  # the last write (False) and action (True)

    def answer(self, datagram: bytes, peer: Peer, now_s: float) -> bytes | None:
        """Execute the command in a datagram and return the acknowledgement.

        None when there is none: the datagram is not a command, or one that asks for no acknowledgement.
        """
        request = Request.from_bytes(datagram)
        if request is None or request.command == Command.FORCEIP:
            return None
        with self._lock:
            self.expire(now_s)
            self._privilege.hear(peer, now_s)
            # A client that missed an answer repeats the request with the same id; a write or an action must not happen
            # twice. Actions come from others, too, and between a write and its repetition.
            is_action = request.command == Command.ACTION
            last = self._last.get(is_action)
            if last is not None and last[:2] == (peer, datagram):
                return last[2]
            answer = self._answer(request, peer, now_s)
            if request.command in _ONCE:
                self._last[is_action] = (peer, datagram, answer)
        return answer

    def expire(self, now_s: float) -> None:
        """Take control away from a client that has been silent for the heartbeat timeout."""
        with self._lock:
            if self._privilege.expired(now_s):
                self.reset()

    def reset(self) -> None:
        """Back to the power-on state, without a client."""
        with self._lock:
            self._last.clear()
            self._privilege.drop()
            self._privilege.heartbeat_ms = POWER_ON_HEARTBEAT_MS
            self._released()

    def _answer(self, request: Request, peer: Peer, now_s: float) -> bytes | None:
        """Execute a request; returns its acknowledgement, None where there is none."""
        try:
            if request.command == Command.ACTION and self._act is not None:
                status = self._act(Action.from_request(request))
                answer = None if status is None else request.acknowledge(b"", status)
            else:
                answer = request.acknowledge(self._execute(request, peer, now_s))
        except CommandError as error:
            answer = request.acknowledge(error.payload, error.status)
        silent = request.command == Command.PACKETRESEND or not request.ack_required
        return None if silent else answer

    def _execute(self, request: Request, peer: Peer, now_s: float) -> bytes:
        """Execute a request; returns the payload of its acknowledgement."""
        payload = b""
        match request.command:
            case Command.DISCOVERY:
                payload = self._registers.read(0, gvcp.DISCOVERY_BYTES)
            case Command.READREG:
                payload = self._read_registers(gvcp.register_addresses(request.payload), peer)
            case Command.WRITEREG:
                payload = self._write_registers(gvcp.register_writes(request.payload), peer, now_s)
            case Command.READMEM:
                address, count = gvcp.memory_range(request.payload)
                self._privilege.check_read(peer)
                payload = request.payload[:4] + self._registers.read(address, count)
            case Command.WRITEMEM:
                payload = self._write_memory(*gvcp.memory_write(request.payload), peer, now_s)
            case Command.PACKETRESEND:
                self._send_again(Resend.from_payload(request.payload), peer)
            case _:
                raise CommandError(Status.NOT_IMPLEMENTED)
        return payload

    def _read_registers(self, addresses: list[int], peer: Peer) -> bytes:
        values = b""
        try:
            for address in addresses:
                if address != CONTROL_PRIVILEGE:  # anyone may see whether the camera is under control
                    self._privilege.check_read(peer)
                values += self._registers.read(address, 4)
        except CommandError as error:
            raise CommandError(error.status, values) from error
        return values

    def _write_registers(self, writes: list[tuple[int, bytes]], peer: Peer, now_s: float) -> bytes:
        written = 0
        try:
            for address, value in writes:
                self._write(address, value, peer, now_s)
                written += 1
        except CommandError as error:
            raise CommandError(error.status, gvcp.write_acknowledgement(written)) from error
        return gvcp.write_acknowledgement(written)

    def _write_memory(self, address: int, data: bytes, peer: Peer, now_s: float) -> bytes:
        try:
            self._write(address, data, peer, now_s)
        except CommandError as error:
            raise CommandError(error.status, gvcp.write_acknowledgement(0)) from error
        return gvcp.write_acknowledgement(len(data))

    def _write(self, address: int, data: bytes, peer: Peer, now_s: float) -> None:
        if address == CONTROL_PRIVILEGE and len(data) == 4:
            had_control = self._privilege.holder == peer
            self._privilege.request(peer, int.from_bytes(data, "big"), now_s)
            if had_control and self._privilege.holder is None:
                self._released()
            return
        self._privilege.check_write(peer)
        self._registers.write(address, data)

    def _send_again(self, request: Resend, peer: Peer) -> None:
        # The request may come from the client's stream socket, and so from another port than its commands.
        holder = self._privilege.holder
        if holder is not None and holder[0] == peer[0] and request.channel == 0:
            self._resend(request)
