"""The wire from one camera's exposure output to another's input."""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from queue import Queue

import pytest

from fake_camera.device.exposure_wire import ExposureInput, ExposureOutput


def test_pulses_arrive_with_their_times_and_nothing_else_does(tmp_path: Path) -> None:
    pulses: Queue[int] = Queue()
    end, other = ExposureInput(tmp_path / "wire", pulses.put), ExposureOutput(tmp_path / "wire")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as stranger:
        for datagram in (b"", b"short", struct.pack("=qq", 1, 2)):
            stranger.sendto(datagram, str(tmp_path / "wire"))
    other.rise(7)
    assert pulses.get(timeout=5) == 7
    other.close()
    end.close()
    assert list(tmp_path.iterdir()) == []


def test_a_dead_socket_file_is_replaced_a_live_one_and_other_files_are_not(tmp_path: Path) -> None:
    path, notes = tmp_path / "wire", tmp_path / "notes"
    notes.write_text("mine")
    with pytest.raises(OSError, match=r"the wire .*notes cannot be opened: Address already in use"):
        ExposureInput(notes, lambda _: None)
    assert notes.read_text() == "mine"
    dead = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    dead.bind(str(path))
    dead.close()
    end = ExposureInput(path, lambda _: None)
    with pytest.raises(OSError, match=r"the wire .*wire cannot be opened: Address already in use"):
        ExposureInput(path, lambda _: None)
    end.close()
