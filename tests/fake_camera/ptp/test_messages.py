from __future__ import annotations

import struct

from hypothesis import given
from hypothesis import strategies as st

from fake_camera.ptp.messages import Grandmaster, Message, MessageType, PortIdentity, clock_identity

u8, u16, u64 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 64))
times = st.integers(0, 2**63 - 1)
identities = st.builds(PortIdentity, u64, u16)
grandmasters = st.builds(Grandmaster, u64, u8, u8, u8, u16, u8, u16, u8, st.integers(-(2**15), 2**15 - 1))


@st.composite
def messages(draw: st.DrawFn) -> Message:
    kind = draw(st.sampled_from(MessageType))
    return Message(
        kind,
        draw(identities),
        draw(u16),
        draw(times),
        draw(u8),
        draw(st.booleans()),
        draw(st.integers(-(2**63), 2**63 - 1)),
        draw(st.integers(-128, 127)),
        draw(identities) if kind is MessageType.DELAY_RESP else None,
        draw(grandmasters) if kind is MessageType.ANNOUNCE else None,
    )


@given(messages(), st.binary(max_size=20))
def test_a_message_is_read_as_it_was_written_whatever_follows_it(message: Message, suffix: bytes) -> None:
    assert Message.from_bytes(message.to_bytes() + suffix) == message


@given(messages(), st.data())
def test_a_message_cut_short_is_none(message: Message, data: st.DataObject) -> None:
    datagram = message.to_bytes()
    assert Message.from_bytes(datagram[: data.draw(st.integers(0, len(datagram) - 1))]) is None


@given(st.binary(max_size=80) | st.binary(min_size=60, max_size=80).map(lambda data: b"\x0b\x02\0\x40" + data))
def test_any_bytes_are_a_message_or_none(datagram: bytes) -> None:
    message = Message.from_bytes(datagram)
    assert message is None or Message.from_bytes(message.to_bytes()) == message


def test_the_bytes_of_a_delay_resp_are_those_of_the_standard() -> None:
    message = Message(
        MessageType.DELAY_RESP,
        PortIdentity(0x0102030405060708, 9),
        0x0A0B,
        (0x000100000002 * 10**9) + 3,
        4,
        correction=5 << 16,
        log_interval=-3,
        requester=PortIdentity(0x1112131415161718, 0x191A),
    )
    assert message.to_bytes() == (
        bytes.fromhex("0902 0036 04 00 0000 0000000000050000 00000000 0102030405060708 0009 0a0b 03 fd")
        + bytes.fromhex("0001 00000002 00000003")
        + bytes.fromhex("1112131415161718 191a")
    )
    assert message.correction_ns == 5


def test_other_versions_types_and_impossible_times_are_none() -> None:
    datagram = Message(MessageType.SYNC, PortIdentity(1), 2, two_step=True).to_bytes()
    assert datagram[:2] == b"\0\2"
    assert datagram[6:8] == b"\2\0"
    for at, wrong in ((0, b"\x0c"), (1, b"\1"), (40, struct.pack(">I", 10**9)), (34, b"\xff")):
        assert Message.from_bytes(datagram[:at] + wrong + datagram[at + len(wrong) :]) is None


def test_a_clock_identity_has_fffe_in_the_middle_of_the_mac_address() -> None:
    assert clock_identity(0x0200_1122_3344) == 0x0200_11FF_FE22_3344
