"""Judge: matches on photographs, with every policy in closed loop, beside what no policy can know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from evaluation.experiments.experiment import Job
from evaluation.experiments.worth.contenders import CONTENDERS, Contender, medians
from evaluation.experiments.worth.matches.courses import EVERY, Film, MatchesCourse, MatchesRig
from evaluation.experiments.worth.matches.courses import courses as courses_of
from evaluation.experiments.worth.matches.courses import quick as some_of
from evaluation.experiments.worth.matches.pairs import PREPARATIONS, SeenFrame, judged, seen
from evaluation.experiments.worth.tables import FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME
from evaluation.stage.camera import LIMITS, DelayedLoop
from imaging.exposure import ExposureSetting
from imaging.frames import Frame

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
CHOICE_SEED = 0  # Noise on which bounds are chosen ..
# ... and on which they are scored, else luck wins. Policies run on the first of these: three would cost thrice.
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


def run(course: MatchesCourse, contender: Contender) -> list[dict[str, Any]]:
    """Rows of a contender, with the medians of its settings over the scored frames."""
    film = course.film()
    rig = MatchesRig(film, course.eyes, SCORING_SEEDS[0])
    loop, scorer = enter(contender, course), Scorer(course, film)
    for number in range(course.frames):
        film.go_to(number)
        scorer.look(loop.step(rig.take).frames["left"])
    return rows(course, contender.name, scorer.means(), dict.fromkeys(JUDGES, medians(scorer.settings)))


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


__all__ = ["JUDGES", "jobs_of"]


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


def measure_contender(*, course: dict[str, Any], contender: str) -> list[dict[str, Any]]:
    """Rows of one of `CONTENDERS`."""
    return run(MatchesCourse(**course), CONTENDERS[contender])
