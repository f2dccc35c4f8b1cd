"""Which command and which write made a frame, on made-up ones."""

from __future__ import annotations

import numpy as np

from drivers.rig.events import Written
from drivers.triggers.writes import Command, WriteHistory
from imaging.exposure import ExposureSetting
from imaging.frames import Frame, SettingSource

PERIOD_NS = 16_666_667


def at(exposure_time_us: float, gain_db: float = 0.0) -> ExposureSetting:
    return ExposureSetting(exposure_time_us, gain_db)


def frame(time_ns: int, setting: ExposureSetting, source: SettingSource = "chunk") -> Frame:
    return Frame(np.zeros((1, 1), np.uint8), 8, 0, time_ns, time_ns, time_ns, setting, source)


def decided(setting: ExposureSetting, decided_ns: int, arrival_ns: int = 0) -> Command:
    return Command(id(setting), setting, arrival_ns, decided_ns, due_ns=decided_ns)


def written(asked: ExposureSetting, time_ns: int, read_back: ExposureSetting | None = None) -> Written:
    return Written("left", asked, read_back or asked, time_ns - 1, time_ns, command=id(asked))


def test_the_delay_lasts_until_the_first_frame_with_the_setting() -> None:
    history, other = WriteHistory(), WriteHistory()
    assert history.first_effect_ns(frame(0, at(1000))) is None
    history.command(decided(at(2000), 10))
    other.command(decided(at(2000), 10))
    assert history.first_effect_ns(frame(PERIOD_NS, at(1000))) is None
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(2001))) == 2 * PERIOD_NS - 10
    assert history.first_effect_ns(frame(3 * PERIOD_NS, at(2001))) is None
    assert other.first_effect_ns(frame(3 * PERIOD_NS, at(1999))) == 3 * PERIOD_NS - 10


def test_a_ramp_of_small_steps_shows_the_delay_of_each() -> None:
    history = WriteHistory()
    delays = []
    for number in range(20):  # each frame shows what was decided two frames before; a step is 0.3 %
        delays.append(history.first_effect_ns(frame(number * PERIOD_NS, at(1000 + 3 * max(number - 2, 0)))))
        history.command(decided(at(1000 + 3 * (number + 1)), number * PERIOD_NS + 1))
    assert delays[:3] == [None, None, None]
    assert set(delays[3:]) == {3 * PERIOD_NS - 1}


def test_an_overtaken_setting_is_not_mistaken_for_an_effect() -> None:
    history = WriteHistory()
    history.first_effect_ns(frame(0, at(1000)))
    history.command(decided(at(1005), 1))
    history.command(decided(at(1008), 2))
    assert history.first_effect_ns(frame(PERIOD_NS, at(1008))) == PERIOD_NS - 2
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(1005))) is None


def test_an_inferred_setting_or_a_loss_gives_no_delay() -> None:
    history = WriteHistory()
    history.command(decided(at(1000), PERIOD_NS))
    assert history.first_effect_ns(frame(PERIOD_NS - 1, at(1000))) is None  # it began before the decision
    history.command(decided(at(2000), 0))
    assert history.first_effect_ns(frame(PERIOD_NS, at(2000), "ledger")) is None
    history.gone()
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(2000))) is None


def test_a_write_belongs_to_the_command_that_asked_for_it() -> None:
    history, first, newer = WriteHistory(), decided(at(1000), 15), decided(at(2000), 31)
    assert history.write(written(at(500), 1)) is None  # when the camera was opened
    history.command(first)
    history.command(newer)
    assert history.write(written(first.setting, 34)) is first
    assert history.write(written(newer.setting, 35)) is newer
    assert history.write(written(newer.setting, 36)) is None
    history, replaced = WriteHistory(), decided(at(1000), 15)
    history.command(replaced)
    history.command(newer)
    assert history.write(written(newer.setting, 32)) is newer
    assert history.write(written(replaced.setting, 40)) is None  # it never was
    history.command(replaced)
    history.gone()
    assert history.write(written(replaced.setting, 8000)) is None


def test_what_the_nodes_held_is_known_from_the_last_write_before() -> None:
    history = WriteHistory()
    assert history.held_since(5) is None
    for time_ns, time_us in ((10, 1000), (20, 2000), (30, 3000)):
        history.write(written(at(time_us), time_ns))
    assert history.held_since(9) is None  # from then to the first write they may have held anything
    assert history.held_since(25) == [at(3000), at(2000)]
    assert history.held_since(30) == [at(3000)]
    history.forget_certainty()
    assert history.held_since(40) is None
    history.write(written(at(4000), 50))
    assert history.held_since(45) is None
    assert history.held_since(55) == [at(4000)]


def test_what_a_camera_made_of_a_command_is_found_by_its_number() -> None:
    history, asked = WriteHistory(), at(1000)
    history.write(Written("left", asked, at(900), 9, 10, command=5))
    assert history.read_back(5) == at(900)
    assert history.read_back(4) is None
    assert history.has_held(at(900)) and not history.has_held(asked)
    assert history.written == [5]


def test_an_overtaken_command_does_not_claim_the_effects_of_later_equal_ones() -> None:
    history = WriteHistory()
    history.first_effect_ns(frame(0, at(1000)))
    history.command(decided(at(3000), 1))
    assert history.first_effect_ns(frame(PERIOD_NS, at(3000))) == PERIOD_NS - 1
    for setting in (at(2000), at(3000)):  # no frame is exposed between the writes
        history.command(decided(setting, PERIOD_NS + 1))
    assert history.first_effect_ns(frame(2 * PERIOD_NS, at(3000))) is None
    for number in range(90, 100):  # a second later, back and forth
        history.command(decided(at(2000 if number % 2 else 3000), number * PERIOD_NS + 1))
        delay_ns = history.first_effect_ns(frame((number + 1) * PERIOD_NS, at(2000 if number % 2 else 3000)))
        assert delay_ns == (None if number == 90 else PERIOD_NS - 1)


def test_a_slow_camera_shows_the_older_of_equal_commands() -> None:
    history = WriteHistory()
    settings = [at(1000), at(2000), at(4000), *[at(1000), at(2000)] * 5]
    delays = []
    for number in range(len(settings)):  # each frame shows what was decided four frames before
        delays.append(history.first_effect_ns(frame(number * PERIOD_NS, settings[max(number - 4, 0)])))
        history.command(decided(settings[number], number * PERIOD_NS + 1))
    assert delays[5:] == [4 * PERIOD_NS - 1] * 8
