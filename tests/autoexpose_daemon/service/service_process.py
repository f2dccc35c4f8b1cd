"""The command line in a process or in this one, and `autoexpose run` as a service manager starts it."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from autoexpose_daemon.cli import main

AUTOEXPOSE = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()"]
PATIENCE_S = 30.0


def autoexpose(*arguments: str, timeout_s: float = 60.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*AUTOEXPOSE, *arguments], capture_output=True, text=True, timeout=timeout_s, check=False)


class Within:
    """The command line in this process: the same words and exit codes, without half a second of imports."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys

    def __call__(self, *arguments: str) -> tuple[int, str, str]:
        """Exit code, and what it printed on stdout and stderr."""
        self._monkeypatch.setattr("sys.argv", ["autoexpose", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        assert isinstance(ended.value.code, int)
        return ended.value.code, *self._capsys.readouterr()

    def refused(self, *arguments: str) -> str:
        """The one line that refuses it."""
        code, _, told = self(*arguments)
        assert (code, told.count("\n")) == (1, 1), told
        return told


@dataclass
class Notifications:
    """What a service manager hears at its end of a socket; `heard` is all so far."""

    socket: socket.socket
    log: Callable[[], str]
    heard: list[str] = field(default_factory=list)

    def wait_for(self, prefix: str) -> str:
        """The next notification that begins so."""
        return self.wait_until(lambda message: message.startswith(prefix), prefix)

    def wait_until(self, matches: Callable[[str], bool], what: str) -> str:
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            self.socket.settimeout(max(deadline_s - time.monotonic(), 0.01))
            with contextlib.suppress(TimeoutError):
                self.heard.append(self.socket.recv(4096).decode())
                if matches(self.heard[-1]):
                    return self.heard[-1]
        raise AssertionError(f"waited in vain for {what}: {self.heard[-3:]}\n{self.log()}")


@contextlib.contextmanager
def service_manager(log: Callable[[], str]) -> Iterator[tuple[Notifications, str]]:
    """Somebody who listens, and the address; `log` is shown when waiting was in vain."""
    with tempfile.TemporaryDirectory() as folder, socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as end:
        address = str(Path(folder) / "notify")
        end.bind(address)
        yield Notifications(end, log), address


@dataclass
class ServiceProcess:
    """A running daemon, and its messages to its service manager."""

    process: subprocess.Popen[bytes]
    notifications: Notifications
    log_file: Path

    @property
    def log(self) -> str:
        return self.log_file.read_text()

    @property
    def heard(self) -> list[str]:
        return self.notifications.heard

    def wait_for(self, prefix: str) -> str:
        return self.notifications.wait_for(prefix)

    def wait_until(self, matches: Callable[[str], bool], what: str) -> str:
        return self.notifications.wait_until(matches, what)

    def reload(self) -> None:
        self.process.send_signal(signal.SIGHUP)

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        self.process.terminate()
        return self.process.wait(PATIENCE_S)


@contextlib.contextmanager
def running_service(
    config: Path, state: Path | None = None, command: Sequence[str] = ("run",)
) -> Iterator[ServiceProcess]:
    """Run the daemon on a configuration file, by `command`, until the block ends."""
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        log_file = Path(log.name)
        with service_manager(log_file.read_text) as (notifications, address):
            environment = os.environ | {"NOTIFY_SOCKET": address}
            environment |= {} if state is None else {"STATE_DIRECTORY": str(state)}
            arguments = [*AUTOEXPOSE, *command, "-c", str(config)]
            with subprocess.Popen(arguments, stdin=subprocess.DEVNULL, stderr=log, env=environment) as process:
                service = ServiceProcess(process, notifications, log_file)
                try:
                    yield service
                finally:
                    if process.poll() is None and service.stop() != 0:
                        raise AssertionError(service.log)
