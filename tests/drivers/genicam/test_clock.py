from __future__ import annotations

import random
from dataclasses import dataclass, field

import pytest

from drivers.genicam.timeline import LatchedClock, find_clock
from tests.drivers.genicam.node_map import CommandNode, IntegerNode, MemoryNodes, Node


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
