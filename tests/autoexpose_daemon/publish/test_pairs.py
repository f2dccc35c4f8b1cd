"""How a client puts messages together and counts what is missing; no transport."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from autoexpose_daemon.client import StereoClient, received
from autoexpose_daemon.client.received import ReceivedPair, SetAssembler, SetQueue
from autoexpose_daemon.messages.client import ConsumerTally
from autoexpose_daemon.messages.errors import DamagedMessageError
from autoexpose_daemon.messages.frames import MIDDLE, Message, MessageWriter
from imaging.exposure import ExposureSetting
from imaging.frames import CameraName, Frame, FrameSet
from imaging.geometry import SIDES
from tests.autoexpose_daemon.publish.steps import DECISION, SETTING

PERIOD_NS = 16_666_667
LONE: dict[str, list[CameraName]] = {"left": ["left"], "right": ["right"]}


def frame(number: int) -> Frame:
    return Frame(np.full((2, 3), number % 256, np.uint8), 8, number, number, number * PERIOD_NS, 0, SETTING)


def messages(
    number: int,
    *,
    rig: Sequence[CameraName] = SIDES,
    present: Sequence[CameraName] | None = None,
    sequence: int | None = None,
) -> list[Message]:
    """Those of one step that a client asks for: exposure and image of each frame, by turns."""
    step = FrameSet(number, {camera: frame(number) for camera in (rig if present is None else present)})
    return written(step, number if sequence is None else sequence, len(rig))


def written(step: FrameSet, sequence: int, cameras: int = 2) -> list[Message]:
    made = MessageWriter("rig", cameras).messages(step, dict.fromkeys(step.frames, DECISION), sequence, 0)
    return [message for message in made if message.topic != "camera_info"]


class Receiver:
    def __init__(self, length: int = 100) -> None:
        self.tally = ConsumerTally()
        self.assembler = SetAssembler(ReceivedPair, self.tally)
        self.queue: SetQueue[ReceivedPair] = SetQueue(self.tally, length)

    def receive(self, *messages: Message) -> None:
        for message in messages:
            take = self.assembler.image if message.topic == "image" else self.assembler.exposure
            pair = take(message.camera, bytes(message.data), 0)
            if pair is not None:
                self.queue.put(pair)

    def drain(self) -> list[ReceivedPair]:
        return [self.queue.take() for _ in range(len(self.queue))]


@given(st.sets(st.integers(1, 40), min_size=1), st.data())
def test_whatever_is_lost_is_counted(arriving: set[int], data: st.DataObject) -> None:
    """Of each step all messages come, or all but some; the order within a step does not matter."""
    receiver = Receiver()
    whole = []
    for number in sorted(arriving):
        parts = data.draw(st.permutations(messages(number)))
        missing = data.draw(st.sampled_from([0, 0, 0, 1, 3]))
        receiver.receive(*parts[missing:])
        whole += [number] if missing == 0 else []
    pairs = receiver.drain()
    assert [pair.sequence for pair in pairs] == whole
    lost = whole[-1] - whole[0] + 1 - len(whole) if whole else 0
    assert receiver.tally == ConsumerTally(pairs=len(whole), missed=lost, lost=lost)


@given(st.lists(st.sampled_from(["pair", "pair", "left", "right", "lost"]), max_size=40), st.randoms())
def test_messages_of_the_cameras_may_overtake_each_other(steps: list[str], order: random.Random) -> None:
    receiver = Receiver()
    queues: dict[CameraName, list[Message]] = {"left": [], "right": []}
    kinds = ["pair", *steps, "pair"]
    for number, kind in enumerate(kinds, start=1):
        for message in messages(number, present=LONE.get(kind)):
            if kind != "lost":
                queues[message.camera].append(message)
    while waiting := [queue for queue in queues.values() if queue]:
        receiver.receive(order.choice(waiting).pop(0))
    assert [pair.sequence for pair in receiver.drain()] == [n for n, kind in enumerate(kinds, 1) if kind == "pair"]
    alone = kinds.count("left") + kinds.count("right")
    assert (receiver.tally.lost, receiver.tally.alone) == (kinds.count("lost"), alone)


def test_lone_frames_before_the_daemon_starts_again_take_nothing_from_the_losses() -> None:
    receiver = Receiver()
    for number in range(30, 50):
        receiver.receive(*messages(number, present=["left"]))
    for sequence in [*range(1, 40), *range(42, 61)]:
        receiver.receive(*messages(100 + sequence, sequence=sequence))
        assert receiver.tally.lost >= 0
    assert len(receiver.drain()) == receiver.tally.pairs == 58


def test_a_pair_holds_what_its_messages_say() -> None:
    receiver = Receiver()
    receiver.receive(*messages(7))
    (pair,) = receiver.drain()
    assert pair.right is not None
    assert (pair.trigger, pair.stamp_ns, pair.decision) == (7, MIDDLE.moment_ns(pair.left), DECISION)
    assert pair.stereo.frames == {"left": pair.left, "right": pair.right}
    assert not pair.left.pixels.flags.writeable


def test_a_rig_of_one_camera_makes_pairs_of_one() -> None:
    receiver = Receiver()
    receiver.receive(*messages(1, rig=["left"]))
    (pair,) = receiver.drain()
    assert pair.right is None


def test_a_slow_consumer_gets_the_newest_pairs_and_knows_what_it_missed() -> None:
    receiver = Receiver(length=2)
    for number in range(1, 11):
        receiver.receive(*messages(number))
        if number == 1:
            receiver.drain()
    assert [pair.sequence for pair in receiver.drain()] == [9, 10]
    assert receiver.tally == ConsumerTally(pairs=3, missed=7, too_slow=7)


def test_a_new_daemon_or_camera_that_counts_from_the_beginning_is_no_loss() -> None:
    receiver = Receiver()
    for number in (500, 501, 1, 2):
        receiver.receive(*messages(number))
    assert len(receiver.drain()) == 4
    assert receiver.tally == ConsumerTally(pairs=4)


@pytest.mark.parametrize("jump", [10**7, 2**63 - 1])
def test_a_count_that_jumps_out_of_sight_is_another_count(jump: int) -> None:
    """Anybody who can publish can send such a number; losses that nobody had would stand there for ever."""
    receiver = Receiver()
    for number in (1, 2, jump, 3, 4, 6):
        counted = replace(frame(2), frame_id=number, host_time_ns=number % 10**15)
        step = FrameSet(number, dict.fromkeys(SIDES, counted))
        receiver.receive(*written(step, number))
        receiver.drain()
    assert receiver.tally == ConsumerTally(pairs=6, missed=1, lost=1)


def test_a_pair_that_is_refused_counts_as_lost() -> None:
    receiver = Receiver()
    for number in (1, 2, 3):
        taken = frame(number) if number != 2 else replace(frame(2), setting=ExposureSetting(1e12, 0.0))
        step = FrameSet(number, dict.fromkeys(SIDES, taken))
        *others, last = written(step, number)
        receiver.receive(*others)
        with pytest.raises(DamagedMessageError) if number == 2 else contextlib.nullcontext():
            receiver.receive(last)
    assert [pair.sequence for pair in receiver.drain()] == [1, 3]
    assert receiver.tally == ConsumerTally(pairs=2, missed=1, lost=1)


def test_a_client_says_once_why_it_refuses_pairs(caplog: pytest.LogCaptureFixture) -> None:
    client = StereoClient()
    for message in messages(1):
        client._inbox.receive(f"autoexpose/rig/{message.camera}/{message.topic}", bytes(message.data)[:-1])
    (said,) = caplog.messages
    assert said.startswith("pairs are refused, and lost: not a ")


def test_images_that_wait_for_the_rest_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(received, "_KEPT_BYTES", 100)
    receiver = Receiver()
    for number in range(1, 30):
        for _ in range(2):  # the second takes the place of the first
            receiver.receive(messages(number)[-1])
        waiting = sum(part.images["right"].pixels.nbytes for part in receiver.assembler._parts.values())
        assert waiting == min(6 * number, 96)
    receiver.receive(*messages(99))
    assert len(receiver.drain()) == 1
    assert receiver.assembler._kept_bytes == 0


def test_parts_that_never_become_whole_do_not_pile_up() -> None:
    receiver = Receiver()
    for number in range(1, 1000):
        receiver.receive(messages(number)[-1])
    assert len(receiver.assembler._parts) <= 64
