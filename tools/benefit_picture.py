"""What the daemon is for, in one figure: odometry on frames that cameras exposed by their own control, each for itself,
and on frames that the daemon exposed, on the same drives.

    python -m tools.benefit_picture docs/images/benefit.png    # a quarter of an hour

A machine-vision camera holds the mean of its picture at a target, within a tolerance, by exposure time before gain.
Documented are targets of 50 % (the default at Allied Vision, LUCID and IDS), 70 of 255 (LUCID, for outdoors) and 44 of
255 (the least at IDS), a tolerance of 5 % (Allied Vision) and a share of 0.68 of the way in each cycle (Basler). Each
target goes through all drives, and the one whose frames keep most features is shown.

The first six drives are tuning rooms of the experiment `worth`, one of each kind at medium speed, chosen before any of
this was run. In them light changes by motion alone, and the best target keeps as many features as the daemon.
So a seventh was added, where the lights go off and on as in the demo; its course was fixed before it was run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.worth.odometry_judge import LUX, SEEN, drives
from evaluation.odometry.orb import in_house
from evaluation.odometry.tracking import EVERY
from evaluation.scenes.scenarios import RATE_HZ, WARM_UP_FRAMES, Course, no_turn
from evaluation.stage.camera import Entrant, Image, time_first
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import BOTH, Stage
from fake_camera.world.lighting import Change, LightScript
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName

DELAY_FRAMES = 2
TARGETS = (128 / 255, 70 / 255, 44 / 255)
TOLERANCE = 0.05
DAMPING = 0.68
LIGHTS = ((0.0, 150.0), (2.0, 1.0), (4.0, 150.0))  # from when, s, and how much, lux
SECONDS = 6.0

Pair = Mapping[CameraName, tuple[Image, ExposureSetting]]


class CameraAuto:
    """ExposureAuto and GainAuto of one camera: it decides again once its last decision shows."""

    def __init__(self, target: float, start: ExposureSetting) -> None:
        self.target, self._coming = target, [start] * DELAY_FRAMES

    @property
    def setting(self) -> ExposureSetting:
        """Of the next frame."""
        return self._coming[0]

    def look(self, image: Image) -> None:
        """At the frame that was taken with it."""
        taken = self._coming.pop(0)
        decided = self._coming[-1]
        if decided == taken:
            share = self.target / max(float(image.mean()) / 255, 1 / 255)
            if abs(share - 1.0) > TOLERANCE:
                decided = time_first(taken.level + DAMPING * float(np.log2(share)))
        self._coming.append(decided)


@dataclass
class Followed:
    """Odometry on one contender's frames, over all drives."""

    levels: dict[CameraName, list[float]] = field(default_factory=lambda: {camera: [] for camera in BOTH})
    kept: list[int] = field(default_factory=list)  # features that tie a pair to earlier ones; 0 for a lost one

    def drive(self, stage: Stage, frames: int, take: Callable[[], Pair]) -> None:
        """Follow a drive; what control does in its first half second is not scored, as in the arena."""
        odometry = in_house()
        for frame in range(frames):
            stage.go_to(frame)
            pair = take()
            if frame < WARM_UP_FRAMES or frame % EVERY:
                continue
            (left, _), (right, _) = (pair[camera] for camera in BOTH)
            tracked = odometry.track(left, right)
            if frame > WARM_UP_FRAMES:  # the first pair shares nothing with any
                self.kept.append(0 if tracked.lost else len(odometry.inliers_px))
                for camera in BOTH:
                    self.levels[camera].append(pair[camera][1].level)

    @property
    def words(self) -> str:
        """Both figures, in words."""
        lost = 100.0 * float(np.mean([kept == 0 for kept in self.kept]))
        return f"{lost:.0f} % of pairs lost, {np.mean(self.kept):.0f} features kept"


@dataclass(frozen=True)
class Drive:
    """What all contenders are taken through."""

    name: str
    make_stage: Callable[[], Stage]
    frames: int


