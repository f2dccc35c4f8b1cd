"""Whether `autoexpose rejudge` ranks policies as driving with them does, and what re-exposed frames are worth.

Simulated drives are recorded in brackets and really driven by each policy."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.parameters import Bracketing, ControlParameters
from autoexpose_daemon.control.policies.ids import PLACES
from autoexpose_daemon.control.setup import ControlSetup
from evaluation.arena.race import course_of
from evaluation.experiments.experiment import Claim, Experiment, ReportSection, Results, Table
from evaluation.jobs.job import Job
from evaluation.odometry.stereo import StereoCamera
from evaluation.odometry.tracking import Light, odometry_stage
from evaluation.prose import text_beside
from evaluation.rejudge.camera import Exposer, Made, Rectifier, SeenLight
from evaluation.rejudge.contest import Figures, PairJudge, PolicyRun, Round, exposers, first_setting, play
from evaluation.rejudge.drive import Drive, watched
from evaluation.rejudge.following import IN_HOUSE, Following, ReferenceTrajectory, Trajectory
from evaluation.scenes.scenarios import RATE_HZ
from evaluation.stage.camera import LIMITS, DelayedLoop, Image, time_first
from evaluation.stage.rendering import Stage
from fake_camera.world.sensor import SensorModel
from fake_camera.world.simulation import RoomView
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, FrameSet
from imaging.geometry import SIDES, CameraGeometry
from imaging.response import ResponseFunction

DELAY_FRAMES = 2
TRUE_EVERY_S = 0.002
START = ExposureSetting(2000.0, 0.0)


@dataclass(frozen=True, slots=True)
class Compared:
    """The figures of one policy, and its levels frame by frame (stops)."""

    figures: Figures
    levels: Sequence[float]


def simulated_setup(bracketing: Bracketing) -> ControlSetup:
    """That of the simulated rig, whose noise has been calibrated."""
    sensor = SensorModel()
    parameters = ControlParameters(full_well_e=sensor.full_well_e, read_noise_e=sensor.read_noise_e, bracket=bracketing)
    responses: dict[CameraName, ResponseFunction] = dict.fromkeys(SIDES, ResponseFunction.linear())
    return ControlSetup("fixed", responses, LIMITS, START, parameters)


def record(stage: Stage, frames: int, bracketing: Bracketing) -> Drive:
    """Drive once in brackets; the pairs stay in memory."""
    setup = simulated_setup(bracketing)
    delayed = DelayedLoop(ControlLoop(setup), DELAY_FRAMES)
    pairs: list[FrameSet] = []
    times_s: list[float] = []
    for number in range(frames):
        stage.go_to(number)
        pair = delayed.step(stage.take)
        copies = {camera: replace(frame, pixels=frame.pixels.copy()) for camera, frame in pair.frames.items()}
        pairs.append(FrameSet(pair.trigger, copies))
        times_s.append(stage.start_s(number) + pair.reference.setting.exposure_time_us / 2e6)
    seen = zip(pairs, delayed.decisions, times_s, strict=True)
    return watched("rehearsal", setup, seen, lambda: iter(pairs), simulated_geometries())


def rejudged(drive: Drive, policies: Sequence[str], reference: ReferenceTrajectory | None) -> list[Compared]:
    """The policies on the recorded drive."""
    outcomes = play(Round(drive, policies, IN_HOUSE, reference, Path()))
    return [Compared(outcome.figures, outcome.levels) for outcome in outcomes]


def driven(
    stage: Stage, drive: Drive, policies: Sequence[str], reference: ReferenceTrajectory | None
) -> list[Compared]:
    """The policies on drives of their own, judged as often as the recorded one."""
    rectifier = Rectifier(drive.geometries, drive.shape)
    cycle = drive.timeline.cycle
    following = Following(IN_HOUSE, rectifier.camera, cycle / RATE_HZ, Path())
    runs = [
        PolicyRun(
            replace(drive.setup.of_policy(policy), start=first_setting(drive)),
            DELAY_FRAMES,
            PairJudge(rectifier, None if reference is None else following.begin(policy)),
            told_motion=False,
        )
        for policy in policies
    ]
    cameras = _TrueCameras(stage)
    for number in range(len(drive.timeline.glimpses)):
        stage.go_to(number)
        for run in runs:
            run.step(number, cameras, 0.0, due=number % cycle == 0)
    return [Compared(run.end(reference), run.levels) for run in runs]


def truth(stage: Stage, seconds: float) -> Trajectory:
    """Where the left camera of a room really is."""
    view = stage.views["left"]
    assert isinstance(view, RoomView)
    times_s = np.arange(0.0, seconds + 0.1, TRUE_EVERY_S)
    return Trajectory(times_s, np.array([view.pose(float(time_s)) for time_s in times_s]))


def simulated_geometries() -> dict[CameraName, CameraGeometry]:
    """Those of the simulated cameras, which are rectified and do not distort."""
    camera = StereoCamera.simulated()
    focal_px, (x, y) = camera.focal_px, camera.centre_px
    k = (focal_px, 0.0, x, 0.0, focal_px, y, 0.0, 0.0, 1.0)
    unturned = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)

    def of(baseline_m: float) -> CameraGeometry:
        p = (focal_px, 0.0, x, -focal_px * baseline_m, 0.0, focal_px, y, 0.0, 0.0, 0.0, 1.0, 0.0)
        return CameraGeometry(720, 540, "plumb_bob", (0.0,) * 5, k, unturned, p)

    return {"left": of(0.0), "right": of(camera.baseline_m)}


class _TrueCameras:
    """The cameras of a stage, at its present frame."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage

    def take(self, setting: ExposureSetting) -> Made:
        """See `Cameras`."""
        stage = self._stage
        time_s = stage.start_s(stage.frame) + setting.exposure_time_us / 2e6
        return Made(stage.take(setting), stage.frame, 0.0, 1.0, fused=True, time_s=time_s)


