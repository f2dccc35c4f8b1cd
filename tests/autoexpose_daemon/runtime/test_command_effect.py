"""From the decision on a setting to the first exposure with it, on made-up frames."""

from __future__ import annotations

import numpy as np

from autoexpose_daemon.runtime.command_effect import CommandToEffect
from drivers.exposure import ExposureSetting
from drivers.frames import Frame, SettingSource

PERIOD_NS = 16_666_667


def at(exposure_time_us: float, gain_db: float = 0.0) -> ExposureSetting:
    return ExposureSetting(exposure_time_us, gain_db)


def frame(time_ns: int, setting: ExposureSetting, source: SettingSource = "chunk") -> Frame:
    return Frame(np.zeros((1, 1), np.uint8), 8, 0, time_ns, time_ns, time_ns, setting, source)


def test_it_takes_until_the_first_frame_with_the_setting() -> None:
    effects = CommandToEffect(("left", "right"))
    assert effects.shown("left", frame(0, at(1000))) is None
    effects.commanded(at(2000), 10)
    assert effects.shown("left", frame(PERIOD_NS, at(1000))) is None
    assert effects.shown("left", frame(2 * PERIOD_NS, at(2001))) == 2 * PERIOD_NS - 10
    assert effects.shown("left", frame(3 * PERIOD_NS, at(2001))) is None
    assert effects.shown("right", frame(3 * PERIOD_NS, at(1999))) == 3 * PERIOD_NS - 10


def test_a_ramp_of_small_steps_shows_the_delay_of_each() -> None:
    effects = CommandToEffect(("left",))
    delays = []
    for number in range(20):  # each frame shows what was decided two frames before; a step is 0.3 %
        delays.append(effects.shown("left", frame(number * PERIOD_NS, at(1000 + 3 * max(number - 2, 0)))))
        effects.commanded(at(1000 + 3 * (number + 1)), number * PERIOD_NS + 1)
    assert delays[:3] == [None, None, None]
    assert set(delays[3:]) == {3 * PERIOD_NS - 1}


def test_a_setting_that_a_newer_one_overtook_is_not_taken_for_it() -> None:
    effects = CommandToEffect(("left",))
    effects.shown("left", frame(0, at(1000)))
    effects.commanded(at(1005), 1)
    effects.commanded(at(1008), 2)
    assert effects.shown("left", frame(PERIOD_NS, at(1008))) == PERIOD_NS - 2
    assert effects.shown("left", frame(2 * PERIOD_NS, at(1005))) is None


def test_an_exposure_begun_before_the_decision_does_not_show_it() -> None:
    effects = CommandToEffect(("left",))
    effects.commanded(at(1000), PERIOD_NS)
    assert effects.shown("left", frame(PERIOD_NS - 1, at(1000))) is None


def test_nothing_is_concluded_from_a_guess_nor_after_a_loss() -> None:
    effects = CommandToEffect(("left",))
    effects.commanded(at(2000), 0)
    assert effects.shown("left", frame(PERIOD_NS, at(2000), "ledger")) is None
    effects.gone("left")
    assert effects.shown("left", frame(2 * PERIOD_NS, at(2000))) is None
