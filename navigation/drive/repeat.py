"""`autoexpose repeat`: drive a taught path again, or without `--drive` only show how to."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass

import numpy as np

from autoexpose_daemon.client import ReceivedPair, StereoClient
from autoexpose_daemon.client.status_client import StatusClient
from autoexpose_daemon.control.policies.ids import REMOVED
from autoexpose_daemon.messages.inputs import RegisteredView
from autoexpose_daemon.publish.session import Endpoints
from navigation.drive.repetition import PathView, Repetition, Stop
from navigation.drive.robot import Progress, Robot, Source, newest_pair
from navigation.maps.adaptation import Passing, Strategy, best
from navigation.maps.path import STANDSTILL, LightMemory, LightTrail, Velocity
from navigation.maps.temporal import MODELS
from navigation.store import MapDrive, MapError, MapFile, newest_of_hour
from navigation.views.features import FINDERS

NEAR_END_M = 1.0
"""A drive that came this near to the end of the path saw its light."""


@dataclass(slots=True)
class RepeatTally:
    """Counts of a repetition: frames, those that were registered, and why it ended."""

    frames: int = 0
    registered: int = 0
    stop: Stop | None = None
    distance_m: float = 0.0


class Repeater:
    """Repeats the path of a writable map file, which remembers what it saw.

    With one of `MODELS` to `predict`, only the features of a local map that it foretells for now are looked for. Raises
    MapError when the map has nothing to repeat; in all methods, when it cannot be written.
    """

    def __init__(self, file: MapFile, strategy: Strategy, predict: str | None = None) -> None:
        self.tally = RepeatTally()
        self._file = file
        places, path = file.places(), file.taught_path()
        if not places:
            raise MapError(f"{file.path} has no local maps: teach it again")
        if not path.forward_m_s.any():
            raise MapError(f"{file.path} has no speeds to drive at: teach it again, with the right --velocity")
        finder = FINDERS[file.info.detector]()
        now_s = time.time()
        sought = None if predict is None else [best(MODELS[predict](file.history(place))(now_s)) for place in places]
        self.repetition = Repetition(file.info, path, places, finder, strategy, sought=sought)
        self.light = self._remembered_light()
        # On a drive that gets the light of an earlier one, exposures lead the light, and would lead it more each time.
        self._trail = LightTrail() if self.light is None else None
        self._run: MapDrive | None = None
        self._start_m: float | None = None

    def look(self, pair: ReceivedPair, driven_m: float) -> PathView:
        """Register a frame; raises MapError if it has another size than the map's pictures."""
        image, info = pair.left.grey8(), self._file.info
        if image.shape != (info.height, info.width):
            raise MapError(
                f"{self._file.path} was taught with {info.width}x{info.height} pixels, and frames have "
                f"{image.shape[1]}x{image.shape[0]}: set the cameras as they were, or teach it again"
            )
        if self._run is None:
            self._run = self._file.begin_run("repeat", time.time())
            self._start_m = driven_m
        self._remember(self.repetition.look(image, self.from_start_m(driven_m), time.monotonic_ns()))
        view = self.repetition.view
        assert view is not None
        if self._trail is not None:
            self._trail.see(view.distance_m, pair.left, pair.responses[pair.stereo.reference_camera])
        self.tally.frames += 1
        self.tally.registered += view.shift_px is not None
        return view

    def misfit(self, policy: str) -> str:
        """A warning if the daemon exposes by another policy than was taught with: then places show other features."""
        taught = self._file.info.policy
        if taught in ("", policy):
            return ""
        gone = ", which is no longer here" if taught in REMOVED["policy"] else ""
        return f"taught with {taught}{gone}, while the daemon exposes by {policy}"

    def end(self) -> None:
        """At the end of the path: remember the last local map, too, and the light up to there."""
        self._remember(self.repetition.end())
        if self._trail is not None and self._run is not None:
            self._file.add_light(self._run, self._trail.new_rows(ended=True))

    def _remember(self, passed: tuple[int, Passing] | None) -> None:
        if passed is not None and self._run is not None:
            index, passing = passed
            places = self.repetition.places
            light = [] if self._trail is None else self._trail.new_rows()
            places[index] = self._file.pass_place(self._run, places[index], passing, time.time(), light)

    def _remembered_light(self) -> LightMemory | None:
        """The light of the newest drive at this time of day that reached the end of the path."""
        reaches_m, end_m = self._file.light_reaches_m(), self.repetition.places[-1].distance_m
        complete = [run for run in self._file.runs() if reaches_m.get(run.number, -math.inf) > end_m - NEAR_END_M]
        run = newest_of_hour(complete, time.time())
        return None if run is None else LightMemory.of(self._file.light(run))

    def from_start_m(self, driven_m: float) -> float:
        """How far the robot has driven since its first frame, at the start of the path."""
        return 0.0 if self._start_m is None else driven_m - self._start_m


