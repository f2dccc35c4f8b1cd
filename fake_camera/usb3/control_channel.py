"""The control channel: takes commands from one endpoint and acknowledges them on another."""

from __future__ import annotations

import threading

from fake_camera.device.faults import Fault, Faults
from fake_camera.genicam.registers import RegisterMap
from fake_camera.genicam.status import CommandError, Status
from fake_camera.usb3 import u3vcp
from fake_camera.usb3.u3vcp import Command, Request
from fake_camera.usb3.usb.endpoint import InEndpoint

_PENDING_MS = 500
_PENDING_ANSWER_S = 0.1


class ControlChannel:
    """Executes commands; thread-safe."""

    def __init__(self, registers: RegisterMap, acknowledgements: InEndpoint, faults: Faults) -> None:
        self._registers = registers
        self._acknowledgements = acknowledgements
        self._faults = faults
        self._lock = threading.Lock()
        self._session = 0

    def reset(self) -> None:
        """The bus was reset: commands in progress are acknowledged to nobody."""
        self._session += 1

    def take(self, transfer: bytes) -> bool:
        """Execute the command in a transfer and acknowledge it; False when the camera does not take it (NAK)."""
        if self._faults.spoils_command(Fault.NAK):
            return False
        request = Request.from_bytes(transfer)
        if request is None:
            return True
        if self._faults.spoils_command(Fault.PENDING_ACKNOWLEDGE):
            self._acknowledgements.write(request.pending(_PENDING_MS))
            later = threading.Timer(_PENDING_ANSWER_S, self._answer, (request, self._session))
            later.daemon = True
            later.start()
        else:
            self._answer(request, self._session)
        return True

    def _answer(self, request: Request, session: int) -> None:
        with self._lock:
            try:
                answer = request.acknowledge(self._execute(request))
            except CommandError as error:
                answer = request.acknowledge(error.payload, error.status)
            if request.ack_required and session == self._session:
                self._acknowledgements.write(answer)

    def _execute(self, request: Request) -> bytes:
        match request.command:
            case Command.READMEM:
                return self._registers.read(*u3vcp.memory_range(request.payload))
            case Command.WRITEMEM:
                address, data = u3vcp.memory_write(request.payload)
                self._registers.write(address, data)
                return u3vcp.write_acknowledgement(len(data))
            case _:
                raise CommandError(Status.NOT_IMPLEMENTED)
