"""Names of the bounds in tables and JSON, and who is shown without counting."""

from __future__ import annotations

FIXED_IN_HINDSIGHT = "fixed-in-hindsight"
ORACLE_PER_FRAME = "oracle-per-frame"
BOUNDS = (FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME)

NOT_COUNTED = ("fixed", *BOUNDS)
"""What knows the course, and `fixed`, which was chosen by hand for rooms like these."""