def repeat(repeater: Repeater, source: Source, stop: threading.Event, progress: Progress) -> str:
    """Repeat until the end of the path, or until `stop` is set; returns how it went, in words.

    The robot is commanded if `source.robot.command` names a key, and is told to stand still however this ends. Raises
    MapError when the map cannot be written, or frames have another size than its pictures.
    """
    drives = bool(source.robot.command)
    tally, repetition = repeater.tally, repeater.repetition
    repetition.obeyed = drives
    compared = False
    with (
        StatusClient(source.rig, source.connect) as status,
        Robot(source.robot, Endpoints(connect=source.robot_connect)) as robot,
        StereoClient(source.rig, source.connect, name="repeat", normalised=True, cameras=source.cameras) as client,
        progress,
    ):
        try:
            while not stop.is_set() and tally.stop is not Stop.END:
                pair = newest_pair(client)
                view = (
                    None
                    if pair is None or robot.odometry_ns is None
                    else repeater.look(pair, robot.odometer.distance_m)
                )
                driven_m = repeater.from_start_m(robot.odometer.distance_m)
                velocity, tally.stop = repetition.velocity(driven_m, robot.odometry_ns, time.monotonic_ns())
                tally.distance_m = driven_m + repetition.correction_m
                if drives:
                    robot.command(velocity)
                if not compared and status.status is not None:
                    compared = True
                    progress.warn(repeater.misfit(status.status.policy))
                if repeater.light and (ahead := repeater.light.series(tally.distance_m, robot.speed_m_s)):
                    client.send_light_ahead(ahead)
                if pair is not None and view is not None:
                    client.send_registration(_registered(pair, view, repetition, velocity, tally.stop))
                progress.say(robot.trouble or _line(tally, repetition.length_m, view or repetition.view, velocity))
        finally:
            if drives:
                robot.command(STANDSTILL)
    if tally.stop is Stop.END:
        repeater.end()
    share = f"{tally.registered} of {tally.frames} frames registered"
    return f"repeated {tally.distance_m:.1f} of {repetition.length_m:.1f} m, {share}"


def _line(tally: RepeatTally, length_m: float, view: PathView | None, velocity: Velocity) -> str:
    where = f"{tally.distance_m:.1f} of {length_m:.1f} m"
    if view is None:
        return f"{where}, stopped: {tally.stop}" if tally.stop else f"{where}, waiting for frames"
    vote = view.registration.vote
    aside = "not registered" if view.shift_px is None else f"shifted {view.shift_px:+.0f} px"
    matches = f"{vote.votes} of {len(view.registration.matches)} matches agree"
    speed = f"{velocity.forward_m_s:.2f} m/s, {velocity.turn_rad_s:+.2f} rad/s"
    drive = f"stopped: {tally.stop}" if tally.stop else speed
    return f"{where}, {aside}, {matches}, {drive}"


def _registered(
    pair: ReceivedPair, view: PathView, repetition: Repetition, velocity: Velocity, stop: Stop | None
) -> RegisteredView:
    registration = view.registration
    x_px, y_px = view.features.positions[registration.matches[:, 1]].T.astype(np.float32)
    return RegisteredView(
        pair.stamp_ns, pair.stereo.reference_camera, view.distance_m, repetition.length_m, view.place, view.shift_px,
        x_px, y_px, registration.shifts_px.astype(np.float32), registration.vote.correct,
        velocity.forward_m_s, velocity.turn_rad_s, str(stop or ""),
    )  # fmt: skip
