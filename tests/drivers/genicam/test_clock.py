from __future__ import annotations

import random
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.exposure import ExposureSetting
from drivers.frames import Frame
from drivers.genicam.clock import ArrivalClock, JumpWatch, LatchedClock, find_clock
from tests.drivers.genicam.node_map import CommandNode, IntegerNode, MemoryNodes, Node

LATER_NS = 1 << 62
"""An arrival that casts no doubt on any time stamp."""


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
    assert clock.host_time_ns(5_000_000_000, LATER_NS) == pytest.approx(5_000_000_000 + wire.offset_ns, abs=300_000)


def test_the_quickest_of_several_latches_is_kept() -> None:
    wire = Wire(delays=random.Random(7), least_delay_ns=0)
    errors = []
    for _ in range(50):
        clock = LatchedClock(wire.nodes, "Latch", "Value", wire.tick_frequency_hz, wire.now_ns)
        errors.append(abs(clock.host_time_ns(0, LATER_NS) - wire.offset_ns))
    assert sum(errors) / len(errors) < 80_000  # one latch alone errs by 100 us on average


def test_latching_again_follows_a_drifting_clock() -> None:
    wire = Wire()
    clock = LatchedClock(wire.nodes, "Latch", "Value", wire.tick_frequency_hz, wire.now_ns)
    wire.offset_ns += 50_000_000
    clock.latch()
    assert clock.host_time_ns(0, LATER_NS) == pytest.approx(wire.offset_ns, abs=300_000)


@given(st.lists(st.integers(0, 10**8), min_size=1, max_size=50), st.integers(-(10**15), 10**15))
def test_without_a_latch_host_times_are_late_by_the_shortest_delay_so_far(delays_ns: list[int], offset_ns: int) -> None:
    clock = ArrivalClock()
    for frame, delay_ns in enumerate(delays_ns):
        device_ns = frame * 16_666_667
        true_ns = device_ns + offset_ns
        host_ns = clock.host_time_ns(device_ns, true_ns + delay_ns)
        assert host_ns == true_ns + min(delays_ns[: frame + 1])


@pytest.mark.parametrize("drift_ppm", [50, -50])
def test_without_a_latch_a_drift_during_a_long_pause_is_followed_at_once(drift_ppm: int) -> None:
    wire = Wire()
    clock = ArrivalClock()
    errors_ns = []
    for number in range(200):
        passed_ns = 300 * 10**9 if number == 100 else 16_666_667
        wire.host_ns += passed_ns
        wire.offset_ns += passed_ns * drift_ppm // 10**6
        arrival_ns = wire.host_ns + 9_000_000 + wire.delays.randrange(2_000_000)
        errors_ns.append(clock.host_time_ns(wire.host_ns - wire.offset_ns, arrival_ns) - wire.host_ns)
    assert max(errors_ns) - min(errors_ns) < 3_000_000


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
    nodes = MemoryNodes(found)
    earlier, limitations = find_clock(nodes)
    found[value] = IntegerNode(1_000_000 + 10**12)
    later, _ = find_clock(nodes)
    assert limitations == ()
    moved_ns = earlier.host_time_ns(0, LATER_NS) - later.host_time_ns(0, LATER_NS)
    assert moved_ns == pytest.approx(scale * 10**12, abs=10**9)


def test_a_missing_latch_is_reported() -> None:
    clock, limitations = find_clock(MemoryNodes({}))
    assert isinstance(clock, ArrivalClock)
    assert limitations == ("no time stamp latch: host times are inferred from arrival, late by the shortest delay",)


@pytest.mark.parametrize("jump_ns", [10**9, -(10**9), 10**10, -(10**10)])
@pytest.mark.parametrize("latched", [True, False])
def test_a_clock_that_jumps_keeps_its_frames_in_place(jump_ns: int, latched: bool) -> None:
    wire = Wire(offset_ns=-(10**11))
    clock = LatchedClock(wire.nodes, "Latch", "Value", 10**9, wire.now_ns) if latched else ArrivalClock()
    errors_ns: list[int | None] = []
    for number in range(200):
        if number == 50:
            wire.offset_ns -= jump_ns
        if number in (20, 120):
            clock.latch()
        wire.host_ns += 16_666_667
        late_ns = 20_000_000 if number in (50, 60) else wire.delays.randrange(2_000_000)
        true_ns, arrival_ns = wire.host_ns, wire.host_ns + 9_000_000 + late_ns
        host_ns = clock.host_time_ns(true_ns - wire.offset_ns, arrival_ns)
        errors_ns.append(None if host_ns is None else host_ns - true_ns)
    unknown = [number for number, error_ns in enumerate(errors_ns) if error_ns is None]
    assert unknown == ([50, 51, 52, 53] if latched else [])
    known = [error_ns for number, error_ns in enumerate(errors_ns) if error_ns is not None and number != 50]
    assert max(known) - min(known) < 5_000_000
    if latched:
        assert max(map(abs, known[-80:])) < 300_000


@pytest.mark.parametrize("jump_ns", [-17_000_000, -50_000_000, -99_000_000])
@pytest.mark.parametrize("latched", [True, False])
def test_a_small_jump_back_keeps_its_frames_in_place(jump_ns: int, latched: bool) -> None:
    """Without a latch the frames before it would be compared for 10 s; with one, until the next latch."""
    wire = Wire(offset_ns=-(10**11))
    clock = LatchedClock(wire.nodes, "Latch", "Value", 10**9, wire.now_ns) if latched else ArrivalClock()
    errors_ns = []
    for number in range(60):
        if number == 20:
            wire.offset_ns -= jump_ns
        wire.host_ns += 16_666_667
        host_ns = clock.host_time_ns(wire.host_ns - wire.offset_ns, wire.host_ns + 9_000_000)
        errors_ns.append(None if host_ns is None else host_ns - wire.host_ns)
    assert [number for number, error_ns in enumerate(errors_ns) if error_ns is None] == [20, 21, 22, 23] * latched
    known = [error_ns for error_ns in errors_ns if error_ns is not None]
    assert max(known) - min(known) < 1_000_000


@pytest.mark.parametrize("latched", [True, False])
def test_a_frame_that_arrives_after_newer_ones_is_no_jump(latched: bool) -> None:
    wire = Wire()
    clock = LatchedClock(wire.nodes, "Latch", "Value", 10**9, wire.now_ns) if latched else ArrivalClock()
    errors_ns = []
    for number in (1, 2, 3, 6, 4, 7, 8):
        true_ns = 10**12 + number * 16_666_667
        arrival_ns = true_ns + (60_000_000 if number == 4 else 9_000_000)
        host_ns = clock.host_time_ns(true_ns - wire.offset_ns, arrival_ns, in_order=number != 4)
        assert host_ns is not None
        errors_ns.append(host_ns - true_ns)
    assert max(errors_ns) == min(errors_ns)


def test_a_jump_is_reported_once_and_a_returning_camera_has_not_jumped() -> None:
    watch = JumpWatch()

    def jumps(device_ns: int, count: int = 3) -> list[float]:
        setting = ExposureSetting(1000.0, 0.0)
        pixels = np.zeros((2, 2), np.uint8)
        return [watch.frame("left", Frame(pixels, 8, n, device_ns + n, n, n, setting)) for n in range(count)]

    assert jumps(5 * 10**9) == [0, 0, 0]
    assert jumps(15 * 10**9) == [10.0, 0, 0]
    assert jumps(14 * 10**9) == [-1.0, 0, 0]
    watch.gone("left")
    assert jumps(0) == [0, 0, 0]
