"""Regular files are read up to a length, and replaced in one step; other kinds of file are not even opened."""

from __future__ import annotations

import errno
import os
import socket
import stat
from pathlib import Path

import pytest

from documents.files import check_writable, open_regular, read_regular, replace_file
from imaging.errors import ConfigurationError


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


def test_a_file_is_replaced_and_keeps_its_mode_and_the_links_to_it(tmp_path: Path) -> None:
    file, link, new = tmp_path / "file", tmp_path / "link", tmp_path / ("n" * 255)
    file.write_text("a longer text")
    file.chmod(0o640)
    link.symlink_to(file)
    replace_file(link, "µ".encode())
    assert file.read_text(encoding="utf-8") == "µ"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    replace_file(new, b"x")
    (tmp_path / "usual").touch()
    assert new.stat().st_mode == (tmp_path / "usual").stat().st_mode
    assert {path.name for path in tmp_path.iterdir()} == {"file", "link", new.name, "usual"}
    assert link.is_symlink()


@pytest.mark.parametrize(("owner", "step"), [(os, "fsync"), (os, "fchmod"), (Path, "replace")])
def test_what_fails_on_the_way_leaves_the_former_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, owner: object, step: str
) -> None:
    def full(*_arguments: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    file = tmp_path / "file"
    file.write_text("former")
    monkeypatch.setattr(owner, step, full)
    with pytest.raises(OSError, match="No space left"):
        replace_file(file, b"new")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["former"]


@pytest.mark.parametrize("odd", ["/dev/null", "."])
def test_only_regular_files_are_replaced(odd: str) -> None:
    with pytest.raises(OSError, match="not a regular file"):
        replace_file(Path(odd), b"text")


def test_a_file_that_may_not_be_written_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("former")
    monkeypatch.setattr(os, "access", lambda *_arguments: False)  # root may write all
    with pytest.raises(PermissionError, match="Permission denied"):
        replace_file(file, b"new")
    assert file.read_text() == "former"


def test_a_file_that_may_not_be_written_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = tmp_path / "kept.json"
    kept.touch()
    check_writable(kept)
    monkeypatch.setattr(os, "access", lambda path, _mode: path != kept)  # root may write all
    check_writable(tmp_path / "new.json")
    with pytest.raises(ConfigurationError, match=r"kept\.json: exists and cannot be written; name another file"):
        check_writable(kept)
