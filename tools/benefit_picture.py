"""What the daemon is for, in one figure: odometry on frames that cameras exposed by their own control, each for itself,
and on frames that the daemon exposed, on the same drives.

    python -m tools.benefit_picture docs/images/benefit.png    # a quarter of an hour

A machine-vision camera holds the mean of its picture at a target, within a tolerance, by exposure time before gain.
Documented are targets of 50 % (the default at Allied Vision, LUCID and IDS), 70 of 255 (LUCID, for outdoors) and 44 of
255 (the least at IDS), a tolerance of 5 % (Allied Vision) and a share of 0.68 of the way in each cycle (Basler). Each
target goes through all drives, and the one whose frames keep most features is shown. The drives are tuning rooms of the
experiment `worth`: one of each kind at medium speed, chosen before any of this was run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from autoexpose_daemon.control.policies.ids import DEFAULT_POLICY
from evaluation.drawing import COLOURS, panels, save
from evaluation.experiments.worth.odometry_judge import LUX, RoomDrive, drives
from evaluation.odometry.orb import in_house
from evaluation.odometry.tracking import EVERY
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import Entrant, Image, time_first
from evaluation.stage.oracle import Oracle, best_start
from evaluation.stage.rendering import BOTH, Stage
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName

DELAY_FRAMES = 2
TARGETS = (128 / 255, 70 / 255, 44 / 255)
TOLERANCE = 0.05
DAMPING = 0.68

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
    begins: list[int] = field(default_factory=list)  # the first pair of each drive

    def drive(self, stage: Stage, frames: int, take: Callable[[], Pair]) -> None:
        """Follow a drive from its second pair on."""
        odometry = in_house()
        self.begins.append(len(self.kept))
        for frame in range(frames):
            stage.go_to(frame)
            pair = take()
            if frame % EVERY:
                continue
            (left, _), (right, _) = (pair[camera] for camera in BOTH)
            tracked = odometry.track(left, right)
            if frame:
                self.kept.append(0 if tracked.lost else len(odometry.inliers_px))
                for camera in BOTH:
                    self.levels[camera].append(pair[camera][1].level)

    @property
    def words(self) -> str:
        """Both figures, in words."""
        lost = 100.0 * float(np.mean([kept == 0 for kept in self.kept]))
        return f"{lost:.0f} % of pairs lost, {np.mean(self.kept):.0f} features kept"


def by_cameras(course: RoomDrive, target: float, followed: Followed) -> None:
    """A drive whose cameras control themselves."""
    stage = course.stage()
    start = best_start(Oracle(stage))
    controls = {camera: CameraAuto(target, start) for camera in BOTH}

    def take() -> Pair:
        pair = {}
        for camera, control in controls.items():
            setting = control.setting
            pair[camera] = (stage.expose(camera, setting), setting)
            control.look(pair[camera][0])
        return pair

    followed.drive(stage, course.frames, take)


def by_daemon(course: RoomDrive, followed: Followed) -> None:
    """A drive under the default policy."""
    stage = course.stage()
    loop = Entrant.of(DEFAULT_POLICY, DELAY_FRAMES).enter(best_start(Oracle(stage)))

    def take() -> Pair:
        pair = loop.step(stage.take)
        return {camera: (frame.grey8(), frame.setting) for camera, frame in pair.frames.items()}

    followed.drive(stage, course.frames, take)


def courses() -> list[RoomDrive]:
    """The middle one of each kind at medium speed."""
    medium = [drive for drive in drives("tuning") if drive.speed == "medium"]
    of_kind = [[drive for drive in medium if drive.kind == kind] for kind in LUX]
    return [each[len(each) // 2] for each in of_kind]


def draw(file: Path, ours: Followed, theirs: Followed, target: float) -> None:
    """Exposure of both cameras and features kept, ours and theirs."""
    figure, (above, below) = panels(2, 1, 5.0, sharex=True)
    names = (f"cameras' own control, mean at {100 * target:.0f} %", "autoexpose-daemon")
    time_s = np.arange(len(ours.kept)) * EVERY / RATE_HZ
    for followed, name, colour in ((theirs, names[0], COLOURS[1]), (ours, names[1], COLOURS[0])):
        above.plot(time_s, followed.levels["left"], color=colour, label=f"{name}: left")
        above.plot(time_s, followed.levels["right"], color=colour, linestyle=":", label="right")
        below.plot(time_s, followed.kept, color=colour, label=f"{name}: {followed.words}")
    for axes in (above, below):
        for begin in ours.begins[1:]:
            axes.axvline(begin * EVERY / RATE_HZ, color="0.6", linewidth=0.8)
    for begin, course in zip(ours.begins, courses(), strict=True):
        below.text(begin * EVERY / RATE_HZ + 0.05, 2, f"{course.kind}, {course.lux:g} lux", fontsize=8, color="0.3")
    above.set_ylabel("exposure level E (stops)")
    below.set(
        ylabel="features shared with earlier pairs", xlabel="time (s), six drives one after the other", ylim=(0, None)
    )
    above.legend(fontsize=8, ncols=2)
    below.legend(fontsize=8, loc="upper right")
    figure.suptitle(
        f"Same drives, same noise: what odometry keeps ({datetime.now(UTC):%-d %B %Y}, simulated)", fontsize=11
    )
    save(figure, file)


def main(file: Path) -> None:
    """Run all contenders, say what each kept, and draw."""
    ours, theirs = Followed(), {target: Followed() for target in TARGETS}
    for course in courses():
        print(course.name, flush=True)
        by_daemon(course, ours)
        for target, followed in theirs.items():
            by_cameras(course, target, followed)
    print("autoexpose-daemon:", ours.words)
    for target, followed in theirs.items():
        print(f"cameras' own control, mean at {100 * target:.0f} %:", followed.words)
    best = max(theirs, key=lambda target: np.mean(theirs[target].kept))
    draw(file, ours, theirs[best], best)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
