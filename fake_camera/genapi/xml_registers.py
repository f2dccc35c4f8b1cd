"""The memory of a described camera behind a wire: bootstrap registers first, then the camera's own."""

from __future__ import annotations

from collections.abc import Iterable

from fake_camera.device.features import FeatureError
from fake_camera.genapi.description import NodeError, whole_number
from fake_camera.genapi.xml_camera import XmlCamera
from fake_camera.genicam.registers import FEATURE_STATUS, Register, RegisterMap
from fake_camera.genicam.status import CommandError, Status

_BASES = (0x100000, 0x4000_0000, 0x5000_0000, 0x6000_0000, 0x7000_0000, 0xE000_0000)


def free_address(camera: XmlCamera, length: int) -> int:
    """An address for `length` bytes of zipped description away from all registers of the camera."""
    taken = [
        whole_number((part.text or "0").strip())
        for node in camera.description.nodes.values()
        for part in node.parts.get("Address", [])
    ]
    room = length + 0x10_0000  # registers may be addressed by an offset from those named
    return next(base for base in _BASES if not any(base - 0x10_0000 <= address < base + room for address in taken))


class XmlRegisters(RegisterMap):
    """All registers of a described camera; `alignment` as in `RegisterMap`."""

    def __init__(self, bootstrap: Iterable[Register], camera: XmlCamera, alignment: int = 4) -> None:
        super().__init__(bootstrap, alignment)
        self._camera = camera
        camera.place(self._bootstrap)

    def read(self, address: int, count: int) -> bytes:
        """Read `count` bytes; beside the bootstrap registers from the camera's memory; see `RegisterMap.read`."""
        self._check_alignment(address, count)
        known = self._bootstrap(address, count)
        return self._camera.read(address, count) if known is None else known

    def write(self, address: int, data: bytes) -> None:
        """Write `data`, see `RegisterMap.write`."""
        try:
            super().write(address, data)
        except CommandError as error:
            if error.status != Status.INVALID_ADDRESS:
                raise
        else:
            return
        try:
            self._camera.write(address, data)
        except FeatureError as error:
            raise CommandError(FEATURE_STATUS[error.kind]) from error
        except NodeError as error:  # the write leaves a node without a value
            raise CommandError(Status.INVALID_PARAMETER) from error

    def _bootstrap(self, address: int, count: int) -> bytes | None:
        """The content of the bootstrap registers there; None unless they cover the whole range."""
        try:
            return super().read(address, count)
        except CommandError:
            return None
