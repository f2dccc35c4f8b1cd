"""Every parser, given valid messages, damaged ones and noise: it takes them or refuses them in words."""

from __future__ import annotations

from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.found import FOUND
from tests.fuzz.target import Target
from tests.fuzz.targets import TARGETS

EXAMPLES = 60
EXTREMES = (
    b"\0",
    b"\xff",
    b"\x7f\xff\xff\xff",
    b"\x80\0\0\0",
    b"\xff\xff\xff\xff",
    b"\xff" * 8,
    b"9" * 400,
    b"[" * 3000,
)
"""What lengths, numbers and nesting should not be."""

of_each_target = pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)


@cache
def seeds(target: Target) -> tuple[bytes, ...]:
    return tuple(target.seeds())


@st.composite
def damaged(draw: st.DrawFn, whole: bytes) -> bytes:
    """A valid message with a few pieces overwritten, put in, taken out or doubled."""
    data = whole
    for _ in range(draw(st.integers(0, 4))):
        start = draw(st.integers(0, len(data)))
        stop = min(start + draw(st.sampled_from([0, 1, 2, 4, 8, 100])), len(data))
        piece = draw(st.sampled_from([*EXTREMES, b"", 2 * data[start:stop]]) | st.binary(max_size=8))
        data = data[:start] + piece + data[stop:]
    return data


@of_each_target
def test_what_our_own_encoders_make_is_taken(target: Target) -> None:
    assert seeds(target)
    for seed in seeds(target):
        target.parse(seed)


@of_each_target
def test_what_once_broke_a_parser_is_taken_or_refused(target: Target) -> None:
    for data in FOUND.get(target.name, ()):
        target.check(data)


@of_each_target
@settings(max_examples=EXAMPLES, deadline=None, derandomize=True)
@given(data=st.data())
def test_damaged_messages_and_noise_are_taken_or_refused(target: Target, data: st.DataObject) -> None:
    whole = data.draw(st.sampled_from((b"", *seeds(target))))
    target.check(data.draw(damaged(whole) if whole else st.binary(max_size=200)))
