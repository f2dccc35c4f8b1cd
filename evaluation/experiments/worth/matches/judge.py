"""Judge: what pairs of frames of photographs are worth to matching, with every policy, and what no policy can know."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evaluation.arrays import Flags, Floats, Floats32, Greys
from evaluation.experiments.worth.contenders import CONTENDERS, Contender, medians
from evaluation.experiments.worth.matches.courses import EVERY, Film, MatchesCourse, MatchesRig
from evaluation.experiments.worth.matches.courses import courses as courses_of
from evaluation.experiments.worth.matches.courses import quick as some_of
from evaluation.experiments.worth.matches.scenes import HEIGHT, WIDTH, Homography, TrueMotion, found_motion
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from evaluation.jobs.job import Job
from evaluation.odometry.stereo import prepared
from evaluation.stage.camera import LIMITS, DelayedLoop
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

ORB_FEATURES, SIFT_FEATURES, CORNERS = 500, 300, 300
LOWE_RATIO = 0.8  # As Lowe proposed for SIFT; common for ORB, too
INLIER_PX = 2.0  # Matches within this distance of the true motion agree with it
FEWEST_INLIERS = 20  # Fewer may agree by chance; a pair with fewer is lost
LOST_PX = 5.0  # An error that counts as lost; what is lost counts as this
# As common in visual-inertial odometry: a hundredth of the best corner's response, and corners spread out.
_CORNER_QUALITY, _CORNER_DISTANCE_PX = 0.01, 7.0
_WINDOW, _PYRAMID = (21, 21), 3  # OpenCV's defaults for Lucas and Kanade's tracker: follows 60 pixels
Image = Greys
Points = Floats32
# Frames as they are, and as the paper gives them to odometry: 3x3 median, then a gamma of 0.3.
PREPARATIONS: dict[str, Callable[[Image], Image]] = {"raw": lambda image: image, "preprocessed": prepared}
_ORB = cv2.ORB.create(ORB_FEATURES)
_SIFT = cv2.SIFT.create(SIFT_FEATURES)
# Where displacements are compared: all over the picture.
_PLACES = np.stack(np.meshgrid(np.linspace(0, WIDTH - 1, 13), np.linspace(0, HEIGHT - 1, 10)), axis=-1).reshape(-1, 2)


class SeenFrame:
    """One prepared frame with what detectors find in it, each found once."""

    def __init__(self, image: Image) -> None:
        self.image = image

    @cached_property
    def orb(self) -> tuple[Points, Greys]:
        """Positions (n, 2) and descriptors of ORB features."""
        found, descriptors = _ORB.detectAndCompute(self.image, None)
        return _points(found), np.asarray(np.empty((0, 32)) if descriptors is None else descriptors, np.uint8)

    @cached_property
    def sift(self) -> tuple[Points, Floats32]:
        """Positions (n, 2) and descriptors of SIFT features."""
        found, descriptors = _SIFT.detectAndCompute(self.image, None)
        return _points(found), np.asarray(np.empty((0, 128)) if descriptors is None else descriptors, np.float32)

    @cached_property
    def corners(self) -> Points:
        """Shi and Tomasi's corners, (n, 2)."""
        found = cv2.goodFeaturesToTrack(self.image, CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PX)
        return np.asarray(np.empty(0) if found is None else found, np.float32).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class MatchedMotion:
    """What matches say about the motion between two frames."""

    inliers: int  # matches that agree with the true motion
    # Error of the motion found by RANSAC, as the mean error of displacements over the picture, at most `LOST_PX`.
    error_px: float
    lost: bool  # too few inliers or too large an error


