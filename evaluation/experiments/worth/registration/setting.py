"""How the judge of registration works, for the report; apart from what measures, so that wording changes no result."""

from __future__ import annotations

SETTING = """\
Registration: the robot, the parks and the method of `teach` (ORB features of the top half of the image, a vote on the
shift), in other parks, with a stretch of 10 maps and 80 images in each. The path is taught early in the afternoon and
replayed late in the afternoon under a clear or overcast sky, or after sunset. `registration-own`: share of images
registered within 5 pixels of the truth with the map that the policy taught itself; `registration-foreign`: with the map
that `majer2018-standard` taught. `saturated-share`: of the pixels, under a clear sky. Policies start from the
operator's exposure, a mean of one half, which `fixed` keeps: that of a room would be white.

Bounds are chosen from exposures one stop apart, with one noise, and scored with two others: `fixed-in-hindsight` has
the most right registrations with one setting for teaching and replay; `oracle-per-frame` the most votes, map by map and
image by image. They have no saturated share, for which the darkest setting would be best."""
