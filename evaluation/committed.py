"""What was fixed before any scene of a report was rendered: margins, how many scenes, and their seeds.

A scene that a report has shown is a tuning scene from then on: the next report takes new seeds. These are of 27
November 2026; until then reports had rooms 101 to 106 and 200 to 223, parks 101 to 108, and paintings 2000 to 2013."""

from __future__ import annotations

# Not inferior in odometry: the geometric mean error is at most so much higher, with the whole 90 % interval.
ERROR_MARGIN = 0.10
FEATURE_MARGIN = 0.02  # Not inferior in features: at most so many fewer, with the whole 90 % interval
ROOMS = 72  # Drives through rooms with natural texture, in each set
TUNING_ROOM, REPORT_ROOM = 1000, 7000  # Their first seeds
PAINTINGS = 5  # Of each painter, in each set of the judge of matches
TUNING_PAINTING, REPORT_PAINTING = 3, 7100  # Their first seeds
TUNING_PARK, REPORT_PARK = 11, 7200  # First parks of the judge of registration
FURNISHED_ROOMS = range(7300, 7324)  # Rooms of fig7 and fig12
HELD_OUT_SEED = 7400  # First seed of the arena's held-out scenes
