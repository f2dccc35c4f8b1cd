"""Fake cameras on one wire, two or a rig of pairs, and a daemon on them, in real time through stock Aravis."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.step import ControlStep
from autoexpose_daemon.demo.analysis import pulses_in_window
from autoexpose_daemon.demo.fakes import read_pulses
from autoexpose_daemon.runtime.daemon import Daemon
from autoexpose_daemon.runtime.setup import openers
from autoexpose_daemon.service.service import add_outlets
from autoexpose_daemon.status.describe import describe
from autoexpose_daemon.status.panel import line_of
from fake_camera.places import names_of_rig
from fake_camera.usb3.run import CAMERAS_VARIABLE
from imaging.frames import CameraName, FrameSet
from imaging.geometry import SIDES
from tests.fakes import FakeCamera, camera_on_this_bus, fake_camera, unique
from tests.meanwhile import meanwhile

PATIENCE_S = 30.0
ON_USB = CAMERAS_VARIABLE in os.environ
START_CAMERA = camera_on_this_bus if ON_USB else fake_camera
"""USB3 Vision in a process with fake cameras on its USB bus, else GigE Vision."""


@dataclass
class Run:
    """A running daemon, seen from a test."""

    cameras: Mapping[CameraName, FakeCamera]
    truths: list[Path]
    daemon: Daemon
    seen: list[tuple[FrameSet, Decision]] = field(default_factory=list)
    failure: list[BaseException] = field(default_factory=list)

    @property
    def left(self) -> FakeCamera:
        return self.cameras["left"]

    @property
    def right(self) -> FakeCamera:
        return self.cameras["right"]

    @property
    def triggers_on_the_wire(self) -> int:
        return len(pulses_in_window(read_pulses(self.truths), self.daemon.tally))

    def wait_until(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert not self.failure, self.failure
            assert time.monotonic() < deadline, (
                f"waited in vain for {what}: {line_of(describe(self.daemon.telemetry, self.daemon.tuning.config))}"
            )
            threading.Event().wait(0.01)

    def wait_for_pairs(self, count: int) -> None:
        """Until that many more stereo pairs have come."""
        target = self.daemon.telemetry.counts.pairs + count
        self.wait_until(lambda: self.daemon.telemetry.counts.pairs >= target, f"{count} pairs")


@contextlib.contextmanager
def stereo_cameras(
    *options: str, left_triggers_right: bool = False
) -> Iterator[tuple[FakeCamera, FakeCamera, list[Path]]]:
    """Both on one trigger wire, and, if asked for, the exposure output of the left one on Line3 of the right one.

    `options` are further ones of both.
    """
    wire = unique("wire")
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        truths = [Path(folder) / "left.jsonl", Path(folder) / "right.jsonl"]
        between = str(Path(folder) / "wire")
        ends = [["--line1", between], ["--line3", between]] if left_triggers_right else [[], []]
        left, right = (
            stack.enter_context(START_CAMERA(side=camera, line0=wire, options=["--truth", str(truth), *end, *options]))
            for camera, truth, end in zip(SIDES, truths, ends, strict=True)
        )
        yield left, right, truths


@contextlib.contextmanager
def rig_cameras(n: int, *options: str, **arguments: Any) -> Iterator[dict[CameraName, FakeCamera]]:
    """So many on one trigger wire, as `fake_camera.bench.camera_rig` has them, also on this process's own USB bus."""
    wire = unique("wire")
    with contextlib.ExitStack() as stack:
        yield {
            name: stack.enter_context(START_CAMERA(place=name, line0=wire, options=options, **arguments))
            for name in names_of_rig(n)
        }


@contextlib.contextmanager
def running_daemon(
    cameras: tuple[FakeCamera, FakeCamera, list[Path]],
    settings: dict[str, Any] | None = None,
    *,
    latched: bool = True,
) -> Iterator[Run]:
    """A daemon on both cameras, as `running` has it."""
    left, right, truths = cameras
    with running({"left": left, "right": right}, truths, settings, latched=latched) as run:
        yield run


@contextlib.contextmanager
def running(
    cameras: Mapping[CameraName, FakeCamera],
    truths: list[Path],
    settings: dict[str, Any] | None = None,
    *,
    latched: bool = True,
) -> Iterator[Run]:
    """A daemon on cameras, stopped and checked for its account when the block ends.

    Without a latch for the time stamps of `cameras` the account is not compared with the wire: the first and the last
    trigger are then placed by when frames arrive, which on a loaded machine may be a trigger later.
    """
    named = {name: {"serial": camera.serial} for name, camera in cameras.items()}
    config = Config.model_validate({"cameras": named} | (settings or {}))
    seen: list[tuple[FrameSet, Decision]] = []

    def see(step: ControlStep) -> None:
        if step.decision is not None:
            seen.append((step.pair, step.decision))

    daemon = add_outlets(Daemon(config, openers(config), outlets=[see]), config)
    run = Run(cameras, truths, daemon, seen)

    def control(stop: threading.Event) -> None:
        try:
            daemon.run(stop)
        except BaseException as error:
            run.failure.append(error)

    with meanwhile(control):
        yield run
    assert not run.failure, run.failure
    if config.trigger.mode == "external" and latched:  # else the wire has nothing to do with the triggers
        run.wait_until(lambda: _written(run), "the fakes' truth")
        assert daemon.tally.triggers == run.triggers_on_the_wire


def _written(run: Run) -> bool:
    """Whether the fakes have written the pulses of the whole window down."""
    end_ns = run.daemon.tally.window_end_ns
    pulses = read_pulses(run.truths)
    return end_ns is None or (bool(pulses) and pulses[-1].host_time_ns > end_ns)
