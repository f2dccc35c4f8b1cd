"""`autoexpose run` as a service manager starts it: its notifications are read here."""

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

AUTOEXPOSE = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()"]
PATIENCE_S = 30.0


@dataclass
class ServiceProcess:
    """A running daemon; `heard` are its notifications so far."""

    process: subprocess.Popen[bytes]
    notifications: socket.socket
    log_file: Path
    heard: list[str] = field(default_factory=list)

    @property
    def log(self) -> str:
        return self.log_file.read_text()

    def wait_for(self, prefix: str) -> str:
        """The next notification that begins so."""
        return self.wait_until(lambda message: message.startswith(prefix), prefix)

    def wait_until(self, matches: Callable[[str], bool], what: str) -> str:
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            self.notifications.settimeout(max(deadline_s - time.monotonic(), 0.01))
            with contextlib.suppress(TimeoutError):
                self.heard.append(self.notifications.recv(4096).decode())
                if matches(self.heard[-1]):
                    return self.heard[-1]
        raise AssertionError(f"waited in vain for {what}: {self.heard[-3:]}\n{self.log}")

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
    with (
        tempfile.TemporaryDirectory() as folder,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notifications,
        (Path(folder) / "log").open("wb") as log,
    ):
        notifications.bind(str(Path(folder) / "notify"))
        environment = os.environ | {"NOTIFY_SOCKET": str(Path(folder) / "notify")}
        environment |= {} if state is None else {"STATE_DIRECTORY": str(state)}
        with subprocess.Popen(
            [*AUTOEXPOSE, *command, "-c", str(config)], stdin=subprocess.DEVNULL, stderr=log, env=environment
        ) as process:
            service = ServiceProcess(process, notifications, Path(log.name))
            try:
                yield service
            finally:
                if process.poll() is None and service.stop() != 0:
                    raise AssertionError(service.log)
