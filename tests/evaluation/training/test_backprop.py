"""Gradients against finite differences, and that learners learn what is easy."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.training.training import Arrays, TrainedNet
from evaluation.training.zhang2024 import ActorCritic, Transitions


def double_net(sizes: tuple[int, ...], seed: int) -> tuple[Arrays, TrainedNet]:
    """In float64, in which differences show slopes to many digits."""
    rng, arrays = np.random.default_rng(seed), {}
    net = TrainedNet.begin(arrays, "net", sizes, rng)
    for name in net.names:
        arrays[name] = arrays[name].astype(np.float64) + 0.1 * rng.standard_normal(arrays[name].shape)
    return arrays, net


def loss(net: TrainedNet, inputs: np.ndarray, wanted: np.ndarray) -> float:
    return 0.5 * float(np.sum((net.forward(inputs) - wanted) ** 2))


def test_gradients_are_those_of_finite_differences() -> None:
    arrays, net = double_net((5, 7, 4, 2), 3)
    rng = np.random.default_rng(4)
    inputs, wanted = rng.standard_normal((6, 5)), rng.standard_normal((6, 2))
    gradients, of_inputs = net.backward(net.forward(inputs) - wanted)
    step = 1e-6
    for values, gradient in [*((arrays[name], each) for name, each in zip(net.names, gradients, strict=True)),
                             (inputs, of_inputs)]:  # fmt: skip
        assert values.shape == gradient.shape
        for place in rng.integers(values.size, size=8):
            kept = values.flat[place]
            values.flat[place] = kept + step
            above = loss(net, inputs, wanted)
            values.flat[place] = kept - step
            below = loss(net, inputs, wanted)
            values.flat[place] = kept
            assert gradient.flat[place] == pytest.approx((above - below) / (2 * step), abs=1e-6)


def test_a_net_follows_another_by_a_share() -> None:
    rng, arrays = np.random.default_rng(0), {}
    net = TrainedNet.begin(arrays, "net", (3, 2, 1), rng)
    slow = net.copy_to("slow_net")
    arrays["net.offsets1"] += 1.0
    slow.follow(net, 0.25)
    assert arrays["slow_net.offsets1"] == pytest.approx([0.25])
    assert arrays["slow_net.matrix0"] == pytest.approx(arrays["net.matrix0"])


def test_the_actor_finds_the_action_that_earns_most() -> None:
    """Here the one that equals half of what is seen."""
    rng, state = np.random.default_rng(1), {}
    learner = ActorCritic.begin(state, 1, rng)
    for number in range(600):
        seen = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        done = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        later = rng.uniform(-1.0, 1.0, (64, 1)).astype(np.float32)
        learner.update(Transitions(seen, done, -np.abs(done - seen / 2), later), number, 3e-3, rng)
    seen = np.linspace(-0.9, 0.9, 7, dtype=np.float32)[:, None]
    assert learner.act(seen) == pytest.approx(seen / 2, abs=0.15)
