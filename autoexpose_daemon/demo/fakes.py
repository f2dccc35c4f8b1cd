"""Two fake cameras as processes; all that is known of them beyond the wire is what they print and write to files."""

from __future__ import annotations

import importlib.util
import json
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from autoexpose_daemon.demo.usb_bus import without_fake_bus
from drivers.errors import AutoexposeError, ConfigurationError
from drivers.frames import Side

SERIALS: dict[Side, str] = {"left": "FAKE-LEFT", "right": "FAKE-RIGHT"}
_ADDRESSES: dict[Side, str] = {"left": "127.0.0.2", "right": "127.0.0.3"}
_READY_S = 180.0  # the first start compiles the renderer


@dataclass(frozen=True, slots=True)
class Pulse:
    """A pulse on the trigger wire as the fakes saw it: host time (CLOCK_MONOTONIC) and illumination."""

    trigger: int
    host_time_ns: int
    lux: float


def check_simulator() -> None:
    """Raise a ConfigurationError where what the fake cameras need is not installed."""
    if importlib.util.find_spec("numba") is None:
        raise ConfigurationError("the fake cameras need the extra `sim`: pip install 'autoexpose-daemon[sim]'")


@contextmanager
def fake_cameras(
    folder: Path, arguments: Sequence[str], wire: str, sockets: Mapping[Side, Path], stop: threading.Event
) -> Iterator[list[Path]]:
    """Run a left and a right fake camera on one trigger wire; yields their truth files.

    They are USB3 Vision cameras at `sockets`, or without any GigE Vision cameras.

    Raises
    ------
    AutoexposeError
        When a camera does not start, or `stop` is set before both have.
    """
    truths = [folder / f"{side}.truth.jsonl" for side in SERIALS]
    with ExitStack() as stack:
        starting = [
            stack.enter_context(_fake_camera(side, truth, [*_place(side, sockets), "--line0", wire, *arguments]))
            for side, truth in zip(SERIALS, truths, strict=True)
        ]
        for side, process in zip(SERIALS, starting, strict=True):
            _wait_ready(side, process, stop)
        yield truths


def _place(side: Side, sockets: Mapping[Side, Path]) -> list[str]:
    return ["--usb3", "--socket", str(sockets[side])] if sockets else ["--address", _ADDRESSES[side]]


@contextmanager
def _fake_camera(side: Side, truth: Path, arguments: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    # setpriv: should this process be killed, its cameras must not stay behind and hold their addresses
    command = ["setpriv", "--pdeathsig", "TERM", sys.executable, "-m", "fake_camera"]
    command += ["--serial", SERIALS[side], "--side", side, "--truth", str(truth), *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=without_fake_bus()
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.communicate(timeout=5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


def _wait_ready(side: Side, process: subprocess.Popen[str], stop: threading.Event) -> None:
    """Until the camera prints its first line."""
    assert process.stdout is not None
    deadline_s = time.monotonic() + _READY_S
    while not select.select([process.stdout], [], [], 0.1)[0]:
        if stop.is_set() or time.monotonic() > deadline_s:
            raise AutoexposeError(f"stopped before the {side} fake camera was ready")
    if not process.stdout.readline():
        _, complaint = process.communicate()
        lines = complaint.strip().splitlines() or ["it said nothing"]
        raise AutoexposeError(f"the {side} fake camera did not start: {lines[-1]}")


def read_pulses(truths: Sequence[Path]) -> list[Pulse]:
    """All pulses that any of the fakes saw on the wire, in order; raises AutoexposeError for what is no pulse."""
    pulses: dict[int, Pulse] = {}
    for truth in truths:
        for number, line in enumerate(truth.read_bytes().splitlines(), 1):
            try:
                seen = json.loads(line)
                pulse = Pulse(int(seen["trigger"]), int(seen["host_time_ns"]), float(seen["lux"]))
            except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
                raise AutoexposeError(f"{truth}: line {number} is no pulse of the wire ({error})") from error
            pulses[pulse.trigger] = pulse
    return [pulses[trigger] for trigger in sorted(pulses)]
