"""The cameras of a rig, each kept alive by its own threads, so that one in trouble does not disturb the others.

Per camera, one thread owns the nodes and one takes frames. All that happens goes into a single queue of events, for
the one thread that pairs frames and decides.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping

from drivers.camera import Camera
from drivers.rig.events import Command, RigEvent
from drivers.rig.supervision import Slots, Supervisor
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName


class Rig:
    """Runs cameras until `stop`: `Supervisor` has what `silence_s` and the start of each camera mean."""

    def __init__(
        self,
        openers: Mapping[CameraName, Callable[[], Camera]],
        silence_s: float,
        starts: Mapping[CameraName, ExposureSetting],
    ) -> None:
        self.events: queue.SimpleQueue[RigEvent] = queue.SimpleQueue()
        self._units = {
            camera: _Unit(camera, Supervisor(camera, opener, silence_s, starts[camera], self.events))
            for camera, opener in openers.items()
        }

    def start(self) -> None:
        """Start opening the cameras."""
        for unit in self._units.values():
            unit.start()

    def reopen(self, camera: CameraName, why: str) -> None:
        """Close and reopen a camera that answers but sends nothing; `why` follows its name in a sentence."""
        self._units[camera].supervisor.reopen(why)

    def pace(self, camera: CameraName, slots: Slots) -> None:
        """Trigger a camera in these slots until it is closed; replaces, or moves, the former ones."""
        self._units[camera].supervisor.pace(slots)

    def write(self, command: Command) -> None:
        """Write a setting to its cameras, no earlier than it is due; replaces pending writes to them."""
        for camera in command.cameras:
            self._units[camera].supervisor.request(command.setting, command.due_ns, command.number)

    def stop(self, timeout_s: float) -> bool:
        """Stop acquisition and close the cameras; False when one did not answer in time."""
        for unit in self._units.values():
            unit.ask_to_stop()
        deadline_s = time.monotonic() + timeout_s
        stopped = [unit.join(deadline_s) for unit in self._units.values()]
        return all(stopped)


class _Unit:
    """One camera's supervisor and its threads."""

    def __init__(self, camera: CameraName, supervisor: Supervisor) -> None:
        self.supervisor = supervisor
        self._stopping = False
        self._threads = (
            threading.Thread(target=self._serve, name=f"nodes-{camera}", daemon=True),
            threading.Thread(target=self._take_frames, name=f"frames-{camera}", daemon=True),
        )

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def ask_to_stop(self) -> None:
        with self.supervisor.news:
            self._stopping = True
            self.supervisor.news.notify_all()

    def join(self, deadline_s: float) -> bool:
        for thread in self._threads:
            thread.join(max(deadline_s - time.monotonic(), 0.0))
        return not any(thread.is_alive() for thread in self._threads)

    def _serve(self) -> None:
        while self._wait_until(lambda: self.supervisor.serve_due_ns):
            self.supervisor.serve()
        self.supervisor.close()

    def _take_frames(self) -> None:
        while self._wait_until(lambda: self.supervisor.take_due_ns):
            self.supervisor.take_frame()

    def _wait_until(self, due_ns: Callable[[], float]) -> bool:
        """Wait for a time that may change meanwhile; False if the rig is to stop."""
        with self.supervisor.news:
            while not self._stopping and (pause_s := (due_ns() - time.monotonic_ns()) * 1e-9) > 0:
                self.supervisor.news.wait(min(pause_s, threading.TIMEOUT_MAX))
        return not self._stopping