def orb_motion(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> MatchedMotion:
    """By ORB features, nearest neighbours and Lowe's ratio."""
    return motion(*_matched(first.orb, second.orb, cv2.NORM_HAMMING), truth)


def sift_inliers(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> int:
    """Matches of SIFT features that agree with the true motion."""
    here, there = _matched(first.sift, second.sift, cv2.NORM_L2)
    return int(_agree(here, there, truth.homography).sum())


def klt_motion(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> MatchedMotion:
    """By corners of the first frame, tracked into the second."""
    here = first.corners
    if not len(here):
        return motion(here, here, truth)
    there, status, _ = cv2.calcOpticalFlowPyrLK(
        first.image, second.image, here, np.empty_like(here), winSize=_WINDOW, maxLevel=_PYRAMID
    )
    tracked = status.ravel() == 1
    return motion(here[tracked], there[tracked], truth)


def repeatability(first: SeenFrame, second: SeenFrame, truth: TrueMotion) -> float:
    """Share of the first frame's ORB features in view of the second that are found there, too, within `INLIER_PX`."""
    there = second.orb[0]
    expected = _moved(first.orb[0], truth.homography)
    expected = expected[((expected >= 0) & (expected <= (WIDTH - 1, HEIGHT - 1))).all(axis=1)]
    if not len(expected) or not len(there):
        return 0.0
    apart = cv2.batchDistance(expected.astype(np.float32), there, cv2.CV_32F, normType=cv2.NORM_L2, K=1)[0]
    return float((apart <= INLIER_PX).mean())


def motion(here: Points, there: Points, truth: TrueMotion) -> MatchedMotion:
    """What matches (n, 2) each are worth, given the true motion."""
    inliers = int(_agree(here, there, truth.homography).sum())
    error = LOST_PX
    found = found_motion(truth.model, here.astype(np.float64), there.astype(np.float64), INLIER_PX)
    if found is not None and np.isfinite(found).all():
        apart = np.linalg.norm(_moved(_PLACES, found) - _moved(_PLACES, truth.homography), axis=1).mean()
        error = min(float(np.nan_to_num(apart, nan=LOST_PX)), LOST_PX)
    lost = inliers < FEWEST_INLIERS or error >= LOST_PX
    return MatchedMotion(inliers, LOST_PX if lost else error, lost)


def judged(
    first: Mapping[str, SeenFrame], second: Mapping[str, SeenFrame], truth: TrueMotion, *, sift: bool
) -> dict[str, float]:
    """The value of each judge for a pair, given each frame in every preparation; SIFT's only if asked for."""
    values: dict[str, float] = {}
    for name in PREPARATIONS:
        before, after = first[name], second[name]
        orb, klt = orb_motion(before, after, truth), klt_motion(before, after, truth)
        values |= {
            f"matches-orb-{name}": orb.inliers,
            f"repeatability-orb-{name}": repeatability(before, after, truth),
            f"pose-error-orb-{name}": orb.error_px,
            f"lost-pairs-orb-{name}": orb.lost,
            f"klt-error-{name}": klt.error_px,
            f"lost-pairs-klt-{name}": klt.lost,
            f"lost-pairs-{name}": (orb.lost + klt.lost) / 2,
        }
    if sift:
        values["matches-sift-raw"] = sift_inliers(first["raw"], second["raw"], truth)
    return {judge: float(value) for judge, value in values.items()}


def seen(grey: Image) -> dict[str, SeenFrame]:
    """An 8-bit frame in every preparation."""
    return {name: SeenFrame(prepare(grey)) for name, prepare in PREPARATIONS.items()}


def _points(found: Sequence[cv2.KeyPoint]) -> Points:
    return np.asarray(cv2.KeyPoint.convert(found), np.float32).reshape(-1, 2)


def _matched(
    first: tuple[Points, NDArray[Any]], second: tuple[Points, NDArray[Any]], norm: int
) -> tuple[Points, Points]:
    """Positions of clear nearest neighbours in both frames; each feature of the second is matched once."""
    (here, queries), (there, candidates) = first, second
    if not len(queries) or len(candidates) < 2:
        return here[:0], there[:0]
    kind = cv2.CV_32S if norm == cv2.NORM_HAMMING else cv2.CV_32F
    distances, nearest = cv2.batchDistance(queries, candidates, kind, normType=norm, K=2)
    clear = np.flatnonzero(distances[:, 0] < LOWE_RATIO * distances[:, 1])
    clear = clear[np.argsort(distances[clear, 0], kind="stable")]
    _, once = np.unique(nearest[clear, 0], return_index=True)
    clear = clear[once]
    return here[clear], there[nearest[clear, 0]]


def _agree(here: Points, there: Points, truth: Homography) -> Flags:
    return np.asarray(np.linalg.norm(_moved(here, truth) - there, axis=1) <= INLIER_PX)


def _moved(points: NDArray[Any], by: Homography) -> Floats:
    if not len(points):
        return np.empty((0, 2))
    return np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), by)[0], np.float64)


PAIR_JUDGES: dict[str, Literal["higher", "lower"]] = {"matches-sift-raw": "higher"}
for _name in PREPARATIONS:
    PAIR_JUDGES |= {
        f"matches-orb-{_name}": "higher", f"repeatability-orb-{_name}": "higher", f"pose-error-orb-{_name}": "lower",
        f"lost-pairs-orb-{_name}": "lower", f"klt-error-{_name}": "lower", f"lost-pairs-klt-{_name}": "lower",
        f"lost-pairs-{_name}": "lower",
    }  # fmt: skip

