"""How the judge of odometry works, for the report; apart from what measures, so that wording changes no result."""

from __future__ import annotations

from evaluation.committed import ERROR_MARGIN, FEATURE_MARGIN, ROOMS
from evaluation.experiments.worth.odometry.closed_loop import LONGEST_US, TRIED_STOPS
from evaluation.experiments.worth.odometry.drives import LUX, SECONDS
from evaluation.experiments.worth.odometry.follower import WORST_MM

SETTING = f"""\
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
