"""Names that configurations, requests, maps and recordings may contain, of what is no longer here."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

REMOVED: Final[Mapping[str, Mapping[str, str]]] = {
    "policy": {"metric-map": "belief", "fisher-map": "belief"},
    "motion": {"dis": "tiles"},
}
"""By key of the configuration: names, and what takes their place."""
