from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.exposure import ExposureSetting
from drivers.metadata import FrameIdUnwrapper, SettingLedger, enable_chunks
from tests.drivers.node_map import BooleanNode, EnumerationNode, MemoryNodes


def on_the_wire(frame: int) -> int:
    """The 16-bit id of the frame-th frame, counted from 1: 65535 is followed by 1."""
    return (frame - 1) % 65535 + 1


@given(st.integers(1, 65535), st.lists(st.integers(1, 32767), max_size=40))
def test_gaps_up_to_half_a_cycle_are_counted_across_the_wrap(start: int, gaps: list[int]) -> None:
    unwrapper = FrameIdUnwrapper()
    frame = start
    assert unwrapper.unwrap(on_the_wire(frame)) == start
    for gap in gaps:
        frame += gap
        assert unwrapper.unwrap(on_the_wire(frame)) == frame


@given(st.integers(65500, 65600), st.randoms(use_true_random=False))
def test_frames_out_of_order_keep_their_numbers(start: int, order: object) -> None:
    frames = list(range(start, start + 16))
    order.shuffle(frames)  # type: ignore[attr-defined]
    unwrapper = FrameIdUnwrapper()
    first = unwrapper.unwrap(on_the_wire(frames[0]))
    assert [unwrapper.unwrap(on_the_wire(frame)) - first for frame in frames[1:]] == [
        frame - frames[0] for frame in frames[1:]
    ]


@given(st.lists(st.integers(0, 1 << 40), min_size=1))
def test_counters_beyond_16_bits_pass_through(steps: list[int]) -> None:
    unwrapper = FrameIdUnwrapper()
    frame = 1 << 16
    for step in steps:
        frame += step
        assert unwrapper.unwrap(frame) == frame


def test_the_ledger_gives_the_setting_last_written_before_the_frame() -> None:
    settings = [ExposureSetting(1000.0 * number, 0.0) for number in range(1, 4)]
    ledger = SettingLedger(settings[0])
    ledger.record(100, settings[1])
    ledger.record(200, settings[2])
    assert [ledger.setting_at(time) for time in (99, 100, 199, 200, 900)] == [
        settings[0], settings[1], settings[1], settings[2], settings[2]
    ]  # fmt: skip


def test_the_ledger_forgets_the_oldest_only() -> None:
    ledger = SettingLedger(ExposureSetting(1.0, 0.0))
    for time in range(1, 200):
        ledger.record(time, ExposureSetting(float(time), 0.0))
    assert ledger.setting_at(199).exposure_time_us == 199
    assert ledger.setting_at(1).exposure_time_us > 1


@pytest.mark.parametrize("gain_driven", [True, False])
def test_chunks_are_switched_on(gain_driven: bool) -> None:
    nodes = MemoryNodes(
        {
            "ChunkModeActive": BooleanNode(),
            "ChunkSelector": EnumerationNode("Image", ("Image", "ExposureTime", "Gain")),
            "ChunkEnable": BooleanNode(),
        }
    )
    assert enable_chunks(nodes, gain_driven) == (True, ())
    assert (("ChunkSelector", "Gain") in nodes.writes) == gain_driven
    assert nodes.writes[0] == ("ChunkModeActive", True)


def test_missing_chunks_are_told() -> None:
    nodes = MemoryNodes(
        {"ChunkModeActive": BooleanNode(), "ChunkSelector": EnumerationNode("Image", ("Image", "ExposureTime"))}
    )
    lacking = (
        False,
        ("no chunk data of ExposureTime and Gain: a frame's setting is inferred from when it was written",),
    )
    assert enable_chunks(nodes, True) == lacking
    assert nodes.writes[-1] == ("ChunkModeActive", False)
    assert enable_chunks(MemoryNodes({}), True) == lacking
