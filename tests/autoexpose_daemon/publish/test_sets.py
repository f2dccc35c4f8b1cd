"""How a client puts the messages of more than two cameras together, or of some of them; no transport."""

from __future__ import annotations

from collections.abc import Iterator, Sequence, Set
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.client import RigClient, StereoClient
from autoexpose_daemon.client.received import ReceivedPair, ReceivedSet, SetAssembler
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import Message
from imaging.errors import ConfigurationError
from imaging.frames import CameraName
from tests.autoexpose_daemon.publish.test_pairs import messages

THREE: tuple[CameraName, ...] = ("front", "rear", "top")
FOUR: tuple[CameraName, ...] = ("front_left", "front_right", "rear_left", "rear_right")


class Receiver:
    def __init__(self, cameras: Sequence[CameraName] | None = None, kind: type[ReceivedSet] = ReceivedSet) -> None:
        self.tally = ConsumerTally()
        self.sets: list[ReceivedSet] = []
        self._assembler = SetAssembler(kind, self.tally, cameras)

    def receive(self, *messages: Message) -> None:
        for message in messages:
            take = self._assembler.image if message.topic == "image" else self._assembler.exposure
            if (whole := take(message.camera, bytes(message.data), 0)) is not None:
                self.sets.append(whole)

    @property
    def sequences(self) -> list[int]:
        return [each.sequence for each in self.sets]


def test_a_set_of_three_is_whole_when_the_last_message_has_come() -> None:
    receiver = Receiver()
    *others, last = messages(7, rig=THREE)
    receiver.receive(*others)
    assert receiver.sets == []
    receiver.receive(last)
    (whole,) = receiver.sets
    assert set(whole.frames) == set(THREE)
    assert whole.frame_set.trigger == whole.trigger == 7
    assert set(whole.decisions) == set(THREE)


def in_any_order(rig: Sequence[CameraName], steps: Sequence[Set[CameraName]], order: Any) -> Iterator[Message]:
    """The messages of steps with some cameras: each camera's in order, whatever overtakes what between cameras."""
    queues: dict[CameraName, list[Message]] = {camera: [] for camera in rig}
    for number, cameras in enumerate(steps, 1):
        for message in messages(number, rig=rig, present=[camera for camera in rig if camera in cameras]):
            queues[message.camera].append(message)
    while waiting := [queue for queue in queues.values() if queue]:
        yield order.choice(waiting).pop(0)


@given(st.lists(st.sets(st.sampled_from(THREE), min_size=1), max_size=20), st.randoms())
def test_sets_without_a_camera_are_counted_once_each_and_none_is_lost(
    present: list[set[CameraName]], order: Any
) -> None:
    receiver = Receiver()
    steps = [set(THREE), *present, set(THREE)]
    receiver.receive(*in_any_order(THREE, steps, order))
    assert receiver.sequences == [number for number, cameras in enumerate(steps, 1) if len(cameras) == 3]
    assert receiver.tally.alone == sum(len(cameras) < 3 for cameras in steps)
    assert receiver.tally.lost == 0


@given(st.lists(st.sets(st.sampled_from(FOUR), min_size=1), max_size=20), st.randoms())
def test_what_lacks_a_camera_that_was_asked_for_is_counted_once(present: list[set[CameraName]], order: Any) -> None:
    receiver = Receiver(FOUR[:2])
    steps = [set(FOUR), *present, set(FOUR)]
    receiver.receive(*in_any_order(FOUR, steps, order))
    whole = [number for number, cameras in enumerate(steps, 1) if cameras.issuperset(FOUR[:2])]
    assert receiver.sequences == whole
    # What only another camera says comes too late, if it comes after the end of a later set.
    assert receiver.tally.alone + receiver.tally.lost == len(steps) - len(whole)


def test_two_cameras_of_four_do_without_the_others() -> None:
    receiver = Receiver(FOUR[:2])
    receiver.receive(*messages(1, rig=FOUR))
    for number in range(2, 12):
        receiver.receive(*messages(number, rig=FOUR, present=FOUR[:3]))
    for number in range(12, 22):
        receiver.receive(*messages(number, rig=FOUR, present=FOUR[:2]))
    receiver.receive(*messages(22, rig=FOUR))
    assert receiver.sequences == list(range(1, 23))
    assert all(tuple(each.frames) == FOUR[:2] for each in receiver.sets)
    assert receiver.tally == ConsumerTally()


def test_frames_are_in_the_order_of_the_names_that_were_asked_for() -> None:
    receiver = Receiver(("rear_right", "front_left"), ReceivedPair)
    receiver.receive(*messages(1, rig=FOUR))
    (pair,) = receiver.sets
    assert isinstance(pair, ReceivedPair)
    assert tuple(pair.frames) == ("rear_right", "front_left")
    assert pair.left is pair.frames["rear_right"] and pair.right is pair.frames["front_left"]


@pytest.mark.parametrize("present", [FOUR[1:], FOUR[2:], FOUR[3:]])
def test_sets_that_lack_a_camera_that_was_asked_for_are_alone_not_lost(present: tuple[CameraName, ...]) -> None:
    receiver = Receiver(FOUR[:2])
    receiver.receive(*messages(1, rig=FOUR))
    for number in range(2, 12):
        receiver.receive(*messages(number, rig=FOUR, present=present))
    receiver.receive(*messages(12, rig=FOUR))
    receiver.receive(*messages(15, rig=FOUR))  # 13 and 14 never came
    assert receiver.sequences == [1, 12, 15]
    assert (receiver.tally.alone, receiver.tally.lost) == (10, 2)


def test_a_stereo_client_of_a_rig_of_three_needs_names() -> None:
    receiver = Receiver(kind=ReceivedPair)
    with pytest.raises(DamagedMessageError, match="the rig has 3 cameras: give StereoClient the names of two of them"):
        receiver.receive(*messages(1, rig=THREE))
    named = Receiver(("front", "top"), ReceivedPair)
    named.receive(*messages(1, rig=THREE))
    assert named.sequences == [1]


def test_which_of_two_cameras_of_other_names_is_left_is_not_guessed() -> None:
    receiver = Receiver(kind=ReceivedPair)
    with pytest.raises(DamagedMessageError, match=r"front.*which is left"):
        receiver.receive(*messages(1, rig=THREE[:2]))
    receiver.receive(*messages(1))
    assert receiver.sequences == [1]


def test_the_log_says_why_a_stereo_client_gets_nothing(caplog: pytest.LogCaptureFixture) -> None:
    client = StereoClient()
    for number in range(3):
        for message in messages(number, rig=THREE):
            client._inbox.receive(f"autoexpose/rig/{message.camera}/{message.topic}", bytes(message.data))
    (said,) = caplog.messages
    assert "the rig has 3 cameras" in said and "names of two" in said
    assert client._inbox.take(0.0) is None


@pytest.mark.parametrize("name", ["Left", "a/b", "*", "", "consumers"])
def test_what_is_no_name_of_a_camera_is_refused_at_once(name: str) -> None:
    with pytest.raises(ConfigurationError, match="not a valid name of a camera"):
        RigClient(cameras=["left", name])
