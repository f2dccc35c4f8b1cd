"""Frames of cameras whose counters and clocks are as they should be, or lie: each keeps its number and its time."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.genicam.timeline import FrameTimeline, LatchedClock, Placed, find_clock
from tests.drivers.genicam.node_map import CommandNode, IntegerNode, MemoryNodes, Node

MS = 1_000_000
SECOND = 1000 * MS
PERIOD_NS = SECOND / 60
OPENED_NS = 10**12
READOUT_NS = 5 * MS


@dataclass
class Camera:
    """A triggered camera and its host: what it says of its frames is what `counter` and `stamp` make of the truth.

    `stamp` maps the time since it was switched on (ns) to its time stamp, `latch` likewise to what it reads back; None:
    it cannot be read. Numbers of frames count from 0.
    """

    counter: Callable[[int], int] = lambda number: number + 1
    stamp: Callable[[int], int] = lambda time_ns: time_ns
    latch: Callable[[int], int] | None = lambda time_ns: time_ns
    booted_ns: int = OPENED_NS - 500 * SECOND
    configured_ns: float | None = PERIOD_NS
    placed: list[Placed] = field(default_factory=list)
    errors_ns: list[int | None] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._numbers = random.Random(1)
        self._number = 0
        self._next_ns = float(OPENED_NS + 3 * SECOND)
        self._latch_ns = OPENED_NS + SECOND
        self.timeline = FrameTimeline(self.configured_ns, self._offset_ns(OPENED_NS))

    def _offset_ns(self, now_ns: int) -> int | None:
        return None if self.latch is None else now_ns - self.latch(now_ns - self.booted_ns)

    def frame(self, late_ns: int = 0, exposure_ns: int = 4 * MS, *, lost: bool = False, ignored: bool = False) -> None:
        """The next trigger."""
        start_ns = round(self._next_ns)
        self._next_ns += PERIOD_NS
        if ignored:
            return
        counter, stamp_ns = self.counter(self._number), self.stamp(start_ns - self.booted_ns)
        self._number += 1
        while self._latch_ns < start_ns:
            offset_ns = self._offset_ns(self._latch_ns)
            if offset_ns is not None:
                self.timeline.read(offset_ns)
            self._latch_ns += SECOND
        if lost:
            return
        arrival_ns = start_ns + exposure_ns + READOUT_NS + self._numbers.randrange(MS) + late_ns
        placed = self.timeline.place(counter, stamp_ns, arrival_ns, exposure_ns)
        self.placed.append(placed)
        self.errors_ns.append(None if placed.host_time_ns is None else placed.host_time_ns - start_ns)
        if placed.clock_trouble is not None:
            self.said.append(placed.clock_trouble.sentence)

    def frames(self, count: int = 200) -> None:
        for number in range(count):
            self.frame(exposure_ns=(2 + number // 50 % 3) * MS)

    def check(self, most_ns: int = 0, unknown: int = 0, late_ns: int = 0) -> None:
        """Each frame that arrived has a number of its own; their times are right, or late by readout and transfer."""
        first = self.placed[0].frame_id
        assert [placed.frame_id - first for placed in self.placed] == list(range(len(self.placed)))
        known = [error_ns - late_ns for error_ns in self.errors_ns if error_ns is not None]
        assert len(known) == len(self.placed) - unknown
        assert max(map(abs, known)) <= most_ns


def jumps(at: int, by_ns: int) -> Callable[[int], int]:
    """A clock that jumps after so many frames."""
    jump_ns = 503 * SECOND + round((at - 0.5) * PERIOD_NS)
    return lambda time_ns: time_ns + by_ns * (time_ns > jump_ns)


@pytest.mark.parametrize(
    "counter",
    [
        lambda number: number,
        lambda number: number + 1,
        lambda number: (number + 65400) % 65535 + 1,
        lambda number: (number + 65400) % 65536,
        lambda number: number + 65400,
        lambda number: number + (1 << 40),
    ],
    ids=["from 0", "from 1", "16 bits without 0", "16 bits with 0", "64 bits", "large"],
)
def test_a_sound_camera_is_believed(counter: Callable[[int], int]) -> None:
    camera = Camera(counter)
    camera.frames()
    camera.check()
    assert [placed.device_time_ns for placed in camera.placed[1:3]] == [
        round(503 * SECOND + PERIOD_NS),
        round(503 * SECOND + 2 * PERIOD_NS),
    ]
    assert camera.said == []


@pytest.mark.parametrize(
    "stamp",
    [
        lambda time_ns: time_ns // MS * MS,
        lambda time_ns: time_ns // 8 * 8,
        lambda time_ns: time_ns + time_ns // 2000,
        lambda time_ns: time_ns - time_ns // 2000,
    ],
    ids=["resolution of 1 ms", "ticks of 8 ns", "500 ppm fast", "500 ppm slow"],
)
@pytest.mark.parametrize("latched", [True, False])
def test_coarse_and_drifting_stamps_are_believed(stamp: Callable[[int], int], latched: bool) -> None:
    camera = Camera(stamp=stamp, latch=stamp if latched else None)
    camera.frames(1200)
    camera.check(most_ns=2 * MS if latched else 6 * MS, late_ns=0 if latched else READOUT_NS)
    assert camera.said == []


@pytest.mark.parametrize(
    ("counter", "says"),
    [
        (lambda number: number % 40030 + 1 if number > 90 else number + 39930, "from 40020 to 92"),
        (lambda number: number % 100 + 1, "from 100 to 1"),
        (lambda number: number % 256, "from 255 to 0"),
        (lambda number: 70_000 + number if number < 100 else number - 99, "from 70099 to 1"),
        (lambda number: number + 3 * (number // 10), "from 9 to 13"),
        (lambda number: 0, "from 0 to 0"),
        (lambda number: 2 * number, "from 0 to 2"),
        (lambda number: 1000 - number, "from 1000 to 999"),
        (lambda number: random.Random(number).randrange(65536), "frame counter went from"),
    ],
    ids=["restart", "often", "8 bits", "32 bits", "skips", "always 0", "by two", "down", "random"],
)
@pytest.mark.parametrize("latched", [True, False])
def test_a_counter_that_time_contradicts_is_outvoted(counter: Callable[[int], int], says: str, latched: bool) -> None:
    camera = Camera(counter)
    camera.frames(300)
    camera.check()
    assert len(camera.said) == 1
    assert says in camera.said[0]


@pytest.mark.parametrize(
    "stamp",
    [
        lambda time_ns: 0,
        lambda time_ns: 77 * SECOND,
        lambda time_ns: time_ns // 1000,
        lambda time_ns: time_ns * 1000,
        lambda time_ns: time_ns // 8,
        lambda time_ns: time_ns * 8,
        lambda time_ns: 10**15 - time_ns,
        lambda time_ns: random.Random(time_ns).randrange(1 << 60),
        lambda time_ns: time_ns // SECOND * SECOND,
    ],
    ids=["zero", "still", "us", "ps", "ticks of 8", "an eighth", "backwards", "random", "seconds"],
)
@pytest.mark.parametrize("read", ["sound", "likewise", "not"])
def test_stamps_that_counter_and_arrivals_contradict_are_outvoted(stamp: Callable[[int], int], read: str) -> None:
    """From the first frame on: then only the arrival shows when a frame was taken."""
    latch = {"sound": lambda time_ns: time_ns, "likewise": stamp, "not": None}[read]
    camera = Camera(stamp=stamp, latch=latch)
    camera.frames(400)
    errors_ns = [error_ns for error_ns in camera.errors_ns[10:] if error_ns is not None]
    assert len(errors_ns) >= 388
    assert max(errors_ns) - min(errors_ns) < 3 * MS
    assert min(errors_ns) >= -2 * MS and max(errors_ns) <= READOUT_NS + 2 * MS
    assert camera.placed[-1].by_arrival == (max(errors_ns) > 3 * MS)
    assert [sentence for sentence in camera.said if "its time stamps" in sentence][-1:], camera.said
    assert len(camera.said) <= 2
    assert all(after.device_time_ns > before.device_time_ns for before, after in pairwise(camera.placed))


@pytest.mark.parametrize("at", [0, 100], ids=["from the start", "later"])
def test_stamps_that_stand_still_for_a_while(at: int) -> None:
    still_ns = 503 * SECOND + round(at * PERIOD_NS)
    camera = Camera(stamp=lambda time_ns: min(time_ns, still_ns) if time_ns < still_ns + 3 * SECOND else time_ns)
    camera.frames(600)
    camera.check(most_ns=READOUT_NS + 2 * MS if at == 0 else 2 * MS)
    assert camera.errors_ns[-120:] == [0] * 120
    assert any("stand still" in sentence for sentence in camera.said)


@pytest.mark.parametrize("by_ns", [10**9, -(10**9), 10**10, -(10**10), -17 * MS, -50 * MS, -99 * MS, 10**18])
@pytest.mark.parametrize("latched", [True, False])
def test_a_clock_that_jumps_keeps_its_frames_in_place(by_ns: int, latched: bool) -> None:
    clock = jumps(100, by_ns)
    camera = Camera(stamp=clock, latch=clock if latched else None)
    camera.frames()
    camera.check(most_ns=2 * MS, late_ns=0 if latched else READOUT_NS)
    assert len(camera.said) == (abs(by_ns) >= SECOND)
    assert all(f"its clock jumped by {by_ns * 1e-9:+.1f} s" in said for said in camera.said)


def test_a_late_frame_at_a_jump_is_not_guessed_at() -> None:
    """It may as well be that of the next trigger; the frames after it are known again."""
    clock = jumps(100, 10 * SECOND)
    camera = Camera(stamp=clock, latch=clock)
    for number in range(200):
        camera.frame(late_ns=20 * MS if number == 100 else 0)
    camera.check(most_ns=MS, unknown=1)
    assert camera.errors_ns[100] is None


def test_triggers_ignored_at_a_jump_are_noticed_by_the_arrivals() -> None:
    clock = jumps(100, -10 * SECOND)
    camera = Camera(stamp=clock, latch=clock)
    for number in range(200):
        camera.frame(ignored=number == 100)
    camera.check(most_ns=MS, unknown=4)
    assert camera.errors_ns[100:105].count(None) == 4


@pytest.mark.parametrize("tick_ns", [1.0, 8.0])
@pytest.mark.parametrize("latched", [True, False], ids=["of the clock", "of the stamps alone"])
def test_ticks_of_32_bits_are_continued(tick_ns: float, latched: bool) -> None:
    wrap_ns = round(tick_ns * 2**32)
    camera = Camera(
        stamp=lambda time_ns: time_ns % wrap_ns, latch=lambda time_ns: time_ns % wrap_ns if latched else time_ns
    )
    camera.timeline = FrameTimeline(PERIOD_NS, camera._offset_ns(OPENED_NS), tick_ns)
    camera.booted_ns = OPENED_NS - SECOND // 2
    camera.timeline.read(camera.booted_ns)
    for number in range(3000):
        camera.frame(late_ns=40 * MS * (number % 5 == 0))
    camera.check(most_ns=MS)
    (said,) = camera.said
    assert "32 bits" in said and f"every {wrap_ns * 1e-9:.1f} s" in said


@pytest.mark.parametrize(
    "latch",
    [lambda time_ns: 0, lambda time_ns: 10**18 + time_ns, lambda time_ns: time_ns // 1000, lambda time_ns: -(10**18)],
)
def test_a_reading_of_the_clock_that_stamps_and_arrivals_contradict_is_outvoted(latch: Callable[[int], int]) -> None:
    camera = Camera(latch=latch)
    camera.frames(300)
    camera.check(most_ns=2 * MS, late_ns=READOUT_NS)
    assert len(camera.said) == 1
    assert "its clock, as it is read, and the time stamps of its frames are" in camera.said[0]


@given(st.lists(st.sampled_from(["frame", "lost", "ignored", "late"]), max_size=120), st.booleans(), st.booleans())
def test_what_was_lost_is_counted_and_what_was_ignored_is_not(
    triggers: list[str], latched: bool, configured: bool
) -> None:
    """By the counter of a sound camera, however late its frames arrive."""
    camera = Camera(
        lambda number: (number + 65480) % 65535 + 1,
        latch=(lambda time_ns: time_ns) if latched else None,
        configured_ns=PERIOD_NS if configured else None,
    )
    expected, number = [], 0
    camera.frame()
    for trigger in triggers:
        camera.frame(late_ns=30 * MS * (trigger == "late"), lost=trigger == "lost", ignored=trigger == "ignored")
        number += trigger != "ignored"
        if trigger in ("frame", "late"):
            expected.append(number)
    assert [placed.frame_id - camera.placed[0].frame_id for placed in camera.placed[1:]] == expected
    assert camera.said == []
    if latched:
        assert set(camera.errors_ns) == {0}


def test_a_frame_that_arrives_after_newer_ones_keeps_its_number_and_its_time() -> None:
    camera = Camera()
    camera.frames(5)
    numbers = []
    for number in (6, 7, 10, 8, 11):
        start_ns = OPENED_NS + 3 * SECOND + round((number - 1) * PERIOD_NS)
        placed = camera.timeline.place(number, start_ns - camera.booted_ns, OPENED_NS + 3 * SECOND + number * 17 * MS)
        assert placed.host_time_ns == start_ns
        numbers.append(placed.frame_id)
    assert numbers == [6, 7, 10, 8, 11]


def test_frames_lost_of_a_camera_without_time_stamps_are_missing() -> None:
    camera = Camera(stamp=lambda time_ns: 0)
    for number in range(100):
        camera.frame(lost=number in (50, 51, 52))
    assert camera.placed[50].frame_id - camera.placed[49].frame_id == 4
    assert None not in camera.errors_ns


@pytest.mark.parametrize("pause_s", [60, 300])
@pytest.mark.parametrize("drift_ppm", [50, -50])
def test_without_a_latch_a_drift_during_a_long_pause_is_followed_at_once(drift_ppm: int, pause_s: int) -> None:
    camera = Camera(stamp=lambda time_ns: time_ns + time_ns * drift_ppm // 10**6, latch=None)
    camera.frames(100)
    camera._next_ns += pause_s * SECOND
    camera.frames(100)
    errors_ns = [error_ns for error_ns in camera.errors_ns if error_ns is not None]
    assert max(errors_ns) - min(errors_ns) < 3 * MS


def test_frames_without_time_stamps() -> None:
    """As Aravis makes them up for a camera whose tick frequency reads 0: from when the host got round to them."""
    numbers = random.Random(2)
    camera = Camera(stamp=lambda time_ns: time_ns + numbers.randrange(20 * MS), latch=None)
    camera.timeline = FrameTimeline(PERIOD_NS, None, stamped=False)
    for number in range(400):
        camera.frame(late_ns=numbers.choice((0, 0, 0, 25 * MS)), lost=number in (200, 201))
    numbers_seen = [placed.frame_id for placed in camera.placed]
    assert numbers_seen == [number for number in range(1, 401) if number not in (201, 202)]
    errors_ns = [error_ns for error_ns in camera.errors_ns[20:] if error_ns is not None]
    assert len(errors_ns) == 378
    assert max(errors_ns) - min(errors_ns) < 6 * MS
    assert camera.said == []


@dataclass
class Wire:
    """A camera whose clock is `offset_ns` behind the host's, at the end of a wire with changing delays."""

    tick_frequency_hz: int = 1_000_000_000
    offset_ns: int = 123_456_789
    host_ns: int = 10**12
    delays: random.Random = field(default_factory=lambda: random.Random(1))
    least_delay_ns: int = 50_000

    def now_ns(self) -> int:
        return self.host_ns

    def latch(self) -> None:
        self.host_ns += self._delay()
        value = self.nodes.nodes["Value"]
        assert isinstance(value, IntegerNode)
        value.value = (self.host_ns - self.offset_ns) * self.tick_frequency_hz // 10**9
        self.host_ns += self._delay()

    def _delay(self) -> int:
        return self.least_delay_ns + int(self.delays.expovariate(1 / 200_000))

    def __post_init__(self) -> None:
        self.nodes = MemoryNodes({"Latch": CommandNode(self.latch), "Value": IntegerNode(0)})


