"""Settings of GenICam features, as people write them: an ordered list of `Name: value`."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.config.readable import quoted

FeatureValue = bool | int | float | str

EXECUTE = "execute"
"""The value of a command."""
LONGEST_TEXT = 256

_NAME = r"[A-Za-z_]\w*"
_KEY = re.compile(rf"(?:{_NAME}\[[^\[\]\s]+\]\.)*{_NAME}")
_SELECTION = re.compile(rf"({_NAME})\[([^\[\]\s]+)\]\.")


@dataclass(frozen=True, slots=True)
class FeatureSetting:
    """What one feature is set to, for the given entries of its selectors (name and entry, outermost first)."""

    name: str
    value: FeatureValue
    selectors: tuple[tuple[str, str], ...] = ()

    @property
    def key(self) -> str:
        """As it is written: `LineSelector[Line2].LineInverter`."""
        return "".join(f"{selector}[{entry}]." for selector, entry in self.selectors) + self.name

    def entry(self, selector: str) -> str | None:
        """The entry of a selector that it is for; None if it does not name that selector."""
        return dict(self.selectors).get(selector)


def parse_features(content: object) -> tuple[FeatureSetting, ...]:
    """The settings in a YAML list; raises ValueError, in one sentence, for anything else."""
    if not isinstance(content, list):
        raise ValueError("is not a list: begin each line with a dash, `- Name: value`, as the order counts")
    return tuple(_parsed(f"item {number}", item) for number, item in enumerate(content, 1))


def as_list(features: Iterable[FeatureSetting]) -> list[dict[str, FeatureValue]]:
    """The list that `parse_features` reads."""
    return [{feature.key: feature.value} for feature in features]


def _parsed(where: str, item: object) -> FeatureSetting:
    if not isinstance(item, dict) or len(item) != 1:
        raise ValueError(f"{where} is not one `- Name: value`: write each feature on a line of its own, with a dash")
    ((key, value),) = item.items()
    if not isinstance(key, str) or len(key) > LONGEST_TEXT or not _KEY.fullmatch(key):
        raise ValueError(f"{where}: {quoted(str(key))} is not a feature: write `Name`, or `Selector[Entry].Name`")
    if (words := misfit(value)) is not None:
        raise ValueError(f"{where}: {key} is set to {quoted(value)}: {words}")
    name = key.rpartition(".")[2]
    return FeatureSetting(name, value, tuple(_SELECTION.findall(key)))


def misfit(value: object) -> str | None:
    """What to give instead of a value that no feature holds, or that cannot be written in a list."""
    if isinstance(value, str):
        fits = len(value) <= LONGEST_TEXT and value.isprintable()
        return None if fits else f"give at most {LONGEST_TEXT} printable characters"
    if not isinstance(value, bool | int | float):
        return "give a number, true, false, or text in quotes"
    return None if abs(value) < 1 << 64 else "give a number of at most 64 bits"  # false for NaN, too
