"""Fake cameras as processes; apart from the wire, only what they print and write to files is used."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imaging.errors import AutoexposeError, ConfigurationError
from imaging.geometry import SIDES

if TYPE_CHECKING:
    from imaging.frames import CameraName

SOCKETS_VARIABLE = "FAKE_CAMERA_USB3"
"""The environment variable that names the fake cameras' sockets for the shim."""

FOLDER_VARIABLE = "AUTOEXPOSE_DEMO_FOLDER"
"""The environment variable that names the folder which the demo made for its sockets."""


_STOPPING = {signal.SIGINT, signal.SIGTERM}


def cameras_on_bus() -> list[Path]:
    """The sockets of the fake cameras on this process' USB bus; empty on the machine's own bus."""
    sockets = os.environ.get(SOCKETS_VARIABLE)
    return [*map(Path, sockets.split(":"))] if sockets else []


def begin_again_on_fake_bus(cameras: int) -> None:
    """Become the same command with sockets for so many cameras, in a new folder, on its USB bus; does not return.

    libusb decides at its start what it looks at, so a running process cannot change it. Signals wait for
    `take_signals`: until then nothing would handle them and remove the folder.
    """
    signal.pthread_sigmask(signal.SIG_BLOCK, _STOPPING)
    folder = Path(tempfile.mkdtemp(prefix="autoexpose-demo-"))
    os.environ[FOLDER_VARIABLE] = str(folder)
    sockets = [str(folder / f"{number}") for number in range(cameras)]
    command = [sys.executable, "-c", "from autoexpose_daemon.cli import main; main()", *sys.argv[1:]]
    os.execv(sys.executable, [sys.executable, "-m", "fake_camera.usb3", *sockets, "--", *command])


def take_signals() -> None:
    """Take those that came while the process began again."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _STOPPING)


def folder_of_bus() -> Path | None:
    """The folder that `begin_again_on_fake_bus` made; None: it made none, and cameras on the bus are not the demo's."""
    folder = os.environ.get(FOLDER_VARIABLE)
    return None if folder is None else Path(folder)


def without_fake_bus() -> dict[str, str]:
    """The environment for a process on the machine's own USB bus."""
    of_bus = (SOCKETS_VARIABLE, FOLDER_VARIABLE, "LD_PRELOAD")
    return {name: value for name, value in os.environ.items() if name not in of_bus}


_VIEWS = ("front", "rear", "port", "starboard")
MOST_CAMERAS = len(SIDES) * len(_VIEWS)


@dataclass(frozen=True, slots=True)
class CameraPlace:
    """A fake camera of the rig: its name, which tells the fake where it is, and how it is reached."""

    name: CameraName
    number: int

    @property
    def serial(self) -> str:
        """Its serial number, of at most 15 characters."""
        view, _, side = self.name.upper().rpartition("_")
        return f"FAKE-{view[:5]}-{side[0]}" if view else f"FAKE-{side}"

    @property
    def group(self) -> dict[str, str]:
        """The key that has it exposed with those that look where it looks; none in a stereo pair."""
        view, _, _ = self.name.rpartition("_")
        return {"group": view} if view else {}

    @property
    def address(self) -> str:
        """That of a GigE Vision camera."""
        return f"127.0.0.{2 + self.number}"


def places(cameras: int) -> list[CameraPlace]:
    """One camera, a stereo pair, or pairs that look forward, back at what the sun lights, to the left and right."""
    names = SIDES if cameras <= len(SIDES) else [f"{view}_{side}" for view in _VIEWS for side in SIDES]
    return [CameraPlace(name, number) for number, name in enumerate(names[:cameras])]


_NICENESS = "10"  # real cameras do not take the daemon's CPU time
_READY_S = 180.0  # the first start compiles the renderer
_LONGEST_PULSE_BYTES = 200


@dataclass(frozen=True, slots=True)
class Pulse:
    """A pulse on the trigger wire as the fakes saw it: host time (CLOCK_MONOTONIC) and illumination."""

    trigger: int
    host_time_ns: int
    lux: float


def check_simulator() -> None:
    """Raise a ConfigurationError if the packages for the fake cameras are not installed."""
    if importlib.util.find_spec("numba") is None:
        raise ConfigurationError("the fake cameras need the extra `sim`: pip install 'autoexpose-daemon[sim]'")