# Stops from the middle of the bracket at which emulated frames are compared with true ones.
OFFSETS = tuple(range(-4, 5))
APART = (0, 14, 21)  # Frames before the last at which the light is found: in cycles that share no shot
REPEATS = 12  # Frames of one exposure, whose mean tells the error from the noise


def measure_lap(*, light: Light, room: int, frames: int, policies: list[str]) -> dict[str, Any]:
    """Policies on one lap through a room, rejudged, driven, and driven again with other noise."""
    stage = odometry_stage(light, room, room, 0)
    drive = record(stage, frames, Bracketing())
    reference = ReferenceTrajectory.of(truth(stage, frames / RATE_HZ), drive.timeline.cycle_s)
    again = driven(odometry_stage(light, room, room, 1), drive, policies, reference)
    return _both(rejudged(drive, policies, reference), driven(stage, drive, policies, reference), again)


def measure_scenario(*, scenario: str, scene: str, seed: int, frames: int, policies: list[str]) -> dict[str, Any]:
    """Policies in one course of the arena, rejudged and driven; nobody follows the camera."""
    stage, _ = course_of(scenario, scene, seed)
    drive = record(stage, frames, Bracketing())
    figures = _both(rejudged(drive, policies, None), driven(stage, drive, policies, None))
    jump = next((number for number in range(1, frames) if drive.timeline.sections[number]), None)
    return figures | {"jump": jump}


def measure_still(*, scene: str, seed: int, frames: int) -> list[dict[str, float]]:
    """Frames of a still scene, emulated and true, at each of `OFFSETS`."""
    stage, _ = course_of("step_up", scene, seed)
    drive = record(stage, frames, Bracketing())
    last = max(number for number, still in enumerate(drive.timeline.still) if still)
    exposer, wanted = exposers(drive)["left"], {last - back for back in APART}
    lights = [
        exposer.fused([pair_at(shot).frames["left"] for shot in drive.timeline.around(number)])
        for number, pair_at in drive.pairs()
        if number in wanted
    ]
    middle = float(np.mean([drive.timeline.glimpses[shot].level for shot in drive.timeline.around(last)]))
    return [{"offset": float(offset), **_compared(stage, exposer, lights, middle + offset)} for offset in OFFSETS]


def _compared(stage: Stage, exposer: Exposer, lights: list[SeenLight], level: float) -> dict[str, float]:
    """Mean error of emulated frames, rms of what does not average out, their noise and that of true ones; grey levels.
    `lights` were seen at different times, so that their own noise averages out, too."""
    setting = time_first(level)
    true = np.array([_at(stage, number, setting) for number in range(100, 100 + REPEATS)], np.float64)
    made = np.array(
        [
            [exposer.expose(light, setting, 8, place * REPEATS + number) for number in range(REPEATS)]  # no noise twice
            for place, light in enumerate(lights)
        ],
        np.float64,
    )
    means, true_variance = made.mean(axis=1), float(true.var(axis=0, ddof=1).mean())
    of_light, added = float(means.var(axis=0, ddof=1).mean()), float(made.var(axis=1, ddof=1).mean())
    apart = float(((means.mean(axis=0) - true.mean(axis=0)) ** 2).mean())
    return {
        "bias": float(made.mean() - true.mean()),
        "rms": math.sqrt(max(apart - of_light / len(lights) - true_variance / REPEATS, 0.0)),
        "made_noise": math.sqrt(max(of_light - added / REPEATS, 0.0) + added),
        "noise": math.sqrt(true_variance),
    }


