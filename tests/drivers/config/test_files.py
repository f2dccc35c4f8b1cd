"""Regular files are read up to a length; other kinds of file are not even opened."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from drivers.config.files import open_regular, read_regular


def test_a_file_is_read_whole_up_to_the_bound(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"x" * 2048)
    assert read_regular(file, 2048) == b"x" * 2048
    with pytest.raises(OSError, match="longer than 1 KiB"):
        read_regular(file, 1024)
    with open_regular(file) as stream:
        assert stream.read(2) == b"xx"


def test_a_file_without_a_length_is_bounded_too() -> None:
    assert read_regular(Path("/proc/self/status"), 1 << 20).startswith(b"Name:")


@pytest.mark.parametrize("kind", ["named pipe", "device", "directory", "socket"])
def test_other_kinds_of_file_are_named(tmp_path: Path, kind: str) -> None:
    odd = tmp_path / "odd"
    if kind == "named pipe":
        os.mkfifo(odd)
    elif kind == "device":
        odd.symlink_to("/dev/zero")
    elif kind == "directory":
        odd.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as listening:
            listening.bind(str(odd))
    with pytest.raises(OSError, match=f"a {kind}, not a regular file"):
        open_regular(odd)


def test_a_pipe_that_replaces_a_file_meanwhile_does_not_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    regular, odd = tmp_path / "regular", tmp_path / "odd"
    regular.touch()
    os.mkfifo(odd)
    before = regular.stat()
    monkeypatch.setattr(Path, "stat", lambda _self: before)
    with pytest.raises(OSError, match="a named pipe"):
        open_regular(odd)


@pytest.mark.parametrize("name", ["missing", "n" * 300])
def test_what_cannot_be_opened_raises_an_os_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(OSError, match=r"No such file|too long"):
        read_regular(tmp_path / name, 10)
