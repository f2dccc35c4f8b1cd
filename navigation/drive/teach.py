"""`autoexpose teach`: remember a path while someone drives the robot along it."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.publish.session import Endpoints
from navigation.drive.robot import Progress, Robot, Source, newest_pair
from navigation.maps.path import Lesson, LightTrail, Velocity
from navigation.store import MapDrive, MapError, MapFile, MapInfo
from navigation.views.features import FINDERS

_SILENT_S = 0.5
"""Cameras may be slower than `newest_pair` waits: only without a frame for this long is one missing."""


class Teacher:
    """Writes a lesson to a new map file, which begins with the first frame after the first odometry.

    Raises MapError when the file exists; in all methods, when it cannot be written.
    """

    def __init__(self, path: Path, focal_length_px: float, detector: str) -> None:
        if path.exists():
            raise MapError(f"{path} exists: a lesson is not added to a map, name a new file")
        self.places = 0
        self._path, self._focal_length_px, self._detector = path, focal_length_px, detector
        self._lesson = Lesson(FINDERS[detector]())
        self._trail = LightTrail()
        self._file: MapFile | None = None
        self._run: MapDrive | None = None
        self._start_m = 0.0
        self._turn = threading.Lock()

    @property
    def driven(self) -> bool:
        """Whether the velocity that the robot is driven with has been heard."""
        return self._lesson.velocity is not None

    def drive(self, velocity: Velocity, distance_m: float) -> None:
        """Note that the robot was commanded to drive like this; called on the thread of its connection."""
        with self._turn:
            self._lesson.drive(velocity, max(distance_m - self._start_m, 0.0))

    def look(self, pair: ReceivedPair, distance_m: float, policy: str) -> None:
        """Take the next frame, and how far the robot has driven."""
        image = pair.left.grey8()
        if self._file is None or self._run is None:
            height, width = image.shape
            focal_length_px = self._focal_length_px * width / pair.left.pixels.shape[1]  # a mosaic is seen at half size
            self._file = MapFile(self._path, MapInfo(width, height, focal_length_px, self._detector, policy))
            self._run = self._file.begin_run("teach", time.time())
            with self._turn:
                self._start_m = distance_m
                self._lesson.begin()
        self._trail.see(distance_m - self._start_m, pair.left, pair.responses[pair.stereo.reference_camera])
        taught = self._lesson.look(image, pair.left.setting, distance_m - self._start_m)
        if taught is not None:
            with self._turn:
                speeds = self._lesson.new_speeds()
            self._file.add_place(self._run, taught, speeds, self._trail.new_rows())
            self.places += 1

    def end(self, distance_m: float) -> float:
        """Close the map; returns the length of the path (m), 0 if none was begun."""
        if self._file is None or self._run is None:
            return 0.0
        with self._turn:
            speeds = self._lesson.new_speeds()  # the last of them may have come after `distance_m` was read
            length_m = max([distance_m - self._start_m, *(driven_m for driven_m, _, _ in speeds)])
            self._lesson.drive(Velocity(0.0, 0.0), length_m)
            self._file.add_speeds([*speeds, *self._lesson.new_speeds(), (length_m, 0.0, 0.0)])
        self._file.add_light(self._run, self._trail.new_rows(ended=True))
        self._file.close()
        return length_m


def teach(teacher: Teacher, source: Source, stop: threading.Event, progress: Progress) -> str:
    """Teach until `stop` is set; returns what was taught, in words.

    Raises MapError when the map cannot be written, or nothing can repeat it, since no velocity arrived.
    """
    with (
        StatusClient(source.rig, source.connect) as status,
        Robot(source.robot, Endpoints(connect=source.robot_connect), teacher.drive) as robot,
        StereoClient(source.rig, source.connect, name="teach", normalised=True, cameras=source.cameras) as client,
        progress,
    ):
        frame_s = -math.inf
        try:
            while not stop.is_set():
                pair = newest_pair(client)
                frame_s = frame_s if pair is None else time.monotonic()
                if robot.odometry_ns is None:
                    progress.say(robot.trouble or f"waiting for odometry under {source.robot.odometry}")
                elif status.status is None or time.monotonic() - frame_s > _SILENT_S:
                    trouble = f": {status.trouble}" if status.trouble else ""
                    progress.say(f"waiting for frames and status of {source.rig}{trouble}")
                elif pair is not None:
                    way_m = robot.odometer.distance_m
                    teacher.look(pair, way_m, status.status.policy)
                    progress.say(f"{way_m:.1f} m driven, {teacher.places} local maps{_missing(robot, teacher)}")
        finally:
            driven = teacher.driven  # the end is a velocity, too
            length_m = teacher.end(robot.odometer.distance_m)
    if not teacher.places:
        return "nothing was taught: no frame arrived together with odometry"
    taught = f"taught {length_m:.1f} m, {teacher.places} local maps"
    if not driven:
        raise MapError(f"{taught}, but no velocity arrived under {source.robot.velocity}, so nothing can repeat it")
    if robot.odometer.jumps:
        return f"{taught}; odometry began again elsewhere {robot.odometer.jumps} times, and the way to there is missing"
    return taught


def _missing(robot: Robot, teacher: Teacher) -> str:
    """What should arrive and does not, as a clause; empty: nothing."""
    if robot.silent:
        return "; no odometry for half a second"
    return "" if teacher.driven else "; no velocity so far, without which nothing can repeat the path"