def _at(stage: Stage, number: int, setting: ExposureSetting) -> Image:
    stage.frame = number  # the noise of another frame of the same view
    return stage.expose("left", setting).copy()


def _both(ours: list[Compared], true: list[Compared], again: list[Compared] | None = None) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for place, (one, other) in enumerate(zip(ours, true, strict=True)):
        levels = [[round(level, 3) for level in each.levels] for each in (one, other)]
        row = {"rejudged": asdict(one.figures), "driven": asdict(other.figures), "levels": levels}
        found[one.figures.policy] = row if again is None else {**row, "again": asdict(again[place].figures)}
    return found


POLICIES = tuple(PLACES)  # All: so many are alike in the error of odometry that a few of them rank by luck

LAPS: Sequence[tuple[Light, int]] = (
    ("uneven", 301), ("uneven", 302), ("uneven", 303), ("low", 304), ("low", 305), ("faint", 306),
)  # fmt: skip
SCENARIOS = ("step_up", "step_down", "tunnel", "pan", "sun_shadow", "lowlight_fast")
SCENE, SEED = "street", 310
STILL_SCENES = ("leaves", "street", "room")
FIGURES = {"metric": "M_g", "saturated_share": "saturated share", "matches": "matches", "rpe_mm": "RPE (mm)"}
WANTED_RANKING = 0.9
WANTED_RMS_GREY = 1.0
WANTED_FRAMES = 1.0
SETTLED_STOPS = 0.25  # A policy has settled when it stays this close to the level at which it ends


def jobs(quick: bool) -> list[Job]:
    """One for each course, with all policies."""
    policies = ["neves2009", "begin2022-code"] if quick else list(POLICIES)

    def job(measure: Any, seconds: float, arguments: dict[str, Any]) -> Job:
        frames = round(seconds * RATE_HZ)
        given = {**arguments, "frames": frames, "policies": policies}
        return Job(measure, given, cost_s=4.0 * seconds * len(policies), policies=tuple(policies))

    laps, scenarios, scenes = (LAPS[:1], SCENARIOS[:1], STILL_SCENES[:1]) if quick else (LAPS, SCENARIOS, STILL_SCENES)
    return [
        *(job(measure_lap, 1.0 if quick else 7.0, {"light": light, "room": room}) for light, room in laps),
        *(
            job(measure_scenario, 1.0 if quick else 3.0, {"scenario": scenario, "scene": SCENE, "seed": SEED})
            for scenario in scenarios
        ),
        *(Job(measure_still, {"scene": scene, "seed": SEED, "frames": 28}, 5.0, policies=()) for scene in scenes),
    ]


def section(results: Results, _folder: Path) -> ReportSection:
    """Judge rankings, settling and frames."""
    courses = [(_name(case), one) for case, one in results if "policies" in case]
    stills = {str(case["scene"]): one for case, one in results if "policies" not in case}
    rankings = {figure: found for figure in FIGURES if (found := _ranking(courses, figure)) is not None}
    settled = [frames for name, one in courses if name.startswith("step") for frames in _settling(one)]
    worst_rms = max(row["rms"] for rows in stills.values() for row in rows)
    claims = [
        *(_ranks(figure, ranking, courses) for figure, ranking in rankings.items()),
        _settles(settled),
        Claim.of_this_project(
            "frames of still scenes, four stops either side of the bracket's middle, are off by at most 1 grey level "
            "rms beyond noise",
            f"{worst_rms:.2f} grey levels at worst",
            holds=worst_rms <= WANTED_RMS_GREY,
        ),
    ]
    return ReportSection(
        text_beside(__file__), claims, [*(_table(courses, figure) for figure in rankings), _still_table(stills)]
    )


