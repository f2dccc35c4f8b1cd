"""Two GigE Vision clients that know neither this project nor Aravis, behind one interface for the tests.

`telegenic` (PyPI: telegenicam) and `viva_genicam` (PyPI: viva-genicam, wheels for x86-64 only) each have a GVCP, a GVSP
and a GenApi implementation of their own, in Rust. What they cannot do, and so do not examine here:

* telegenic: its search leaves out the loopback interface; no action commands, events, clocks or saved features from
  Python; it hands out chunk data undivided.
* viva_genicam: its search on the loopback interface asks 127.0.0.1 only; by itself it leaves the packet size alone. It
  looks for USB cameras in sysfs, and so sees none through the shim.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import pytest

PATIENCE_S = 5.0


def telegenic_module() -> ModuleType:
    return pytest.importorskip("telegenic", reason="telegenicam is not installed")  # type: ignore[no-any-return]


def viva_module() -> ModuleType:
    return pytest.importorskip("viva_genicam", reason="viva-genicam is not installed: it has wheels for x86-64 only")  # type: ignore[no-any-return]


@dataclass(frozen=True, slots=True)
class ForeignFrame:
    """A complete frame as a client hands it out, chunk data included."""

    block_id: int
    width: int
    height: int
    pixel_format: int
    device_time_ns: int
    payload: bytes


class _TelegenicStream:
    """A running acquisition: complete frames, packets that came at the second request, frames that never were whole."""

    def __init__(self, acquisition: Any) -> None:
        self._acquisition = acquisition

    def next_frame(self) -> ForeignFrame:
        while (frame := self._acquisition.wait_for(PATIENCE_S)) is not None and not frame.is_complete:
            pass  # on a busy machine; viva_genicam hands out no such frames, and both count them as lost
        assert frame is not None, "no frame"
        return ForeignFrame(
            frame.frame_id,
            frame.width,
            frame.height,
            frame.pixel_format_code,
            frame.timestamp_ns,
            frame.data(),
        )

    def resent(self) -> int:
        return int(self._acquisition.stats().resent_packets)

    def lost(self) -> int:
        stats = self._acquisition.stats()
        return int(stats.missing_frames + stats.failed_frames + stats.timed_out_frames)


class Telegenic:
    """A client in control of the camera at `address`; `streaming` negotiates the packet size."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.camera = telegenic_module().Camera(address)
        self.camera.connect()

    def set(self, name: str, value: str | int | float | bool) -> None:
        kind = {str: "enum", bool: "boolean", int: "integer", float: "float"}[type(value)]
        getattr(self.camera, f"set_{kind}")(name, value)

    def get(self, name: str) -> str:
        return str(self.camera.get_enum(name))

    def execute(self, name: str) -> None:
        self.camera.execute(name)

    @contextlib.contextmanager
    def streaming(self) -> Iterator[_TelegenicStream]:
        with self.camera.start_acquisition() as acquisition:
            yield _TelegenicStream(acquisition)

    def close(self) -> None:
        self.camera.disconnect()


class _VivaStream:
    """See `_TelegenicStream`."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def next_frame(self) -> ForeignFrame:
        frame = self._stream.next_frame(round(PATIENCE_S * 1e3))
        assert frame.is_complete
        return ForeignFrame(
            frame.block_id, frame.width, frame.height, frame.pixel_format_code, frame.ts_dev, frame.payload()
        )

    def resent(self) -> int:
        return int(self._stream.stats().resend_recovered)

    def lost(self) -> int:
        return int(self._stream.stats().frames_lost)


class Viva:
    """See `Telegenic`."""

    def __init__(self, address: str) -> None:
        self.address = address
        module = viva_module()
        (found,) = (camera for camera in module.discover(all=True, timeout_ms=500) if camera.ip == address)
        self.camera = module.connect_gige(found)

    def set(self, name: str, value: str | int | float | bool) -> None:
        self.camera.set(name, str(int(value) if isinstance(value, bool) else value))

    def get(self, name: str) -> str:
        return str(self.camera.get(name))

    def execute(self, name: str) -> None:
        self.camera.execute(name)

    @contextlib.contextmanager
    def streaming(self) -> Iterator[_VivaStream]:
        with self.camera.stream(auto_packet_size=True) as stream:
            yield _VivaStream(stream)

    def close(self) -> None:
        self.camera.close()


ForeignClient = Telegenic | Viva
