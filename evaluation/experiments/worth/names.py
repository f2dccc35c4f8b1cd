"""Names of the bounds in tables and JSON."""

from __future__ import annotations

FIXED_IN_HINDSIGHT = "fixed-in-hindsight"
ORACLE_PER_FRAME = "oracle-per-frame"
BOUNDS = (FIXED_IN_HINDSIGHT, ORACLE_PER_FRAME)
