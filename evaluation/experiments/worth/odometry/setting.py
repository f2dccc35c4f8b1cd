"""How the judge of odometry works, for the report; apart from what measures, so that wording changes no result."""

from __future__ import annotations

from evaluation.experiments.worth.odometry.bounds import GRID
from evaluation.experiments.worth.odometry.follower import WORST_MM

SETTING = f"""\
Odometry in rooms with natural texture: drives of 4 s through rooms of 3 x 2.4 m whose walls and cartons are covered
with pieces of the photographs, at their own resolution, as surfaces that reflect 3 to 90 %; every second one is so pale
that it spans only 1.7 stops. Light on the walls is 2 to 2000 lux: even, with a window to daylight, with lamps around
which it is brighter, or with a dark stretch of 6 stops. The path is that of fig12, at 33, 86 or 143 mm and degrees a
second at most, from rest. The rig, its sensor and its odometry are those of fig12, on frames as they are (`raw`) and
`preprocessed`. Policies run in closed loop from the best exposure of the first frame; odometry then follows the frames
taken with their settings and the noise of four repeats. `odometry-raw` and `odometry-preprocessed`: mean translation
RPE over sub-trajectories of 20 mm, in mm. A run that has lost five pairs in a row has failed and counts as
{WORST_MM:g} mm, the error of an odometry that never moves, and no sub-trajectory counts as more. `odometry-failures`:
share of runs that failed.

`fixed-in-hindsight` is the setting with the smallest error of a grid of {len(GRID)}, of 0.1 to 7.5 ms and 0 to 24 dB;
`oracle-per-frame` the one of the grid with the most stereo features that agree with the true motion since the last pair
looked at, for every second pair. Both are chosen with a fifth noise. One repeat of a drive spreads by a fifth of its
error, so the best of the grid is partly luck, and most matches need not be the smallest error: policies may do better
than either."""
