"""For all tests of the daemon."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from autoexpose_daemon.messages import sockets
from tests.autoexpose_daemon.service.service_process import Within


@pytest.fixture
def within(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Within:
    return Within(monkeypatch, capsys)


@pytest.fixture(autouse=True)
def _brisk_where_something_is_published(request: pytest.FixtureRequest) -> None:
    if request.path.parent.name in ("client", "page", "publish"):
        request.getfixturevalue("brisk")


@pytest.fixture
def socket_folder() -> Iterator[Path]:
    """For sockets, whose paths have at most 107 bytes: pytest's own folders have longer names."""
    with tempfile.TemporaryDirectory(prefix="autoexpose-") as folder:
        yield Path(folder)


@pytest.fixture
def own_machine(socket_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """This process finds and makes sockets below this folder only: a user's own in `user`, the service's in `run`."""
    user = socket_folder / "user"
    user.mkdir(0o700)
    monkeypatch.setattr(sockets, "SYSTEM_FOLDER", socket_folder / "run")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(user))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    return socket_folder
