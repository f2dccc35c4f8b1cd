"""The experiment: all judges on the same contenders, and their section of the report."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, Literal

from evaluation.committed import ERROR_MARGIN, FEATURE_MARGIN, ROOMS
from evaluation.experiments.experiment import Experiment, Figure, Job, Plain, Results, Section, Table
from evaluation.experiments.worth import odometry_judge, registration_judge
from evaluation.experiments.worth.contenders import LEARNED, OURS, PUBLISHED
from evaluation.experiments.worth.matches import judge as matches_judge
from evaluation.experiments.worth.matches.tables import (
    courses_of,
    matches_tables,
    plot_worst,
    worst_courses,
    worst_table,
)
from evaluation.experiments.worth.odometry_drives import LUX, SECONDS
from evaluation.experiments.worth.odometry_judge import LONGEST_US, TRIED_STOPS, WORST_MM
from evaluation.experiments.worth.tables import NOT_COUNTED, Verdicts, claims_tables, means_tables, plot_gains

ODOMETRY_SETTING = f"""\
Odometry in rooms with natural texture: {ROOMS} drives of {SECONDS:g} s, each through a room of its own of 3 x 2.4 m
whose walls and cartons are covered with pieces of the photographs, at their own resolution, as surfaces that reflect 3
to 90 %; every second one is so pale that it spans only 1.7 stops. There are {len(LUX)} kinds of rooms, each at three
speeds: evenly lit, dimly lit (1 to 8 lux), with a side that is five stops brighter, with a window to daylight, with
lamps around which it is brighter, or with a dark stretch of 6 stops; what is special comes into view within the drive.
The light is 1 to 2000 lux. Everyone drives through every fourth room of a kind, the default and its closest rivals
through all. The path is that of fig12, at 33, 86 or 143 mm and degrees a second at most, from rest. The
rig, its sensor and its odometry are those of fig12, on frames as they are (`raw`) and `preprocessed`. Policies run in
closed loop from the best exposure of the first frame; odometry then follows the frames taken with their settings and
other noise.

`odometry-raw` and `odometry-preprocessed`: mean translation RPE over sub-trajectories of 20 mm, in mm, of which none
counts as more than {WORST_MM:g} mm, the error of an odometry that never moves. Policies are compared room by room, by
the logarithm of the ratio of their errors. A run that has lost five pairs in a row has failed: it has no error
(`--json` lists {WORST_MM:g} mm and `failed`), and counts in `odometry-failures`, the share of runs that failed. Not
inferior: worse by less than {ERROR_MARGIN:.0%}, in features {FEATURE_MARGIN:.0%}, with the whole 90 % interval.
Margins, numbers and seeds were fixed before any room was seen.

`fixed-in-hindsight` is the setting with the smallest error of {len(TRIED_STOPS)}, {TRIED_STOPS[1] - TRIED_STOPS[0]:g}
stops apart, of at most {LONGEST_US / 1e3:g} ms where gain suffices, chosen with a third noise for each preparation. It
is shown, and counts for nothing."""


REGISTRATION_SETTING = """\
Registration: the robot, the parks and the method of `teach` (ORB features of the top half of the image, a vote on the
shift), in other parks, with a stretch of 10 maps and 80 images in each. The path is taught early in the afternoon and
replayed late in the afternoon under a clear or overcast sky, or after sunset. `registration-own`: share of images
registered within 5 pixels of the truth with the map that the policy taught itself; `registration-foreign`: with the map
that `majer2018-standard` taught. `saturated-share`: of the pixels, under a clear sky. Policies start from the
operator's exposure, a mean of one half, which `fixed` keeps: that of a room would be white.

Bounds are chosen from exposures one stop apart, with one noise, and scored with two others: `fixed-in-hindsight` has
the most right registrations with one setting for teaching and replay; `oracle-per-frame` the most votes, map by map and
image by image. They have no saturated share, for which the darkest setting would be best."""


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
