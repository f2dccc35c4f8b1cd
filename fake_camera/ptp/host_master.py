"""A PTP master with the host's time: ``python -m fake_camera ptp-master``."""

from __future__ import annotations

import argparse
import os
import secrets
import signal
import sys
import time
from types import TracebackType

from fake_camera.ptp.master import Master
from fake_camera.ptp.messages import PortIdentity, clock_identity
from fake_camera.ptp.port import EVENT_PORT, PtpPort

_ADDRESS = "127.0.0.1"
_JUMP_S = 10
_LOCALLY_ADMINISTERED = 0x02 << 40


class HostMaster:
    """A master on the interface that has an IPv4 address, until it is closed.

    Its time is CLOCK_REALTIME as it was at the start, and then advances as CLOCK_MONOTONIC, so that it does not follow
    when the host's clock is set. OSError when a port cannot be used.
    """

    def __init__(self, event_port: int = EVENT_PORT, address: str = _ADDRESS) -> None:
        self._ahead_ns = time.time_ns() - time.monotonic_ns()
        identity = PortIdentity(clock_identity(_LOCALLY_ADMINISTERED | secrets.randbits(40)))
        self._port = PtpPort(Master(identity, self.time_ns), address, event_port)
        self._port.start()

    def __enter__(self) -> HostMaster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def time_ns(self, host_ns: int) -> int:
        """Its time at a time of CLOCK_MONOTONIC."""
        return host_ns + self._ahead_ns

    def jump(self, by_ns: int) -> None:
        """Let its time jump."""
        self._ahead_ns += by_ns

    def close(self) -> None:
        """Fall silent."""
        self._port.close()


def event_port(text: str) -> int:
    """A UDP port that has a next one, for argparse."""
    if text.isdecimal() and 1 <= int(text) < 0xFFFF:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 to 65534")


def main(arguments: list[str]) -> int:
    """Run a master until SIGTERM or SIGINT; returns 2, with one sentence on stderr, if it cannot."""
    parser = argparse.ArgumentParser(
        prog="python -m fake_camera ptp-master",
        description="A PTP (IEEE 1588) master with this machine's time, which fake cameras with --ptp follow. "
        f"SIGUSR1 makes its time jump {_JUMP_S} s ahead.",
    )
    parser.add_argument("--address", default=_ADDRESS, help="of the interface (%(default)s)")
    parser.add_argument(
        "--port", type=event_port, default=EVENT_PORT, help="UDP port; it uses the next one, too (%(default)s)"
    )
    options = parser.parse_args(arguments)
    awaited = {signal.SIGTERM, signal.SIGINT, signal.SIGUSR1}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, awaited)  # of the master's thread, too
    try:
        with HostMaster(options.port, options.address) as master:
            ports = f"UDP ports {options.port} and {options.port + 1}"
            print(f"PTP master at {options.address}, {ports}, process {os.getpid()}", flush=True)
            while signal.sigwait(awaited) == signal.SIGUSR1:
                master.jump(_JUMP_S * 1_000_000_000)
    except OSError as error:
        print(f"PTP master at {options.address}: {error}", file=sys.stderr)
        return 2
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return 0
