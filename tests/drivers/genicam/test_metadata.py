from __future__ import annotations

import pytest

from drivers.genicam.metadata import ChunkNodes, SettingLedger, enable_chunks
from drivers.setup import FeatureValue
from imaging.errors import NodeError
from imaging.exposure import ExposureSetting
from tests.drivers.genicam.node_map import BooleanNode, EnumerationNode, FloatNode, IntegerNode, MemoryNodes


def test_the_ledger_gives_the_setting_last_written_before_the_frame() -> None:
    settings = [ExposureSetting(1000.0 * number, 0.0) for number in range(1, 4)]
    ledger = SettingLedger(settings[0])
    ledger.record(100, settings[1])
    ledger.record(200, settings[2])
    assert [ledger.setting_at(time) for time in (99, 100, 199, 200, 900)] == [
        settings[0], settings[1], settings[1], settings[2], settings[2]
    ]  # fmt: skip


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


def test_the_ledger_forgets_only_the_oldest() -> None:
    ledger = SettingLedger(ExposureSetting(1.0, 0.0))
    for time in range(1, 200):
        ledger.record(time, ExposureSetting(float(time), 0.0))
    assert ledger.setting_at(199).exposure_time_us == 199
    assert ledger.setting_at(1).exposure_time_us > 1


@pytest.mark.parametrize(("gain_node", "chunk"), [("Gain", "Gain"), ("GainRaw", "GainAll"), (None, None)])
def test_chunks_are_switched_on(gain_node: str | None, chunk: str | None) -> None:
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(),
            "ChunkSelector": EnumerationNode("Image", ("Image", "ExposureTime", "Gain", "GainAll")),
            "ChunkEnable": BooleanNode(),
            "ChunkExposureTime": FloatNode(0.0),
            "ChunkGain": FloatNode(0.0),
            "ChunkGainAll": IntegerNode(0),
        }
    )
    wanted = ChunkNodes("ChunkExposureTime", 1.0, chunk and f"Chunk{chunk}", gain_node == "GainRaw")
    assert enable_chunks(nodes, gain_node) == (wanted, ())
    chosen = [entry for name, entry in nodes.writes if name == "ChunkSelector"]
    assert chosen == ["ExposureTime", *([] if chunk is None else [chunk])]
    assert nodes.writes[0] == ("ChunkModeActive", True)


def test_missing_chunks_are_reported() -> None:
    nodes = MemoryNodes(
        {"ChunkModeActive": BooleanNode(), "ChunkSelector": EnumerationNode("Image", ("Image", "ExposureTime"))}
    )
    lacking = (
        None,
        ("no chunk data of ExposureTime and Gain: a frame's setting is inferred from when it was written",),
    )
    assert enable_chunks(nodes, "Gain") == lacking
    assert nodes.writes[-1] == ("ChunkModeActive", False)
    assert enable_chunks(MemoryNodes({}), "Gain") == lacking


def test_a_chunk_without_a_node_of_its_own_is_missing() -> None:
    entries = ("Image", "ExposureTime")
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(),
            "ChunkSelector": EnumerationNode("Image", entries),
            "ChunkEnable": BooleanNode(),
        }
    )
    chunks, (limitation,) = enable_chunks(nodes, None)
    assert chunks is None
    assert limitation.startswith("no chunk data of ExposureTime")
    assert nodes.writes[-1] == ("ChunkModeActive", False)


def test_a_chunk_of_another_unit_is_read_in_microseconds() -> None:
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(),
            "ChunkSelector": EnumerationNode("ExposureTime", ("ExposureTime",)),
            "ChunkEnable": BooleanNode(),
            "ChunkExposureTime": FloatNode(0.0, unit="s"),
        }
    )
    assert enable_chunks(nodes, None) == (ChunkNodes("ChunkExposureTime", 1e6, None), ())


def test_chunks_that_cannot_be_switched_on_are_reported_with_the_reason() -> None:
    class Refusing(MemoryNodes):
        def write(self, name: str, value: FeatureValue) -> None:
            raise NodeError(f"could not set {name}: write-protect")

    nodes = Refusing({"ChunkModeActive": BooleanNode(), "ChunkSelector": EnumerationNode("Image", ("Image",))})
    chunks, (limitation,) = enable_chunks(nodes, None)
    assert chunks is None
    assert limitation.startswith("a frame's setting is inferred from when it was written")
    assert "could not set ChunkModeActive: write-protect" in limitation


def test_chunks_that_are_on_already_need_no_write() -> None:
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(True, locked=True),
            "ChunkSelector": EnumerationNode("ExposureTime", ("Image", "ExposureTime"), locked=True),
            "ChunkEnable": BooleanNode(True, locked=True),
            "ChunkExposureTime": FloatNode(0.0),
        }
    )
    assert enable_chunks(nodes, None) == (ChunkNodes("ChunkExposureTime", 1.0, None), ())


def test_a_chunk_of_an_unknown_unit_says_nothing() -> None:
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(),
            "ChunkSelector": EnumerationNode("ExposureTime", ("ExposureTime",)),
            "ChunkEnable": BooleanNode(),
            "ChunkExposureTime": FloatNode(0.0, unit="lines"),
        }
    )
    assert enable_chunks(nodes, None)[0] is None