BAD_FRAMES = "bad-frames"  # Share of frames of which more than half is white or black
BLACK = 1  # What rounding and read noise make of no light at all
JUDGES: dict[str, Literal["higher", "lower"]] = {**PAIR_JUDGES, BAD_FRAMES: "lower"}
CHOICE_SEED = 0  # Noise on which bounds are chosen
# Noises on which bounds are scored, else luck wins. Policies run on the first of these: three would cost thrice.
SCORING_SEEDS = (1, 2, 3)
CHECKED_EVERY = 4  # Every fourth scored pair is tried with all settings of the grid, and judged by SIFT


class Scorer:
    """Judges the pairs of one camera as its frames come in. `pairs`: for each pair scored so far, the value of each
    judge that judged it. `settings`: of each frame that was looked at."""

    def __init__(self, course: MatchesCourse, film: Film) -> None:
        self.pairs: list[dict[str, float]] = []
        self.settings: list[ExposureSetting] = []
        self._scored, self._film = course.scored, film
        self._last: tuple[int, float, Mapping[str, SeenFrame]] | None = None
        self._bad: list[bool] = []

    def look(self, frame: Frame) -> None:
        """Take in the present frame of the film; one that odometry does not get is passed over."""
        number = self._film.frame
        if number not in self._scored:
            return
        self.settings.append(frame.setting)
        grey = frame.grey8()
        self._bad.append(bool(((grey <= BLACK) | (grey == 255)).mean() > 0.5))
        now = (number, frame.setting.exposure_time_us, seen(grey))
        if self._last is not None:
            truth = self._film.truth(self._last[:2], now[:2])
            sift = len(self.pairs) % CHECKED_EVERY == 0
            self.pairs.append(judged(self._last[2], now[2], truth, sift=sift))
        self._last = now

    def means(self) -> dict[str, float]:
        """Each judge's mean over the pairs that it judged, or over the frames."""
        return {**mean_values(self.pairs), BAD_FRAMES: float(np.mean(self._bad))}


def mean_values(pairs: list[dict[str, float]]) -> dict[str, float]:
    """Mean of each judge over the pairs that have its value."""
    return {judge: float(np.mean([pair[judge] for pair in pairs if judge in pair])) for judge in PAIR_JUDGES}


def rows(
    course: MatchesCourse, policy: str, means: Mapping[str, float], more: Mapping[str, Mapping[str, Any]] | None = None
) -> list[dict[str, Any]]:
    """One plain row for each judge with a mean; `more` has diagnostics by judge."""
    return [
        {"judge": judge, "course": course.name, "policy": policy, "value": means[judge], **(more or {}).get(judge, {})}
        for judge in JUDGES
        if judge in means
    ]


# Of every policy but `fixed`: sensible, and wrong by stops in most of the light here.
START = ExposureSetting(1000.0, 0.0)


