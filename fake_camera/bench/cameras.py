"""Fake cameras that run as long as a context lasts, each in a process of its own."""

from __future__ import annotations

import contextlib
import json
import random
import socket
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fake_camera.bench.process import CameraProcess, Start, started
from fake_camera.device.faults import Fault
from fake_camera.places import Side, names_of_rig
from fake_camera.usb3.run import client_environment

CONTROL_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class RunningCamera:
    """A fake camera that can be reached.

    Attributes
    ----------
    serial
        Its serial number.
    address
        Its IPv4 address, on the loopback interface; empty over USB.
    socket
        Where its USB port is; None over Ethernet.
    line0
        Name of the trigger wire. Cameras with the same name see the same pulses.
    control
        The socket that takes orders (docs/do/fake-camera.md).
    truth_file
        JSON lines of what it truly saw.
    ready
        The line that it printed when it was ready.
    """

    serial: str
    address: str
    socket: Path | None
    line0: str
    control: Path
    truth_file: Path
    process: CameraProcess

    @property
    def ready(self) -> str:
        """See above."""
        return self.process.ready

    def inject(self, fault: Fault | str, after_trigger: int | None = None, count: int | None = 1) -> int:
        """Order a fault, of so many triggers; returns the number of the last trigger before it.

        Raises ValueError for an order that the camera refuses; it says why.
        """
        fault = Fault(fault)
        order = {"fault": fault, "after_trigger": after_trigger}
        if fault is not Fault.COME_BACK:
            order["count"] = count
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(CONTROL_TIMEOUT_S)
            connection.connect(str(self.control))
            connection.sendall(json.dumps(order).encode() + b"\n")
            with connection.makefile("r") as lines:
                answer: dict[str, Any] = json.loads(lines.readline())
        if not answer["ok"]:
            raise ValueError(answer["error"])
        return int(answer["last_trigger"])

    def truth(self) -> list[dict[str, Any]]:
        """What is known so far of each pulse of the wire, and of exposures without one: time and light (lux)."""
        whole_lines = self.truth_file.read_text(encoding="utf-8").rpartition("\n")[0]
        return [json.loads(line) for line in whole_lines.splitlines()]

    def environment(self) -> dict[str, str]:
        """The environment of a program that sees this camera on its USB bus; over Ethernet that of this process.

        Raises ShimError where the library that stands in for the bus was not built.
        """
        return client_environment([] if self.socket is None else [self.socket])

    def kill(self) -> None:
        """Pull the plug: the process ends without a word on the wire."""
        self.process.kill()


@contextlib.contextmanager
def gige_camera(
    serial: str | None = None,
    *,
    address: str | None = None,
    side: Side = "left",
    place: str | None = None,
    line0: str | None = None,
    description: Path | None = None,
    light: Mapping[str, Any] | Path | None = None,
    options: Sequence[str] = (),
    start: Start = started,
) -> Iterator[RunningCamera]:
    """Run a GigE Vision camera until the context ends; when it begins, the camera answers.

    Raises NotStartedError with the reason.

    Parameters
    ----------
    serial, address, line0
        Made up, so that tests may run at the same time, where they are not given.
    side
        Of the stereo pair.
    place
        On a rig of pairs, in place of the side, by its name in `camera_rig`.
    description
        A GenICam description (XML) of a real camera to wear.
    light
        A light script, or a file of one.
    options
        More options of the command line.
    start
        How to begin the process.
    """
    address = address or loopback_address()
    arguments = ["--address", address, *_at(side, place), *_worn(description), *options]
    with _running(serial, line0, arguments, light, start) as camera:
        yield RunningCamera(address=address, socket=None, **camera)


@contextlib.contextmanager
def usb3_camera(
    serial: str | None = None,
    *,
    socket: Path | None = None,
    side: Side = "left",
    place: str | None = None,
    line0: str | None = None,
    description: Path | None = None,
    light: Mapping[str, Any] | Path | None = None,
    options: Sequence[str] = (),
    start: Start = started,
) -> Iterator[RunningCamera]:
    """The same on USB3 Vision: programs with its `environment()` see it on their bus."""
    with tempfile.TemporaryDirectory() as folder:
        socket = socket or Path(folder, "camera")
        arguments = ["--usb3", "--socket", str(socket), *_at(side, place), *_worn(description), *options]
        with _running(serial, line0, arguments, light, start) as camera:
            yield RunningCamera(address="", socket=socket, **camera)


@contextlib.contextmanager
def camera_rig(
    n: int = 2,
    *,
    transport: Literal["gige", "usb3"] = "gige",
    description: Path | None = None,
    light: Mapping[str, Any] | Path | None = None,
    options: Sequence[str] = (),
    start: Start = started,
) -> Iterator[dict[str, RunningCamera]]:
    """Run one to eight cameras on one trigger wire until the context ends, by the names of their places.

    Up to two are `left` and `right`, side by side. More are such pairs turned around a robot, one after the other:
    `front_left`, `front_right`, and likewise `rear`, on which the sun shines, `port` and `starboard`. A program sees
    those on USB3 Vision in a `client_environment` of all their sockets.
    """
    line0 = unique("wire")
    run: Callable[..., AbstractContextManager[RunningCamera]] = gige_camera if transport == "gige" else usb3_camera
    with contextlib.ExitStack() as stack:
        yield {
            name: stack.enter_context(
                run(place=name, line0=line0, description=description, light=light, options=options, start=start)
            )
            for name in names_of_rig(n)
        }


@contextlib.contextmanager
def ptp_master(port: int, start: Start = started) -> Iterator[None]:
    """Run a PTP master for cameras with ``--ptp PORT`` until the context ends."""
    with start(["ptp-master", "--port", str(port)]):
        yield


def unique(prefix: str) -> str:
    """A name that others on this machine do not have."""
    return f"{prefix}-{random.SystemRandom().getrandbits(32):08x}"


def loopback_address() -> str:
    """A random loopback address, away from those that people use by hand."""
    numbers = random.SystemRandom()
    return f"127.{numbers.randint(1, 254)}.{numbers.randint(1, 254)}.{numbers.randint(2, 254)}"


@contextlib.contextmanager
def _running(
    serial: str | None, line0: str | None, options: Sequence[str], light: Mapping[str, Any] | Path | None, start: Start
) -> Iterator[dict[str, Any]]:
    """All of a `RunningCamera` but where it is reached."""
    serial, line0 = serial or unique("FAKE"), line0 or unique("wire")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        control, truth_file = folder / "control", folder / "truth.jsonl"
        arguments = ["--serial", serial, "--line0", line0, "--control", str(control), "--truth", str(truth_file)]
        if light is not None:
            arguments += ["--light", str(_script(light, folder))]
        with start([*arguments, *options]) as process:
            yield {
                "serial": serial, "line0": line0, "control": control, "truth_file": truth_file, "process": process,
            }  # fmt: skip


def _at(side: Side, place: str | None) -> list[str]:
    return ["--side", side] if place is None else ["--place", place]


def _worn(description: Path | None) -> list[str]:
    return [] if description is None else ["--xml", str(description)]


def _script(light: Mapping[str, Any] | Path, folder: Path) -> Path:
    if isinstance(light, Path):
        return light
    file = folder / "light.yaml"
    file.write_text(json.dumps(light), encoding="utf-8")  # YAML, too
    return file
