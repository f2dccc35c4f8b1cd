"""Requests to control, and the options of brackets: what is one, and what is refused in a sentence."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import bracketed
from autoexpose_daemon.config.request import LARGEST_REQUEST_BYTES, new_request, read_request
from autoexpose_daemon.control.parameters import Bracketing
from imaging.errors import ConfigurationError


def test_a_request_is_read_as_it_was_sent() -> None:
    request = new_request(
        {
            "by": "user@robot",
            "locked": False,
            "ev_stops": -0.5,
            "limits": {"max_gain_db": 12},
            "region": {"right": {"rectangles": [{"box": (1, 2, 30, 40)}]}},
            "shot": {"exposure_time_us": 500},
        }
    )
    assert read_request(request.to_json().encode()) == request
    assert request.words == "unlock, EV -0.5, limits max_gain_db 12, region right (rectangles: 1), shot 500 us, 0 dB"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "invalid JSON: EOF"),
        ("[1]", "input should be an object"),
        ("{}", "by: is missing"),
        ('{"by": " x"}', "by: ' x' is not a valid name"),
        ('{"by": "x", "lock": true}', "lock: unknown key; did you mean locked?"),
        ('{"by": "x", "locked": 1}', "locked: is 1: input should be a valid boolean"),
        ('{"by": "x", "ev_stops": NaN}', "ev_stops: nan is out of bounds: give -3 to 3 stops"),
        ('{"by": "x", "policy": "believe"}', "policy: there is no policy 'believe'; did you mean belief?"),
        ('{"by": "x", "limits": {}}', "limits: no limit is named"),
        ('{"by": "x", "limits": {"max_time_us": 1e9}}', "limits.max_time_us: 1000000000.0 is out of bounds"),
        ('{"by": "x", "region": {}}', "region: no camera is named: give "),
        ('{"by": "x", "region": {"left": {"mask": "/etc/shadow"}}}', "region.left.mask: unknown key"),
        ('{"by": "x", "shot": {"gain_db": 1}}', "shot.exposure_time_us: is missing"),
    ],
)
def test_what_is_no_request_is_refused_in_a_sentence(text: str, why: str) -> None:
    with pytest.raises(ConfigurationError, match="^" + re.escape(why)):
        read_request(text.encode())


def test_a_sentence_is_short_and_printable_whatever_was_sent() -> None:
    with pytest.raises(ConfigurationError) as refused:
        read_request(b'{"by": "x", "policy": "\\u001b[2J' + 30_000 * b"y" + b'"}')
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 500
    with pytest.raises(ConfigurationError, match="a request of 32769 bytes: give at most 32768"):
        read_request(bytes(LARGEST_REQUEST_BYTES + 1))


@given(st.binary(max_size=300))
def test_any_bytes_are_a_request_or_refused(data: bytes) -> None:
    try:
        read_request(data)
    except ConfigurationError:
        return


def test_a_policy_that_is_no_longer_here_is_replaced_and_named(caplog: pytest.LogCaptureFixture) -> None:
    assert read_request(b'{"by": "x", "policy": "fisher-map"}').policy == "belief"
    (said,) = caplog.messages
    assert said.startswith("policy: ") and "fisher-map" in said and "belief" in said


PLAIN = Config.model_validate({"cameras": {"left": {"serial": "A"}}})
OWN = Config.model_validate({"cameras": {"left": {"serial": "A"}}, "control": {"bracket": {"exposures": 4}}})


def test_options_say_how_a_drive_is_bracketed() -> None:
    assert bracketed(PLAIN, False, None, None, False) is PLAIN
    for config, options, wanted in (
        (PLAIN, (None, None, False), Bracketing()),
        (PLAIN, (5, "1:32", True), Bracketing(5, 5.0, True)),
        (OWN, (None, "1:100.5", False), Bracketing(4, math.log2(100.5))),
    ):
        assert bracketed(config, True, *options).control.parameters().bracket == wanted


def test_the_file_itself_may_ask_for_brackets() -> None:
    assert OWN.control.parameters().bracket == Bracketing(4)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((True, 1, None, False), "--bracket: exposures: 1 is out of bounds: give 2 to 12"),
        ((True, None, "64", False), "--range 64 is no range: give 1:N, as in 1:64"),
        ((True, None, "1:1", False), "--range 1:1 is no range"),
        ((True, None, "1:999999999", False), "--bracket: range_stops"),
        ((False, 5, None, False), "--exposures, --range and --keep are for brackets: add --bracket"),
        ((False, None, None, True), "add --bracket"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: tuple[bool, int | None, str | None, bool], words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        bracketed(PLAIN, *options)
    assert words in str(caught.value)
