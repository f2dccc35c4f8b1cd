"""The setting that a frame was taken with: from its chunks, or from when it was written."""

from __future__ import annotations

import random

import pytest

from drivers.genicam.metadata import ChunkNodes, SettingLedger, WriteLatency, enable_chunks
from drivers.setup import FeatureValue
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting
from tests.drivers.genicam.node_map import BooleanNode, EnumerationNode, FloatNode, IntegerNode, MemoryNodes, Node

PERIOD_NS = 16_666_667


def test_the_ledger_gives_the_setting_last_written_before_the_frame() -> None:
    first, second, third = (ExposureSetting(1000.0 * number, 0.0) for number in range(1, 4))
    ledger = SettingLedger(first)
    ledger.record(100, second)
    ledger.record(200, third)
    assert [ledger.setting_at(time) for time in (99, 100, 199, 200, 900)] == [first, second, second, third, third]
    for time in range(201, 400):
        ledger.record(time, ExposureSetting(float(time), 0.0))
    assert ledger.setting_at(399).exposure_time_us == 399
    assert 201 < ledger.setting_at(1).exposure_time_us < 399  # the oldest are forgotten


def test_the_ledger_follows_the_latency_that_brightness_shows() -> None:
    """A camera that shows a write 25 ms later, written between frames 10 ms apart."""
    ledger = SettingLedger(ExposureSetting(1000.0, 0.0))
    written_ns, times_us = 0, [1000.0, 4000.0]
    for start_ns in range(0, 400_000_000, 10_000_000):
        if start_ns in (100_000_000, 250_000_000):
            written_ns = start_ns + 1_000_000 - 10_000_000
            times_us.reverse()
            ledger.record(written_ns, ExposureSetting(times_us[0], 0.0))
        shown_us = times_us[0] if start_ns >= written_ns + 25_000_000 or not written_ns else times_us[1]
        ledger.observe(start_ns, shown_us / 40)
        if start_ns >= 250_000_000:
            assert ledger.setting_at(start_ns).exposure_time_us == shown_us


def latency_ns(shown_after_ns: int, changes_stops: list[float], light: float = 0.0) -> int:
    """As found for a camera that shows a write so much later; a change every 12 frames, at random phases."""
    numbers, measured = random.Random(1), WriteLatency()
    level, shown, due_ns = 5.0, 5.0, 0
    for frame in range(12 * (len(changes_stops) + 1)):
        start_ns = frame * PERIOD_NS
        if frame and frame % 12 == 0:
            written_ns = start_ns - numbers.randrange(1, PERIOD_NS)
            change = changes_stops[frame // 12 - 1]
            level += change
            due_ns = written_ns + shown_after_ns
            measured.write(written_ns, change)
        shown = level if start_ns > due_ns else shown
        measured.frame(start_ns, 2.0 ** (shown + light * numbers.uniform(-1, 1)))
    return measured.latency_ns


@pytest.mark.parametrize("periods", [0, 1, 2])
def test_it_finds_the_delay_of_a_camera_in_whole_frames(periods: int) -> None:
    found_ns = latency_ns(periods * PERIOD_NS, [1.0, -1.0] * 4, light=0.05)
    assert (periods - 0.4) * PERIOD_NS < found_ns <= periods * PERIOD_NS


def test_the_latency_is_zero_until_a_change_was_seen_with_frames_to_itself() -> None:
    assert latency_ns(2 * PERIOD_NS, [0.2, -0.2]) == 0
    measured, level = WriteLatency(), 5.0
    for frame in range(60):
        measured.frame(frame * PERIOD_NS, 2.0**level)
        level += 1.0 if frame % 2 else -1.0
        measured.write(frame * PERIOD_NS + 1, 1.0 if frame % 2 else -1.0)
    assert measured.latency_ns == 0


def with_chunks(*entries: str, unit: str | None = None, locked: bool = False, **others: Node) -> MemoryNodes:
    nodes: dict[str, Node] = {
        "ChunkModeActive": BooleanNode(locked, locked),
        "ChunkSelector": EnumerationNode(entries[-1], entries, locked=locked),
        "ChunkEnable": BooleanNode(locked, locked),
        "ChunkExposureTime": FloatNode(0.0, unit=unit),
    }
    return MemoryNodes(nodes | others)


@pytest.mark.parametrize(("gain_node", "chunk"), [("Gain", "Gain"), ("GainRaw", "GainAll"), (None, None)])
def test_chunks_are_switched_on(gain_node: str | None, chunk: str | None) -> None:
    nodes = with_chunks(
        "ExposureTime", "Gain", "GainAll", "Image", ChunkGain=FloatNode(0.0), ChunkGainAll=IntegerNode(0)
    )
    wanted = ChunkNodes("ChunkExposureTime", 1.0, chunk and f"Chunk{chunk}", gain_node == "GainRaw")
    assert enable_chunks(nodes, gain_node) == (wanted, ())
    chosen = [entry for name, entry in nodes.writes if name == "ChunkSelector"]
    assert chosen == ["ExposureTime", *([] if chunk is None else [chunk])]
    assert nodes.writes[0] == ("ChunkModeActive", True)


@pytest.mark.parametrize(
    ("nodes", "us_per_unit"),
    [(with_chunks("ExposureTime", unit="s"), 1e6), (with_chunks("Image", "ExposureTime", locked=True), 1.0)],
    ids=["in seconds", "on already"],
)
def test_the_time_is_read_in_microseconds_and_what_is_on_already_needs_no_write(
    nodes: MemoryNodes, us_per_unit: float
) -> None:
    assert enable_chunks(nodes, None) == (ChunkNodes("ChunkExposureTime", us_per_unit, None), ())


def test_missing_chunks_are_reported() -> None:
    for nodes in (with_chunks("ExposureTime", "Image"), with_chunks("ExposureTime", "Image", ChunkGain=FloatNode(0.0))):
        chunks, (limitation,) = enable_chunks(nodes, "Gain")
        assert chunks is None
        assert "no chunk data of ExposureTime and Gain" in limitation and "inferred" in limitation
        assert nodes.writes[-1] == ("ChunkModeActive", False)
    without_its_node = with_chunks("ExposureTime")
    del without_its_node.nodes["ChunkExposureTime"]
    for nodes in (without_its_node, with_chunks("ExposureTime", unit="lines"), MemoryNodes({})):
        assert enable_chunks(nodes, None)[0] is None


def test_chunks_that_cannot_be_switched_on_are_reported_with_the_reason() -> None:
    class Refusing(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"could not set {name}: write-protect")

    chunks, (limitation,) = enable_chunks(Refusing(with_chunks("Image").nodes), None)
    assert chunks is None
    assert "inferred" in limitation and "could not set ChunkModeActive: write-protect" in limitation
