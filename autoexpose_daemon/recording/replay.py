"""Replaying a recording: what a policy decides on the recorded frames, and how well that agrees."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import REMOVED
from autoexpose_daemon.recording.file import Item, LoopState, RecordingError, Setup, Step, software
from autoexpose_daemon.recording.read import Recording
from documents.text import readable


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A step, and what was decided on it in the replay."""

    step: Step
    # none if it is unknown: before the first snapshot, between recorder drops and the next snapshot, and of a policy
    # that is no longer here
    decision: Decision | None
    dropped: int  # steps that the recorder dropped just before this one
    undelivered: int  # triggers just before this one whose frames never reached control

    @property
    def same(self) -> bool:
        """Whether the recorded run decided the same, to the last bit, however it measured motion."""
        recorded = self.step.decision
        return self.decision is not None and replace(self.decision, motion_px=recorded.motion_px) == recorded


class Replay:
    """Feeds the items of a recording to the recorded policy, or to another one.

    The recorded policy starts at a snapshot of its state and continues until steps are missing that it would have
    learnt from; the next snapshot lets it resume. Another policy starts from scratch: it sees the frames that the
    recorded policy asked for, not those that it would ask for itself. `policy_id` None: the recorded one.
    """

    def __init__(self, policy_id: str | None = None) -> None:
        self.setup: Setup | None = None
        """The setup of the latest steps."""
        self._policy_id = policy_id
        self.loop: ControlLoop | None = None
        """What decides in the replay; None while that is unknown."""
        self._former: Step | None = None

    @property
    def faithful(self) -> bool:
        """Whether the recorded policy is replayed, so that its decisions must be those recorded."""
        if self.setup is None or self._policy_id is None:
            return True
        return self.setup.control.parameters.bracket is None and self._policy_id == self.setup.control.policy_id

    @property
    def removed(self) -> str | None:
        """The recorded policy if it is to decide, but is no longer here."""
        policy_id = None if self.setup is None else self.setup.control.policy_id
        return policy_id if self._policy_id is None and policy_id in REMOVED["policy"] else None

    def steps(self, items: Iterable[Item]) -> Iterator[Replayed]:
        """The outcome of each step.

        Raises RecordingError when a snapshot does not fit its setup, or there is no setup; ConfigurationError when the
        policy cannot work on these frames.
        """
        for item in items:
            match item:
                case Setup():
                    self.setup = item
                    self.loop = None if self.faithful else self._new_loop(item)
                case LoopState():
                    self._resume(item)
                case Step():
                    yield self._step(item)

    def _new_loop(self, setup: Setup) -> ControlLoop:
        return ControlLoop(setup.control if self._policy_id is None else setup.control.of_policy(self._policy_id))

    def _resume(self, state: LoopState) -> None:
        if self.setup is None:
            raise RecordingError("the recording is damaged: a state of control without its setup")
        if self.loop is None and self.removed is None:
            self.loop = self._new_loop(self.setup)
            try:
                self.loop.restore(state.control)
            except ValueError as error:
                raise RecordingError(f"the recording is damaged: its state of control does not fit: {error}") from error

    def _step(self, step: Step) -> Replayed:
        dropped = undelivered = 0
        if self._former is not None:
            dropped = max(step.sequence - self._former.sequence - 1, 0)
            undelivered = max(step.pair.trigger - self._former.pair.trigger - 1 - dropped, 0)
        self._former = step
        if dropped and self.faithful:
            self.loop = None
        decision = None if self.loop is None else self.loop.step(step.inputs)
        return Replayed(step, decision, dropped, undelivered)


_SECOND_NS = 1_000_000_000

Say = Callable[[str], None]
"""Takes a line of text."""


_HEAD = (
    "                 last frame of a     exposure level, stops         the same",
    "     s  trigger  second, taken with  recorded  replayed     apart  decision",
)

Watch = Callable[[Replay, Replayed], None]
"""Is shown each step as soon as it has been replayed."""


def report_replay(path: Path, policy_id: str | None, say: Say, watching: Sequence[Watch] = ()) -> bool:
    """Replay a recording and print the outcome; False when the recorded policy decided differently this time.

    Raises RecordingError or ConfigurationError when the recording cannot be read, or the policy cannot run on it.
    """
    recording, player = Recording(path), Replay(policy_id)
    second, total = _Figures(), _Figures()
    start_ns: int | None = None
    end_ns = 0
    for replayed in player.steps(recording):
        for watch in watching:
            watch(player, replayed)
        time_ns = replayed.step.pair.reference.host_time_ns
        if start_ns is None:
            for line in _HEAD:
                say(line)
            start_ns = time_ns
            end_ns = start_ns + _SECOND_NS
        if time_ns >= end_ns:
            _print_second(say, second, start_ns, player.faithful)
            second = _Figures()
            end_ns += (time_ns - end_ns) // _SECOND_NS * _SECOND_NS + _SECOND_NS
        for request in replayed.step.requests:
            say(f"trigger {replayed.step.pair.trigger}: {readable(request)}")
        if replayed.dropped:
            _print_drop(say, replayed, player.faithful and player.removed is None)
        second.add(replayed)
        total.add(replayed)
    _print_second(say, second, start_ns or 0, player.faithful)
    return _print_summary(say, recording, player, total, policy_id)