def _ranks(figure: str, ranking: tuple[float, list[float]], courses: Sequence[tuple[str, Any]]) -> Claim:
    over_all, each = ranking
    repeated = _ranking(courses, figure, ("again", "driven"))
    repeats = "" if repeated is None else f"; laps driven twice: {repeated[0]:.2f} of {len(repeated[1])}"
    return Claim.of_this_project(
        f"by {FIGURES[figure]}, policies on the recording rank as on drives of their own",
        f"Spearman {over_all:.2f} for the means of {len(each)} courses; course by course "
        f"{np.median(each):.2f} in the median, {min(each):.2f} at worst{repeats}",
        holds=over_all >= WANTED_RANKING,
    )


def _settles(settled: Sequence[tuple[int, int]]) -> Claim:
    apart = np.array([abs(ours - true) for ours, true in settled] or [0])
    return Claim.of_this_project(
        "after a jump of the light, a policy settles within a frame of when it does on a drive of its own",
        f"{np.mean(apart <= WANTED_FRAMES):.0%} of {len(settled)} runs within one frame, "
        f"{np.median(apart):.0f} frames apart in the median, {apart.max():.0f} at worst",
        holds=bool(np.all(apart <= WANTED_FRAMES)),
    )


def _settling(course: Mapping[str, Any]) -> list[tuple[int, int]]:
    """For each policy, after how many frames it settles on the recording and on its own drive."""
    return [
        (_settled(one["levels"][0], course["jump"]), _settled(one["levels"][1], course["jump"]))
        for name, one in course.items()
        if name != "jump"
    ]


def _settled(levels: Sequence[float], jump: int) -> int:
    """Frames after a jump from which on a level stays where it ends."""
    off = np.abs(np.array(levels[jump:]) - levels[-1]) > SETTLED_STOPS
    return int(np.flatnonzero(off)[-1] + 1) if off.any() else 0


Kinds = tuple[str, str]


def _ranking(
    courses: Sequence[tuple[str, Any]], figure: str, kinds: Kinds = ("rejudged", "driven")
) -> tuple[float, list[float]] | None:
    """Spearman's correlation for the means over the courses that know a figure, and of each of these courses."""
    pairs = [both for _, one in courses if (both := _values(one, figure, kinds)) is not None]
    if not pairs:
        return None
    means = np.mean(pairs, axis=0)
    return _spearman(*means), [_spearman(*both) for both in pairs]


def _values(
    course: Mapping[str, Any], figure: str, kinds: Kinds = ("rejudged", "driven")
) -> tuple[list[float], list[float]] | None:
    """Of all policies, of two kinds; None where one of them is not known."""
    policies = [one for name, one in course.items() if name != "jump"]
    both: list[list[Any]] = [[one.get(kind, {}).get(figure) for one in policies] for kind in kinds]
    return None if any(value is None for values in both for value in values) else (both[0], both[1])


def _spearman(ours: Sequence[float], true: Sequence[float]) -> float:
    if min(np.ptp(ours), np.ptp(true)) == 0:
        return 0.0  # nothing is ranked
    return float(np.corrcoef(rankdata(np.round(ours, 6)), rankdata(np.round(true, 6)))[0, 1])


def _name(case: Mapping[str, Any]) -> str:
    return f"{case['light']}, room {case['room']}" if "light" in case else f"{case['scenario']}, {case['scene']}"


def _table(courses: Sequence[tuple[str, Any]], figure: str) -> Table:
    known = [(name, both) for name, one in courses if (both := _values(one, figure)) is not None]
    policies = [name for name in courses[0][1] if name != "jump"]
    digits = {"metric": 3, "saturated_share": 2, "matches": 0, "rpe_mm": 2}[figure]
    rows = [
        [f"`{policy}`", *(f"{both[0][place]:.{digits}f} / {both[1][place]:.{digits}f}" for _, both in known)]
        for place, policy in enumerate(policies)
    ]
    caption = f"{FIGURES[figure]}: on the recording / on a drive of its own."
    return Table(caption, ["policy", *(name for name, _ in known)], rows)


def _still_table(stills: Mapping[str, Any]) -> Table:
    rows = [
        [f"{scene}, {row['offset']:+.0f}", *(f"{row[key]:.2f}" for key in ("bias", "rms", "made_noise", "noise"))]
        for scene, found in stills.items()
        for row in found
    ]
    heads = ["scene, stops from the middle", "mean error", "rms beyond noise", "noise", "noise of true frames"]
    return Table("Re-exposed frames of still scenes against true ones, in grey levels.", heads, rows)


EXPERIMENT = Experiment(
    "rejudge", "Brackets: policies judged on a recording, and on drives of their own", jobs, section
)
