"""The table of policies by id. It loads none of them: a command line knows their ids without loading numpy."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any, Final

from documents.text import quoted
from imaging.errors import ConfigurationError

REMOVED: Final[Mapping[str, Mapping[str, str]]] = {
    "policy": {"metric-map": "belief", "fisher-map": "belief"},
    "motion": {"dis": "tiles"},
}
"""By key of the configuration: names, and what takes their place."""


DEFAULT_POLICY = "belief"

PLACES = {
    "fixed": "published.mean.Fixed",
    "neves2009": "published.mean.Neves2009",
    "lu2010": "published.lu2010.Lu2010",
    "zhang2017": "published.zhang2017.Zhang2017",
    "shim2018": "published.gamma.Shim2018",
    "kim2018": "published.kim2018.Kim2018",
    "shin2019": "published.shin2019.Shin2019",
    "mehta2020": "published.gamma.Mehta2020",
    "mehta2020-code": "published.as_coded.Mehta2020Code",
    "begin2022": "published.begin2022.Begin2022",
    "begin2022-code": "published.as_coded.Begin2022Code",
    "majer2018-standard": "published.mean.Majer2018",
    "majer2018-full": "published.mean.Majer2018",
    "majer2018-fixed": "published.mean.Fixed",
    "berthold2013": "learned.policies.Berthold2013",
    "tomasi2021": "learned.policies.Tomasi2021",
    "zhang2024": "learned.policies.Zhang2024",
    DEFAULT_POLICY: "belief.policy.Belief",
}
"""Where the class of each policy is, below this package."""

POLICY_IDS = tuple(PLACES)

PREDICTING = ("begin2022", "begin2022-code")
"""Those that go by the metric as it is predicted at other exposures."""

LEARNED = tuple(policy_id for policy_id, place in PLACES.items() if place.startswith("learned."))
"""Those with weights that `autoexpose train` makes."""

GROUP = "autoexpose.policies"
"""The group of entry points by which other packages bring policies."""

OWN: dict[str, type[Any]] = {}
"""The classes of policies that other packages bring, by id: `own_policy.installed` enters them."""

UNFIT: dict[str, str] = {}
"""By id what is wrong with those that cannot be used, a sentence."""


def policy_ids() -> tuple[str, ...]:
    """All that can be chosen here: those of the table, and then those of other packages."""
    return (*POLICY_IDS, *OWN)


def check_policy_id(policy_id: str) -> None:
    """Raise a ConfigurationError for an id that does not exist, or whose policy cannot be used."""
    if policy_id in policy_ids():
        return
    if policy_id in UNFIT:
        raise ConfigurationError(UNFIT[policy_id])
    if policy_id in REMOVED["policy"]:
        hint = f"{REMOVED['policy'][policy_id]} took the place of {policy_id}; "
    else:
        near = difflib.get_close_matches(policy_id, policy_ids(), n=1)
        hint = f"did you mean {near[0]}? " if near else "install the package that brings it, or "
    raise ConfigurationError(f"there is no policy {quoted(policy_id)}; {hint}choose one of {', '.join(policy_ids())}")
