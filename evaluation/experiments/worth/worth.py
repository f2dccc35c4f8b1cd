"""The experiment: all judges on the same contenders, and their section of the report."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

from evaluation.experiments.experiment import Experiment, Figure, Job, Plain, Results, Section, Table
from evaluation.experiments.worth import matches_judge, odometry_judge, registration_judge
from evaluation.experiments.worth.contenders import LEARNED, OURS, PUBLISHED
from evaluation.experiments.worth.matches.groups import courses_of, matches_tables
from evaluation.experiments.worth.matches.worst import plot_worst, worst_courses, worst_table
from evaluation.experiments.worth.names import NOT_COUNTED
from evaluation.experiments.worth.odometry.setting import SETTING as ODOMETRY_SETTING
from evaluation.experiments.worth.registration.setting import SETTING as REGISTRATION_SETTING
from evaluation.experiments.worth.tables import Verdicts, claims_tables, means_tables, plot_gains

_MODULES = (matches_judge, odometry_judge, registration_judge)

BETTER: dict[str, Literal["higher", "lower"]] = {
    judge: better for module in _MODULES for judge, better in module.JUDGES.items()
}


def verdicts_of(results: Results) -> Verdicts:
    """What all judges found."""

    def rows() -> Iterator[dict[str, Any]]:
        for _, found in results:
            yield from found

    return Verdicts(rows(), BETTER)


def section(results: Results, folder: Path, *, name: str = "worth") -> Section:
    """Whether the default is inferior to anyone, the means of all, and where it loses most."""
    verdicts = verdicts_of(results)
    plot_gains(verdicts, folder / f"{name}.png")
    figure = Figure(
        f"{name}.png",
        "How much better than the default each policy is, with 95 % intervals over pictures, rooms or parks: green "
        "where the whole interval is above 0, orange where it is below.",
    )
    worst = worst_courses(results, verdicts)
    plot_worst(worst, results, folder / f"{name}_worst.png")
    rivals = [one.name for one in (*PUBLISHED, *LEARNED) if one.name not in NOT_COUNTED]
    ours = [one.name for one in OURS]
    parts: list[Table | Figure] = [
        *claims_tables(verdicts, rivals),
        figure,
        *means_tables(verdicts),
        *matches_tables(results, verdicts, rivals, ours),
        worst_table(worst, verdicts),
        Figure(f"{name}_worst.png", "Frames of these courses: number, exposure time and gain."),
    ]
    settings = [_SETTING, ODOMETRY_SETTING, REGISTRATION_SETTING, _pictures(results)]
    return Section("\n\n".join(settings), [], parts)


def data(results: Results) -> Plain:
    """For `--json`: every policy on the same courses of a judge."""
    return verdicts_of(results).plain()


def _pictures(results: Results) -> str:
    """Which pictures were used."""
    names = dict.fromkeys(course.scene for course in courses_of(results).values())
    photographs = [name.rpartition("/")[2].removesuffix(".hdr") for name in names if ":" not in name]
    painted = [name for name in names if ":" in name]
    return (
        f"Photographs: {', '.join(photographs) or 'none found'}. Painted stills (painter:seed): {', '.join(painted)}."
    )


_SETTING = """\
Judges decide between policies; none of them is what a policy maximises, and all contenders get the same courses.
Odometry decides first, then features and lost pairs.

Matches on photographs: pictures with true radiance (stills on a plane, panoramas all around, and painted stills) before
a camera of 360x270 pixels whose motion is known, so that the true mapping between two frames is a homography. Sensor,
noise and motion blur are those of the fake cameras. Image speeds are 0.5, 3 and 10 of these pixels per 1/60 s: 1, 6 and
20 of a frame of 720x540; control sees speeds in pixels of the frames that it is given. Light is steady at 2 to 2000
lux, or steps by 100x. Each still is also panned, from one side to the other, and each picture is seen in 5 lux while
the camera turns by 67 degrees a second. Policies run in closed loop at 60 Hz from 1 ms and 0 dB (`fixed`: 3 ms and 6
dB, chosen by hand in a room), with the true response; a decision applies two frames later. Half a second is not scored.
Every second frame goes to the judges, as it is (`raw`), and after a 3x3 median and a gamma of 0.3 (`preprocessed`).
`matches`: matches within 2 pixels of the true motion, of 500 ORB or 300 SIFT features. `pose-error` and `klt-error`:
error of the motion found by RANSAC from ORB matches or from tracked corners, as the mean error of displacements over
the picture in pixels. A pair is lost with fewer than 20 such matches or an error of 5 pixels, and counts as 5 pixels;
`lost-pairs` is the mean of ORB's and KLT's. `bad-frames`: share of frames of which more than half is white or black.

`fixed-in-hindsight` is the best of a grid of fixed times and gains for the course, for each judge apart;
`oracle-per-frame` the best for each pair, over every fourth pair. Both are chosen with one noise and scored with three
others; policies run on the first of these. The grid is coarse and the choice rests on other noise and fewer pairs, so
a policy may do better than either."""


def jobs(quick: bool) -> list[Job]:
    """The jobs of all judges, on the scenes of the report; a quick run, which anyone may make, opens none of them."""
    return tuning_jobs(quick) if quick else [job for module in _MODULES for job in module.jobs_of("report", quick)]


def tuning_jobs(quick: bool) -> list[Job]:
    """The same on the scenes that may be tuned on."""
    return [job for module in _MODULES for job in module.jobs_of("tuning", quick)]


EXPERIMENT = Experiment("worth", "What a frame is worth to localization: judges of all policies", jobs, section, data)

TUNING = Experiment(
    "worth-tuning",
    "The same judges on the scenes that may be tuned on",
    tuning_jobs,
    partial(section, name="worth-tuning"),
    data,
    in_all=False,
)
