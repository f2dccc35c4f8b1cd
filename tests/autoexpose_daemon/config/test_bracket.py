from __future__ import annotations

import math

import pytest

from autoexpose_daemon.config.document import Config
from autoexpose_daemon.config.load import bracketed
from autoexpose_daemon.control.parameters import Bracketing
from imaging.errors import ConfigurationError

PLAIN = Config.model_validate({"cameras": {"left": {"serial": "A"}}})
OWN = Config.model_validate({"cameras": {"left": {"serial": "A"}}, "control": {"bracket": {"exposures": 4}}})


def test_options_say_how_a_drive_is_bracketed() -> None:
    assert bracketed(PLAIN, False, None, None, False) is PLAIN
    for config, given, wanted in (
        (PLAIN, (None, None, False), Bracketing()),
        (PLAIN, (5, "1:32", True), Bracketing(5, 5.0, True)),
        (OWN, (None, "1:100.5", False), Bracketing(4, math.log2(100.5))),
    ):
        assert bracketed(config, True, *given).control.parameters().bracket == wanted


def test_the_file_itself_may_ask_for_brackets() -> None:
    assert OWN.control.parameters().bracket == Bracketing(4)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((True, 1, None, False), "--bracket: exposures: 1 is out of bounds: give 2 to 12"),
        ((True, None, "64", False), "--range 64 is no range: give 1:N, as in 1:64"),
        ((True, None, "1:1", False), "--range 1:1 is no range"),
        ((True, None, "1:999999999", False), "--bracket: range_stops"),
        ((False, 5, None, False), "--exposures, --range and --keep are for brackets: add --bracket"),
        ((False, None, None, True), "add --bracket"),
    ],
)
def test_options_that_make_no_sense_are_refused(given: tuple[bool, int | None, str | None, bool], words: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        bracketed(PLAIN, *given)
    assert words in str(caught.value)