def measure_contender(*, course: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`, with the medians of its settings over the scored frames."""
    given = MatchesCourse(**course)
    film = given.film()
    rig = MatchesRig(film, given.eyes, SCORING_SEEDS[0])
    loop, scorer = enter(CONTENDERS[contender], given), Scorer(given, film)
    for number in range(given.frames):
        film.go_to(number)
        scorer.look(loop.step(rig.take).frames["left"])
    return rows(given, contender, scorer.means(), dict.fromkeys(JUDGES, medians(scorer.settings)))


def enter(contender: Contender, course: MatchesCourse) -> DelayedLoop:
    """A fresh loop with the delay of a course, told the true response."""
    return DelayedLoop(contender.make_loop(course.response, LIMITS, START), course.delay_frames)


# Stops apart. 300 us blur by less than 0.2 pixels at any of our speeds, so shorter times need no more gain.
GRID = tuple(
    ExposureSetting(time_us, gain_db)
    for time_us in (75.0, 150.0, 300.0, 600.0, 1200.0, 2400.0, 4800.0, 7500.0)
    for gain_db in (0.0, 6.0, 12.0, 18.0, 24.0, 30.0)
    if time_us >= 300.0 or gain_db <= 6.0
)

Pair = dict[str, float]


def measure_bounds(*, course: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of `fixed-in-hindsight`, over all pairs of a course, and of `oracle-per-frame`, over the pairs checked. Each
    judge has its own; both are chosen by the judge's value with one noise, and scored with three others."""
    given = MatchesCourse(**course)
    film = given.film()
    firsts = given.scored[:-1][::CHECKED_EVERY]
    tried = _try_all(film, MatchesRig(film, given.eyes, CHOICE_SEED), firsts)
    fixed = {judge: best(judge, [mean_values(tried[setting]) for setting in GRID]) for judge in PAIR_JUDGES}
    by_pair = {
        judge: [best(judge, [tried[setting][place] for setting in GRID]) for place in range(len(firsts))]
        for judge in PAIR_JUDGES
    }
    rigs = [MatchesRig(film, given.eyes, seed) for seed in SCORING_SEEDS]
    fixed_values = _score_fixed(given, film, rigs, fixed)
    oracle_values = _score_pairs(film, rigs, firsts, by_pair)
    more = {
        judge: {"time_us": GRID[place].exposure_time_us, "gain_db": GRID[place].gain_db}
        for judge, place in fixed.items()
    }
    return rows(given, FIXED_IN_HINDSIGHT, fixed_values, more) + rows(given, ORACLE_PER_FRAME, oracle_values)


def best(judge: str, values: Sequence[Pair]) -> int:
    """Index of the best by a judge; where several are equal, of those the one with the most matches."""
    sign = 1.0 if PAIR_JUDGES[judge] == "higher" else -1.0
    matches = "matches-orb-" + ("raw" if judge.endswith("raw") else "preprocessed")
    return max(range(len(values)), key=lambda place: (sign * values[place][judge], values[place][matches]))


def _pair(film: Film, rig: MatchesRig, first: int, setting: ExposureSetting) -> Pair:
    """All judges on one pair taken with one setting."""
    looks = []
    for number in (first, first + EVERY):
        film.go_to(number)
        looks.append(seen(rig.expose("left", setting).grey8()))
    truth = film.truth((first, setting.exposure_time_us), (first + EVERY, setting.exposure_time_us))
    return judged(looks[0], looks[1], truth, sift=True)


def _try_all(film: Film, rig: MatchesRig, firsts: Sequence[int]) -> dict[ExposureSetting, list[Pair]]:
    tried: dict[ExposureSetting, list[Pair]] = {setting: [] for setting in GRID}
    for first in firsts:
        for setting in GRID:
            tried[setting].append(_pair(film, rig, first, setting))
    return tried


def _score_fixed(course: MatchesCourse, film: Film, rigs: Sequence[MatchesRig], chosen: dict[str, int]) -> Pair:
    """The value of each judge with the setting chosen for it, mean over the rigs."""
    scorers = {place: [Scorer(course, film) for _ in rigs] for place in set(chosen.values())}
    for number in course.scored:
        film.go_to(number)
        for place, of_rigs in scorers.items():
            for rig, scorer in zip(rigs, of_rigs, strict=True):
                scorer.look(rig.expose("left", GRID[place]))
    means = {place: [scorer.means() for scorer in of_rigs] for place, of_rigs in scorers.items()}
    return {judge: float(np.mean([one[judge] for one in means[place]])) for judge, place in chosen.items()}


def _score_pairs(film: Film, rigs: Sequence[MatchesRig], firsts: Sequence[int], chosen: dict[str, list[int]]) -> Pair:
    """The value of each judge with the settings chosen for it pair by pair, mean over the rigs."""
    totals = dict.fromkeys(PAIR_JUDGES, 0.0)
    for place, first in enumerate(firsts):
        picks = {judge: of_pairs[place] for judge, of_pairs in chosen.items()}
        for rig in rigs:
            found = {pick: _pair(film, rig, first, GRID[pick]) for pick in set(picks.values())}
            for judge, pick in picks.items():
                totals[judge] += found[pick][judge] / (len(firsts) * len(rigs))
    return totals


def jobs_of(name: str, quick: bool) -> list[Job]:
    """The jobs of the tuning or the report set: for each course its bounds, and each contender."""
    courses = some_of(courses_of(name)) if quick else courses_of(name)
    bounds = [Job(measure_bounds, {"course": course.plain()}, 33.0, ()) for course in courses]
    return [*bounds, *contender_jobs(courses, list(CONTENDERS))]


def contender_jobs(courses: Sequence[MatchesCourse], contenders: Sequence[str]) -> list[Job]:
    """One for each course and each of `CONTENDERS`: when one changes, the results of the others are still kept."""
    return [
        Job(measure_contender, {"course": course.plain(), "contender": one}, 1.5, (CONTENDERS[one].policy_id,))
        for course in courses
        for one in contenders
    ]
