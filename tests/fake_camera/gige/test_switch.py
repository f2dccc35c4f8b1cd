"""The switch between fake cameras and their host."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fake_camera.gige.switch import Switch

MBPS, BUFFER_BYTES = 1000.0, 64 * 1024
PACKET = 8962  # 9000 with Ethernet's framing


def test_a_burst_fills_the_buffer_and_the_link_empties_it(tmp_path: Path) -> None:
    with Switch(tmp_path / "switch", MBPS, BUFFER_BYTES) as switch:
        passed = [switch.passes(PACKET, 0) for _ in range(10)]
        assert passed == [True] * 7 + [False] * 3 and switch.dropped == 3
        assert not switch.passes(PACKET, 50_000)  # 9000 bytes take 72 us
        assert switch.passes(PACKET, 72_000)
        assert switch.passes(PACKET, 10_000_000)


def test_cameras_share_it(tmp_path: Path) -> None:
    path = tmp_path / "switch"
    with Switch(path, MBPS, BUFFER_BYTES) as left, Switch(path, MBPS, BUFFER_BYTES) as right:
        assert [camera.passes(PACKET, 0) for camera in (left, right) * 5] == [True] * 7 + [False] * 3
    assert (left.dropped, right.dropped) == (1, 2)


@given(st.lists(st.tuples(st.integers(0, 10_000_000), st.integers(100, 9000)), min_size=1))
def test_no_more_gets_through_than_buffer_and_link_take(
    tmp_path_factory: pytest.TempPathFactory, packets: list[tuple[int, int]]
) -> None:
    times_ns = sorted(time_ns for time_ns, _ in packets)
    with Switch(tmp_path_factory.mktemp("switch") / "state", MBPS, BUFFER_BYTES) as switch:
        sizes = [size for _, size in packets]
        through = sum(size + 38 for time_ns, size in zip(times_ns, sizes, strict=True) if switch.passes(size, time_ns))
    assert through <= BUFFER_BYTES + (times_ns[-1] - times_ns[0]) * MBPS / 8e3


def test_threads_of_one_camera_take_turns(tmp_path: Path) -> None:
    """Frames and resent packets: a lock on a file does not keep threads of one process apart."""
    with Switch(tmp_path / "switch", MBPS, BUFFER_BYTES) as switch, ThreadPoolExecutor(8) as threads:
        passed = list(threads.map(lambda _: switch.passes(PACKET, 0), range(2000)))
    assert sum(passed) == 7 and switch.dropped == 1993