@dataclass(slots=True)
class _Figures:
    """Counts over some steps; `apart`: differences of exposure level (stops) over the steps that could be replayed."""

    steps: int = 0
    same: int = 0
    settings_agree: int = 0
    dropped: int = 0
    undelivered: int = 0
    apart: list[float] = field(default_factory=list)
    latest: Replayed | None = None
    first_other: Replayed | None = None

    def add(self, replayed: Replayed) -> None:
        self.steps += 1
        self.dropped += replayed.dropped
        self.undelivered += replayed.undelivered
        self.latest = replayed
        if replayed.decision is None:
            return
        recorded = replayed.step.decision
        self.same += replayed.same
        self.settings_agree += replayed.decision.setting.agrees_with(recorded.setting)
        self.apart.append(abs(replayed.decision.level - recorded.level))
        if not replayed.same and self.first_other is None:
            self.first_other = replayed


def _print_second(say: Say, figures: _Figures, start_ns: int, faithful: bool) -> None:
    if figures.latest is None:
        return
    step, decision = figures.latest.step, figures.latest.decision
    replayed = "-" if decision is None else f"{decision.level:.2f}"
    same = figures.same if faithful else figures.settings_agree
    apart = f"{np.mean(figures.apart):.2f}" if figures.apart else "-"
    frame = step.pair.reference
    say(
        f"{(frame.host_time_ns - start_ns) * 1e-9:6.1f}  {step.pair.trigger:7d}  {frame.setting!s:18}"
        f"  {step.decision.level:8.2f}  {replayed:>8}  {apart:>8}  {same:4d} of {figures.steps}"
    )


def _print_drop(say: Say, replayed: Replayed, faithful: bool) -> None:
    goes_on = "; the replay goes on from the next snapshot" if faithful else ""
    say(f"the recorder dropped {replayed.dropped} steps before trigger {replayed.step.pair.trigger}{goes_on}")


def _print_summary(say: Say, recording: Recording, player: Replay, total: _Figures, policy_id: str | None) -> bool:
    recorded_policy = player.setup.control.policy_id if player.setup is not None else "?"
    replayed = len(total.apart)
    dropped = max(total.dropped, recording.dropped or 0)  # the last ones leave no gap
    lines = [
        f"{total.steps} steps of {recorded_policy}; missing: {dropped} dropped by the recorder, "
        f"{total.undelivered} triggers whose frames never reached control"
    ]
    if recording.cut_off:
        lines.append("the file ends in the middle of a record: what comes before that has been read")
    as_it_was = total.first_other is None
    if player.removed is not None:
        lines.append(
            f"not replayed: policy {player.removed} is no longer here; replay with `--policy "
            f"{REMOVED['policy'][player.removed]}`, which took its place, or with a version that had it"
        )
    elif player.faithful:
        lines.append(f"replayed: {replayed}, of which {total.same} are bit for bit as recorded")
        if total.steps > replayed:
            lines.append(f"not replayed: {total.steps - replayed}, before a snapshot of the state they were decided in")
        if total.first_other is not None:
            lines += _differences(player, total.first_other)
    else:
        mean, largest = (float(np.mean(total.apart)), max(total.apart)) if total.apart else (0.0, 0.0)
        lines.append(
            f"{policy_id} on the same frames: {mean:.2f} stops apart on average, {largest:.2f} at most; "
            f"the same setting in {total.settings_agree} of {replayed} steps"
        )
    for line in lines:
        say(line)
    return as_it_was or not player.faithful


def _differences(player: Replay, first: Replayed) -> list[str]:
    """Where the first difference lies, and in which software."""
    say = [f"first other decision at trigger {first.step.pair.trigger}: {first.decision}; was {first.step.decision}"]
    if player.setup is not None:
        here = software()
        say += [
            f"recorded with {name} {made_with}, replayed with {here.get(name, 'none')}"
            for name, made_with in player.setup.made_with.items()
            if here.get(name) != made_with
        ]
    return say
