"""How fast each of the cameras on a link may send."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.host.network import USABLE_SHARE, bytes_per_s, needed_bytes_per_s, packet_delay_ns

sizes = st.integers(576, 9000)
link_mbps = st.floats(10.0, 10_000.0)
cameras = st.integers(1, 4)


@given(sizes, link_mbps, cameras, st.none() | st.floats(1e6, 1.25e9))
def test_cameras_that_pause_so_long_fit_into_the_link(
    packet_bytes: int, mbps: float, count: int, own_bytes_per_s: float | None
) -> None:
    share = bytes_per_s(mbps, count)
    delay_s = 1e-9 * packet_delay_ns(packet_bytes, share, own_bytes_per_s)
    sending_s = 0.0 if own_bytes_per_s is None else (packet_bytes + 38) / own_bytes_per_s
    sent = count * (packet_bytes + 38) / (delay_s + sending_s)
    assert sent <= USABLE_SHARE * mbps * 1e6 / 8 * (1 + 1e-6)
    if own_bytes_per_s is not None and own_bytes_per_s < share:
        assert delay_s == 0.0


def test_a_frame_needs_its_packets_headers_too() -> None:
    # 720 x 540 in packets of 1500 bytes: 1464 of them image, with 36 + 38 bytes around
    assert needed_bytes_per_s(388_800, 1500, 60.0) == pytest.approx(60.0 * (388_800 + 266 * 74))