@pytest.mark.parametrize("tick_frequency_hz", [1_000_000_000, 125_000_000, 66_666_667])
def test_a_latch_maps_the_clock_to_within_its_round_trip(tick_frequency_hz: int) -> None:
    wire = Wire(tick_frequency_hz)
    clock = LatchedClock(wire.nodes, "Latch", "Value", tick_frequency_hz, wire.now_ns)
    assert clock.read() == pytest.approx(wire.offset_ns, abs=300_000)
    wire.offset_ns += 50_000_000
    assert clock.read() == pytest.approx(wire.offset_ns, abs=300_000)


def test_the_quickest_of_several_latches_is_kept() -> None:
    wire = Wire(delays=random.Random(7), least_delay_ns=0)
    clock = LatchedClock(wire.nodes, "Latch", "Value", wire.tick_frequency_hz, wire.now_ns)
    errors = [abs(clock.read() - wire.offset_ns) for _ in range(50)]
    assert sum(errors) / len(errors) < 80_000  # one latch alone errs by 100 us on average


@pytest.mark.parametrize(
    ("names", "frequency", "scale"),
    [
        (("TimestampLatch", "TimestampLatchValue"), None, 1),
        (("GevTimestampControlLatch", "GevTimestampValue"), 125_000_000, 8),
        (("GevTimestampControlLatch", "GevTimestampValue"), 0, 1),
    ],
)
def test_both_kinds_of_latch_nodes_are_found(names: tuple[str, str], frequency: int | None, scale: int) -> None:
    command, value = names
    found: dict[str, Node] = {command: CommandNode(), value: IntegerNode(1_000_000)}
    if frequency is not None:
        found["GevTimestampTickFrequency"] = IntegerNode(frequency)
    clock, limitations = find_clock(MemoryNodes(found))
    assert limitations == ()
    assert clock is not None
    earlier_ns = clock.read()
    found[value] = IntegerNode(1_000_000 + 10**12)
    assert earlier_ns - clock.read() == pytest.approx(scale * 10**12, abs=10**9)
    assert clock.tick_ns == scale


def test_a_missing_latch_is_reported() -> None:
    clock, limitations = find_clock(MemoryNodes({}))
    assert clock is None
    assert "no time stamp latch" in limitations[0]