class FakeCamera:
    """A fake camera that is starting, then waits for its rate, then runs until it is ended.

    It writes the light at each pulse of the wire to the file `truth`, and takes orders from `control`. At its end are
    known: `overruns`, exposures not made or not sent because it was late, and `cpu_s`, its processor time since it was
    ready.
    """

    def __init__(self, place: CameraPlace, folder: Path, arguments: Sequence[str]) -> None:
        self.truth = folder / f"{place.name}.truth.jsonl"
        self.control = folder / f"{place.name}.control"
        self.overruns = 0
        self.cpu_s = 0.0
        self._name = place.name
        self._error_log = folder / f"{place.name}.stderr"
        # setpriv: if this process is killed, its cameras must not survive and hold their addresses
        command = ["setpriv", "--pdeathsig", "TERM", sys.executable, "-m", "fake_camera"]
        command += ["--serial", place.serial, "--place", place.name, "--nice", _NICENESS, "--truth", str(self.truth)]
        command += ["--control", str(self.control), *arguments]
        with self._error_log.open("w") as error_log:
            self._process = subprocess.Popen(
                [*command, "--line0-rate-hz", "ask"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=error_log,
                text=True,
                env=without_fake_bus(),
                start_new_session=True,  # Ctrl-C is for the demo, which ends the cameras after the daemon
            )
        self._lines: deque[str] = deque()
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, name=f"fake-{place.name}", daemon=True)
        self._reader.start()

    def has_spoken(self, timeout_s: float) -> bool:
        """Wait a while for its next line."""
        with self._news:
            return self._news.wait_for(lambda: bool(self._lines), timeout_s)

    def line(self, stop: threading.Event) -> str:
        """Its next line; raises AutoexposeError with its last message if it has ended, or if `stop` is set."""
        deadline_s = time.monotonic() + _READY_S
        while not self.has_spoken(0.1):
            if stop.is_set() or time.monotonic() > deadline_s:
                raise AutoexposeError(f"stopped before the {self._name} fake camera was ready")
        line = self._lines.popleft()
        if not line:
            said = self._error_log.read_text(errors="replace").strip().splitlines() or ["it printed nothing"]
            raise AutoexposeError(f"the {self._name} fake camera did not start: {said[-1]}")
        return line

    def say(self, line: str) -> None:
        """Send it a line."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended; its next line says why
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()

    def end(self) -> None:
        """End it if it runs, and read its last line."""
        self._process.terminate()
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        counts = _document(next((line for line in reversed(self._lines) if line), ""))
        self.overruns = int(counts.get("overruns", 0)) + int(counts.get("missed", 0))
        self.cpu_s = float(counts.get("cpu_s", 0.0))

    def _read(self) -> None:
        """Put each line into the queue, and an empty one at the end."""
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in itertools.chain(lines, [""]):
                with self._news:
                    self._lines.append(line)
                    self._news.notify_all()


@dataclass(frozen=True, slots=True)
class FakeCameras:
    """The cameras of a rig, in its order."""

    all: tuple[FakeCamera, ...]
    stop: threading.Event

    @property
    def truths(self) -> list[Path]:
        """The files in which they log the light."""
        return [camera.truth for camera in self.all]

    def wait_until_found(self) -> None:
        """Wait until a search finds them; they do not send frames yet."""
        for camera in self.all:
            camera.line(self.stop)

    def are_timed(self, timeout_s: float) -> bool:
        """Wait some time until all know how long a frame takes, or have ended."""
        deadline_s = time.monotonic() + timeout_s
        return all(camera.has_spoken(deadline_s - time.monotonic()) for camera in self.all)

    def frame_s(self) -> float:
        """Processor time that the slowest one takes for a frame."""
        return max(float(_document(camera.line(self.stop))["frame_s"]) for camera in self.all)

    def run_at(self, rate_hz: float) -> None:
        """Have all follow a trigger wire of this rate; returns when they are ready."""
        for camera in self.all:
            camera.say(f"{rate_hz}")
        for camera in self.all:
            camera.line(self.stop)

    def end(self) -> None:
        """End all; their counts are known then."""
        for camera in self.all:
            camera.end()


@contextmanager
def fake_cameras(
    folder: Path, arguments: Sequence[str], sockets: Sequence[Path], stop: threading.Event, cameras: int = 2
) -> Iterator[FakeCameras]:
    """Run so many fake cameras, which wait for the rate of the trigger wire that `arguments` name.

    They are USB3 Vision cameras at `sockets`, or without sockets, GigE Vision cameras. Raises `AutoexposeError` if
    one does not start, or if `stop` is set before all have.
    """
    with ExitStack() as stack:
        started = []
        for place in places(cameras):
            reached = ["--usb3", "--socket", str(sockets[place.number])] if sockets else ["--address", place.address]
            camera = FakeCamera(place, folder, [*reached, *arguments])
            stack.callback(camera.end)
            started.append(camera)
        yield FakeCameras(tuple(started), stop)


def _document(line: str) -> dict[str, Any]:
    """A line of JSON from a fake; empty if it is not JSON."""
    try:
        document = json.loads(line)
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}


def read_pulses(truths: Sequence[Path]) -> list[Pulse]:
    """All pulses that any of the fakes saw on the wire, in order; raises AutoexposeError for a malformed line."""
    pulses: dict[int, Pulse] = {}
    for truth in truths:
        for number, line in enumerate(truth.read_bytes().splitlines(), 1):
            try:
                seen = json.loads(line)
                if seen["trigger"] is None:  # an exposure that no pulse started
                    continue
                pulse = Pulse(int(seen["trigger"]), int(seen["host_time_ns"]), float(seen["lux"]))
            except (ValueError, TypeError, LookupError, OverflowError, RecursionError) as error:
                raise AutoexposeError(f"{truth}: line {number} is not a pulse of the wire ({error})") from error
            pulses[pulse.trigger] = pulse
    return [pulses[trigger] for trigger in sorted(pulses)]


def newest_lux(truth: Path) -> float | None:
    """The light at the newest pulse that a fake has logged; None before the first."""
    with truth.open("rb") as file:
        file.seek(max(truth.stat().st_size - 2 * _LONGEST_PULSE_BYTES, 0))
        lines = file.read().split(b"\n")
    lux = _document(lines[-2].decode(errors="replace")).get("lux") if len(lines) > 1 else None
    return float(lux) if isinstance(lux, int | float) else None
