"""Files that users name: regular ones only, since pipes and devices may block, never end, or react."""

from __future__ import annotations

import codecs
import errno
import os
import secrets
import stat
import struct
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from documents.text import quoted
from imaging.errors import ConfigurationError

_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
_KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading.

    Raises OSError, also if it is not a regular file; `strerror` completes "cannot be read: ..."; ValueError for a name
    that no file can have.
    """
    _check(path.stat())  # before opening it, to which some devices react
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        _check(os.fstat(descriptor))  # another file may have taken its place
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def read_regular(path: Path, most_bytes: int) -> bytes:
    """The content of a file; raises what `open_regular` does, and OSError if it is longer than `most_bytes`."""
    with open_regular(path) as file:
        content: bytes | None = file.read(most_bytes + 1)
    if content is None:  # a kernel file may have nothing to read yet
        raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"longer than {most_bytes >> 10} KiB")
    return content


def read_text(path: Path, most_bytes: int) -> str:
    """The text of a file in UTF-8, or in UTF-16 with a byte-order mark, which is left out.

    Raises ConfigurationError when the file cannot be read, is longer than `most_bytes`, or is no text.
    """
    try:
        content = read_regular(path, most_bytes)
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read ({error.strerror}): check its name and access") from error
    except ValueError as error:  # a NUL in its name
        raise ConfigurationError(f"{quoted(str(path))}: is not a file name: {error}") from error
    try:
        return content.decode("utf-16" if content.startswith(_UTF16_MARKS) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"{path}: is not text (byte {error.start}): name a text file") from error


def replace_file(path: Path, content: bytes) -> None:
    """Write a file in one step: if that fails, a former one stays as it was.

    A former file's mode is kept, and where permitted its owner; a link goes on pointing to it. Raises OSError, also if
    what is there is not a regular file; `strerror` completes "cannot be written: ...".
    """
    target = Path(os.path.realpath(path))
    former = _former(target)
    part = target.with_name(f".{secrets.token_hex(8)}.part")  # short: the name may have no room for more
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if former is not None:
                with suppress(PermissionError):  # of another user
                    os.fchown(descriptor, former.st_uid, former.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(former.st_mode))
            file.write(content)
            file.flush()
            os.fsync(descriptor)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def check_writable(path: Path) -> None:
    """Check that a file can be written, before the work whose result it is to have; raises ConfigurationError."""
    if path.is_dir() or not os.access(path.absolute().parent, os.W_OK):
        raise ConfigurationError(f"{path}: cannot be written; name a file in an existing folder")
    if path.exists() and not os.access(path, os.W_OK):
        raise ConfigurationError(f"{path}: exists and cannot be written; name another file")


def _former(path: Path) -> os.stat_result | None:
    """What is to be replaced; one that may not be written is refused as if it were opened."""
    try:
        status = path.stat()
    except FileNotFoundError:
        return None
    _check(status)
    if not os.access(path, os.W_OK):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    return status


def _check(status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = _KINDS.get(stat.S_IFMT(status.st_mode), "something")
        raise OSError(errno.EINVAL, f"{kind}, not a regular file")


SIGNATURE = b"\x89PNG\r\n\x1a\n"
MOST_PIXELS = 1 << 28
"""More than any sensor has: a few hundred bytes can declare an image that fills all memory."""

_CHUNK_BYTES = 12  # per chunk, apart from its data: length, type, checksum


def is_whole_png(content: bytes) -> bool:
    """Whether its chunks are as long as declared, the last one is present, and a sensor could have its size.

    OpenCV allocates the declared length, up to 4 GB, before it looks at the data.
    """
    if not content.startswith(SIGNATURE + b"\0\0\0\rIHDR") or len(content) < 24:
        return False
    width, height = struct.unpack_from(">II", content, 16)
    at = len(SIGNATURE)
    while at + _CHUNK_BYTES <= len(content):
        last = content[at + 4 : at + 8] == b"IEND"
        at += _CHUNK_BYTES + int.from_bytes(content[at : at + 4], "big")
        if last:
            return bool(at <= len(content) and width * height <= MOST_PIXELS)
    return False
