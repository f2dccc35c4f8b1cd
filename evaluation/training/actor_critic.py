"""An actor and two critics: the deterministic actor-critic of Fujimoto et al. 2018 (TD3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.training.backprop import Batch, TrainedNet
from evaluation.training.weights_file import Arrays

UNITS = 64

DISCOUNT = 0.9
"""Per decision. Theirs is 0.99; here what a frame is worth hardly depends on decisions ten before it."""

RATE, LAST_RATE = 1e-3, 1e-4
"""Of Adam, at the beginning and at the end of a training."""

FOLLOWING = 0.01
"""How far the slow nets move with each update."""

SMOOTHING, MOST_SMOOTHING = 0.1, 0.3
"""Noise added to actions that targets are computed for."""

ACTOR_EVERY = 2
"""Updates of the critics for each of the actor."""

BENDING = 1e-3
"""What the square of the actor's output before tanh costs: keeps it where tanh still has a slope."""


@dataclass(frozen=True, slots=True, eq=False)
class Transitions:
    """What was seen, done, earned and seen then: float32, (rows, inputs), (rows, 1), (rows, 1), (rows, inputs)."""

    before: Batch
    actions: Batch
    rewards: Batch
    after: Batch


class ActorCritic:
    """Learns actions -1..1 that earn most.

    Parameters
    ----------
    state
        Holds all nets, as `begin` made them.
    """

    def __init__(self, state: Arrays) -> None:
        self.actor = TrainedNet(state, "actor")
        self._critics = [TrainedNet(state, f"critic{place}") for place in range(2)]
        self.slow_actor = TrainedNet(state, "slow_actor")
        self._slow_critics = [TrainedNet(state, f"slow_critic{place}") for place in range(2)]

    @classmethod
    def begin(cls, state: Arrays, inputs: int, rng: np.random.Generator) -> ActorCritic:
        """New nets in a state."""
        TrainedNet.begin(state, "actor", (inputs, UNITS, UNITS, 1), rng).copy_to("slow_actor")
        for place in range(2):
            critic = TrainedNet.begin(state, f"critic{place}", (inputs + 1, UNITS, UNITS, 1), rng)
            critic.copy_to(f"slow_critic{place}")
        return cls(state)

    def act(self, inputs: Batch) -> Batch:
        """Actions (rows, 1) for inputs (rows, inputs)."""
        return np.tanh(self.actor.forward(inputs))

    def update(self, batch: Transitions, number: int, rate: float, rng: np.random.Generator) -> None:
        """One step of the critics towards what actions earn and, at every other one, of the actor."""
        noise = np.clip(SMOOTHING * rng.standard_normal(batch.actions.shape), -MOST_SMOOTHING, MOST_SMOOTHING)
        later = np.clip(np.tanh(self.slow_actor.forward(batch.after)) + noise.astype(np.float32), -1.0, 1.0)
        promised = [critic.forward(np.hstack([batch.after, later])) for critic in self._slow_critics]
        wanted = np.asarray(batch.rewards + np.float32(DISCOUNT) * np.minimum(*promised), np.float32)
        judged = np.hstack([batch.before, batch.actions])
        rows = np.float32(len(judged))
        for critic, slow in zip(self._critics, self._slow_critics, strict=True):
            gradients, _ = critic.backward((critic.forward(judged) - wanted) / rows)
            critic.descend(gradients, rate)
            slow.follow(critic, FOLLOWING)
        if number % ACTOR_EVERY == 0:
            output = self.actor.forward(batch.before)
            actions = np.tanh(output)
            critic = self._critics[0]
            critic.forward(np.hstack([batch.before, actions]))
            _, slopes = critic.backward(np.full((len(judged), 1), -1.0 / rows, np.float32))
            slopes = slopes[:, -1:] * (1.0 - actions * actions) + np.float32(BENDING) * output / rows
            gradients, _ = self.actor.backward(slopes)
            self.actor.descend(gradients, rate)
            self.slow_actor.follow(self.actor, FOLLOWING)