def by_cameras(drive: Drive, target: float, followed: Followed) -> None:
    """A drive whose cameras control themselves."""
    stage = drive.make_stage()
    start = best_start(Oracle(stage))
    controls = {camera: CameraAuto(target, start) for camera in BOTH}

    def take() -> Pair:
        pair = {}
        for camera, control in controls.items():
            setting = control.setting
            pair[camera] = (stage.expose(camera, setting), setting)
            control.look(pair[camera][0])
        return pair

    followed.drive(stage, drive.frames, take)


def by_daemon(drive: Drive, followed: Followed) -> None:
    """A drive under the default policy."""
    stage = drive.make_stage()
    loop = Entrant.of(DEFAULT_POLICY, DELAY_FRAMES).enter(best_start(Oracle(stage)))

    def take() -> Pair:
        pair = loop.step(stage.take)
        return {camera: (frame.grey8(), frame.setting) for camera, frame in pair.frames.items()}

    followed.drive(stage, drive.frames, take)


def slow_light() -> list[Drive]:
    """Light changes as the robot moves: the middle one of each kind of room at medium speed."""
    medium = [drive for drive in drives("tuning") if drive.speed == "medium"]
    of_kind = [[drive for drive in medium if drive.kind == kind] for kind in LUX]
    return [Drive(each[len(each) // 2].name, each[len(each) // 2].stage, each[0].frames) for each in of_kind]


def sudden_light() -> Drive:
    """The first of these rooms, in which the lights go off and on."""
    room = next(drive for drive in drives("tuning") if (drive.speed, drive.kind) == ("medium", "plain"))
    lights = LightScript(tuple(Change(at_s, lux) for at_s, lux in LIGHTS))

    def make_stage() -> Stage:
        views = replace(room, lux=1.0).stage().views
        return Stage(views, Course(lights, no_turn, 0), room.noise_seed(SEEN))

    return Drive("lights off and on", make_stage, round(SECONDS * RATE_HZ))


def compare(courses: list[Drive]) -> tuple[Followed, dict[float, Followed]]:
    """Ours, and the cameras' own control by target."""
    ours, theirs = Followed(), {target: Followed() for target in TARGETS}
    for drive in courses:
        print(drive.name, flush=True)
        by_daemon(drive, ours)
        for target, followed in theirs.items():
            by_cameras(drive, target, followed)
    print("  autoexpose-daemon:", ours.words)
    for target, followed in theirs.items():
        print(f"  cameras' own control, mean at {100 * target:.0f} %:", followed.words, flush=True)
    return ours, theirs


def draw(file: Path, ours: Followed, theirs: Followed, target: float) -> None:
    """Exposure of both cameras and features kept, ours and theirs, as the lights go off and on."""
    figure, (above, below) = panels(2, 1, 5.0, sharex=True)
    names = (f"cameras' own control, mean at {100 * target:.0f} %", "autoexpose-daemon")
    time_s = (WARM_UP_FRAMES + EVERY * np.arange(1, len(ours.kept) + 1)) / RATE_HZ
    for followed, name, colour in ((theirs, names[0], COLOURS[1]), (ours, names[1], COLOURS[0])):
        above.plot(time_s, followed.levels["left"], color=colour, label=f"{name}: left")
        above.plot(time_s, followed.levels["right"], color=colour, linestyle=":", label="right")
        below.plot(time_s, followed.kept, color=colour, label=f"{name}: {followed.words}")
    for axes in (above, below):
        for (from_s, lux), (until_s, _) in pairwise((*LIGHTS, (SECONDS, 0.0))):
            if lux < LIGHTS[0][1]:
                axes.axvspan(from_s, until_s, color="0.9")
    above.set_ylabel("exposure level E (stops)")
    below.set(ylabel="features shared", xlabel="time (s)")
    below.set_ylim(0)
    above.legend(fontsize=8, ncols=2)
    below.legend(fontsize=8, loc="upper right", title="with earlier pairs", title_fontsize=8)
    figure.suptitle(f"Lights go off ({LIGHTS[1][1]:g} lux) and on ({LIGHTS[0][1]:g} lux): simulated", fontsize=11)
    save(figure, file)


def main(file: Path) -> None:
    """Run all contenders, say what each kept, and draw."""
    compare(slow_light())
    ours, theirs = compare([sudden_light()])
    best = max(theirs, key=lambda target: np.mean(theirs[target].kept))
    draw(file, ours, theirs[best], best)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
