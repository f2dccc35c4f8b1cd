"""`autoexpose page` as a process, on a free port."""

from __future__ import annotations

import contextlib
import http.client
import re
import signal
import socket
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.autoexpose_daemon.service.service_process import AUTOEXPOSE

STOP_S = 10.0


@dataclass
class PageProcess:
    """A page that answers at `host` and `port`."""

    process: subprocess.Popen[bytes]
    log_file: Path
    host: str
    port: int

    @property
    def url(self) -> str:
        return f"http://{self.host}:{self.port}"

    @property
    def log(self) -> str:
        return self.log_file.read_text()

    def get(self, path: str, headers: Mapping[str, str] | None = None) -> tuple[int, str, http.client.HTTPMessage]:
        """Status, body and headers of a plain request."""
        return self.ask("GET", path, headers)

    def ask(
        self, method: str, path: str, headers: Mapping[str, str] | None = None, body: str | None = None
    ) -> tuple[int, str, http.client.HTTPMessage]:
        connection = http.client.HTTPConnection(self.host, self.port, timeout=STOP_S)
        with contextlib.closing(connection):
            connection.request(method, path, body, dict(headers or {}))
            answer = connection.getresponse()
            return answer.status, answer.read().decode(), answer.headers

    def hang_up(self, path: str, headers: Mapping[str, str] | None = None) -> None:
        """Post a few bytes of many, and leave."""
        lines = [f"{name}: {value}" for name, value in {"Host": self.host, **(headers or {})}.items()]
        with socket.create_connection((self.host, self.port), STOP_S) as connection:
            head = "\r\n".join((f"POST {path} HTTP/1.1", "Content-Length: 100", *lines))
            connection.sendall(f"{head}\r\n\r\ntoken=".encode())

    def stop(self) -> int:
        """Ctrl-C, and the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(STOP_S)


@contextlib.contextmanager
def running_page(*options: str) -> Iterator[PageProcess]:
    """Run the page with these options until the block ends."""
    with tempfile.TemporaryDirectory() as folder, (Path(folder) / "log").open("wb") as log:
        command = [*AUTOEXPOSE, "page", "--port", "0", *options]
        with subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=log) as process:
            try:
                yield PageProcess(process, Path(log.name), *_place(process, Path(log.name)))
            finally:
                if process.poll() is None:
                    process.terminate()
                    process.wait(STOP_S)


def _place(process: subprocess.Popen[bytes], log: Path) -> tuple[str, int]:
    while (found := re.search(r"http://([0-9.]+):(\d+)/", log.read_text())) is None:
        assert process.poll() is None, log.read_text()
    return found[1], int(found[2])
