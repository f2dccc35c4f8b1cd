"""The list of features as people write it."""

from __future__ import annotations

import re

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.setup import FeatureSetting, as_list, parse_features

NAMES = st.from_regex(r"[A-Za-z_]\w{0,20}", fullmatch=True)
ENTRIES = st.from_regex(r"[^\[\]\s\x00-\x1f]{1,12}", fullmatch=True).filter(str.isprintable)
NUMBERS = st.integers(-(1 << 63), (1 << 64) - 1) | st.floats(-1e18, 1e18)
VALUES = st.booleans() | NUMBERS | st.text(max_size=40).filter(str.isprintable)
SETTINGS = st.builds(FeatureSetting, NAMES, VALUES, st.lists(st.tuples(NAMES, ENTRIES), max_size=2).map(tuple))


@settings(max_examples=30, deadline=None)
@given(st.lists(SETTINGS, max_size=5).map(tuple))
def test_what_is_written_is_read(written: tuple[FeatureSetting, ...]) -> None:
    assert parse_features(yaml.safe_load(yaml.safe_dump(as_list(written), allow_unicode=True))) == written


def test_it_is_written_as_in_the_docs() -> None:
    (feature,) = parse_features(yaml.safe_load("- LineSelector[Line2].LineInverter: true"))
    assert feature == FeatureSetting("LineInverter", True, (("LineSelector", "Line2"),))
    assert feature.key == "LineSelector[Line2].LineInverter"
    assert (feature.entry("LineSelector"), feature.entry("GainSelector")) == ("Line2", None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Width: 640", "is not a list: begin each line with a dash"),
        ("- Width", "item 1 is not one `- Name: value`"),
        ("- Width: 640\n- Height: 4\n  OffsetX: 8", "item 2 is not one"),
        ("- Width height: 640", "item 1: 'Width height' is not a feature"),
        ("- 'Line[].LineInverter': 640", "is not a feature"),
        ("- UserSetLoad:", "UserSetLoad is set to None: give a number, true, false, or text in quotes"),
        ("- DeviceUserID: 2026-01-01", "in quotes"),
        ("- Gamma: .nan", "Gamma is set to nan: give a number of at most 64 bits"),
        ("- Width: 99999999999999999999999", "give a number of at most 64 bits"),
        (f"- Width: 1{'0' * 400}", "give a number of at most 64 bits"),
        ('- DeviceUserID: "a\\nb"', "printable"),
    ],
)
def test_a_mistake_is_named_with_its_place(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        parse_features(yaml.safe_load(text))
