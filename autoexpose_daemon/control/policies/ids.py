"""The names of the policies, apart from the policies: a command line knows them before it loads what decides."""

from __future__ import annotations

import difflib

from drivers.errors import ConfigurationError

DEFAULT_POLICY = "metric-map"

POLICY_IDS = (
    "fixed",
    "neves2009",
    "lu2010",
    "zhang2017",
    "shim2018",
    "kim2018",
    "shin2019",
    "mehta2020",
    "begin2022",
    "majer2018-standard",
    "majer2018-full",
    "majer2018-fixed",
    DEFAULT_POLICY,
)
"""Every policy there is."""


def check_policy_id(policy_id: str) -> None:
    """Raise a ConfigurationError for an id that does not exist."""
    if policy_id not in POLICY_IDS:
        near = difflib.get_close_matches(policy_id, POLICY_IDS, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigurationError(f"there is no policy {policy_id!r}; {hint}choose one of {', '.join(POLICY_IDS)}")
