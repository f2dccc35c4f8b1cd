"""Replaying a recording: what a policy decides on the recorded frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.removed import REMOVED
from autoexpose_daemon.recording.step import Item, RecordingError, Setup, State, Step


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """A step, and what was decided on it in the replay.

    Attributes
    ----------
    decision
        None if it is unknown: before the first snapshot, between recorder drops and the next snapshot, and of a policy
        that is no longer here.
    dropped
        Steps that the recorder dropped just before this one.
    undelivered
        Triggers just before this one whose frames never reached control.
    """

    step: Step
    decision: Decision | None
    dropped: int
    undelivered: int

    @property
    def same(self) -> bool:
        """Whether the recorded run decided the same, to the last bit, however it measured motion."""
        recorded = self.step.decision
        return self.decision is not None and replace(self.decision, motion_px=recorded.motion_px) == recorded


class Replay:
    """Feeds the items of a recording to the recorded policy, or to another one.

    The recorded policy starts at a snapshot of its state and continues until steps are missing that it would have
    learnt from; the next snapshot lets it resume. Another policy starts from scratch: it sees the frames that the
    recorded policy asked for, not those that it would ask for itself.

    Parameters
    ----------
    policy_id
        Another policy; None: the recorded one.
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

        Raises
        ------
        RecordingError
            When a snapshot does not fit its setup, or there is no setup.
        ConfigurationError
            When the policy cannot work on these frames.
        """
        for item in items:
            match item:
                case Setup():
                    self.setup = item
                    self.loop = None if self.faithful else self._new_loop(item)
                case State():
                    self._resume(item)
                case Step():
                    yield self._step(item)

    def _new_loop(self, setup: Setup) -> ControlLoop:
        return (setup.control if self._policy_id is None else setup.control.of_policy(self._policy_id)).loop()

    def _resume(self, state: State) -> None:
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
        given = step.pair, step.angular_rate_rad_s, step.light_ahead, step.override, step.steering
        decision = None if self.loop is None else self.loop.step(*given)
        return Replayed(step, decision, dropped, undelivered)
