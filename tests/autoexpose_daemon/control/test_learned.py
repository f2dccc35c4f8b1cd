"""The learned policies: what their nets see, when these are not asked, and how they behave in closed loop."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.loop import ControlLoop
from autoexpose_daemon.control.policies.ids import LEARNED
from autoexpose_daemon.control.policies.learned import net as net_module
from autoexpose_daemon.control.policies.learned.features import BINS, grey_histogram, light_histogram, region_figures
from autoexpose_daemon.control.policies.learned.net import Net, trained_net
from autoexpose_daemon.control.policies.learned.policies import HOLD_STOPS, STEADY_SHARE, LearnedPolicy
from autoexpose_daemon.control.policies.table import build_policy
from autoexpose_daemon.control.policy import Look, Observation
from autoexpose_daemon.control.setup import ControlSetup
from autoexpose_daemon.demo.reference_step import ReferenceStep, synthetic_frames
from imaging.errors import ConfigurationError
from imaging.exposure import ExposureSetting
from imaging.response import ResponseFunction

from .scene import LIMITS, LINEAR, NOTHING_GIVEN, START, expose, radiance, run

SHAPE = (68, 90)


def look_at(image: NDArray[np.uint8], weights: NDArray[np.uint8] | None = None, black: int = 0) -> Look:
    return Look("left", image, ResponseFunction.linear(black), weights)


def observe(image: NDArray[np.uint8], setting: ExposureSetting = START) -> Observation:
    black, white = (float((image == grey).mean()) for grey in (0, 255))
    return Observation([look_at(image)], setting, 0.1, white, black, 0.0, LIMITS, NOTHING_GIVEN)


def built(policy_id: str) -> LearnedPolicy:
    policy = build_policy(ControlSetup(policy_id, {"left": LINEAR}, LIMITS, START))
    assert isinstance(policy, LearnedPolicy)
    return policy


def view(stops_from_half_scale: float, seed: int = 0) -> NDArray[np.uint8]:
    return expose(radiance(seed, 0.7, SHAPE), START, START.level - stops_from_half_scale).grey8()


def answering(policy: LearnedPolicy, answers: list[float]) -> LearnedPolicy:
    """The policy with a net that gives these answers in turn, whatever it sees."""
    given = iter(answers)
    furthest = replace(policy.net.learnt, furthest=np.inf)

    class Given(Net):
        def __call__(self, inputs: NDArray[np.float64]) -> float:
            return next(given)

    policy.net = Given(policy.net.layers, policy.net.activation, furthest)
    return policy


def test_a_histogram_has_bins_for_the_dark_and_one_for_the_saturated() -> None:
    image = np.full(SHAPE, 255, np.uint8)
    image[:34] = 10
    image[:17] = 2
    shares = grey_histogram(look_at(image))
    assert shares.shape == (BINS,) and shares.sum() == pytest.approx(1.0)
    assert shares[-1] == 0.5 and sorted(shares[shares > 0]) == [0.25, 0.25, 0.5]
    assert np.argmax(grey_histogram(look_at(image[:17], black=16))) == 0
    assert np.flatnonzero(grey_histogram(look_at(np.full(SHAPE, 251, np.uint8)))) == [BINS - 2]


def test_light_is_counted_alike_whatever_the_response() -> None:
    image = view(-2)
    power = np.interp(np.arange(256.0).clip(0.5), 255 * np.linspace(0, 1, 9999) ** 0.5, np.linspace(0, 1, 9999))
    response = ResponseFunction(np.log2(power / power[-1]), 0, 255)
    seen = np.rint(255 * (image / 255.0) ** 0.5).astype(np.uint8)
    apart = light_histogram(Look("left", seen, response)) - grey_histogram(look_at(image))
    assert np.abs(np.cumsum(apart)).max() < 0.1


def test_regions_have_means_and_shares_of_their_own() -> None:
    image = np.full(SHAPE, 51, np.uint8)
    image[:17], image[-17:] = 255, 0
    means, saturated, black = region_figures(look_at(image)).reshape(3, 4, 4)
    assert means[:, 1].tolist() == pytest.approx([1.0, 0.2, 0.2, 0.0])
    assert saturated[:, 2].tolist() == [1, 0, 0, 0] and black[:, 3].tolist() == [0, 0, 0, 1]


def test_what_does_not_count_is_not_seen() -> None:
    image, weights = np.full(SHAPE, 51, np.uint8), np.full(SHAPE, 200, np.uint8)
    image[:40, :40], weights[:40, :40] = 255, 0
    image[40:, 40:], weights[40:, 40:] = 102, 100
    means, saturated, _ = region_figures(look_at(image, weights)).reshape(3, 4, 4)
    assert saturated.max() == 0.0
    whole = float((image / 255.0 * weights).sum() / weights.sum())
    assert means[0, 0] == pytest.approx(whole) and means[3, 3] == pytest.approx(0.4) and means[0, 3] == 0.2
    assert grey_histogram(look_at(image, weights))[-1] == 0.0


@pytest.mark.parametrize("policy_id", LEARNED)
def test_black_and_white_frames_are_left_by_two_stops(policy_id: str) -> None:
    policy = built(policy_id)
    dark, white = (policy.decide(observe(np.full(SHAPE, grey, np.uint8))) for grey in (0, 255))
    assert (dark.level - START.level, dark.reason) == (2.0, "too dark for the net: two stops up")
    assert (white.level - START.level, white.reason) == (-2.0, "too bright for the net: two stops down")


@pytest.mark.parametrize("policy_id", LEARNED)
def test_what_it_never_learnt_is_left_to_the_mean(policy_id: str) -> None:
    """A level that no camera of the training had."""
    far = ExposureSetting(2e9, 0.0)
    target = built(policy_id).decide(observe(view(-1), far))
    assert target.reason.startswith("unlike what was learnt: mean ")
    assert ("below" in target.reason) == (target.level > far.level)
    assert not built(policy_id).decide(observe(view(-1))).reason.startswith("unlike")


def test_small_differences_are_approached_in_parts_and_the_smallest_are_not_followed() -> None:
    policy = answering(built("berthold2013"), [3.0, 3.0 + 0.9 * HOLD_STOPS, 2.0, -1.0])
    levels = [policy.decide(observe(view(-1))).level - START.level for _ in range(4)]
    assert levels == pytest.approx([3.0, 3.0, 3.0 - STEADY_SHARE, -1.0])


def test_an_answer_is_rounded_so_that_its_last_bits_decide_nothing() -> None:
    targets = {answering(built("tomasi2021"), [0.5 + bits]).decide(observe(view(0))).level for bits in (0.0, 1e-9)}
    assert len(targets) == 1


def test_zhang_moves_by_two_stops_at_most() -> None:
    levels = [answering(built("zhang2024"), [out]).decide(observe(view(0))).level for out in (-50.0, 0.5, 50.0)]
    assert np.subtract(levels, START.level).tolist() == pytest.approx([-2.0, 2 * np.tanh(0.5), 2.0], abs=0.01)


def test_frames_of_another_camera_are_not_taken_for_earlier_ones() -> None:
    policy = built("zhang2024")
    for _ in range(5):
        policy.decide(observe(view(0)))
    assert len(policy.past) == 4
    policy.decide(replace(observe(view(0)), looks=[replace(look_at(view(1)), camera="right")]))
    assert [sight.camera for sight in policy.past] == ["right"]


@pytest.mark.parametrize("delay", [1, 3])
@pytest.mark.parametrize("policy_id", LEARNED)
def test_it_follows_the_light_and_comes_to_rest(policy_id: str, delay: int) -> None:
    decisions: list[Decision] = []
    scene = radiance(1, 0.7, SHAPE)
    loop = ControlLoop(policy_id, LINEAR, LIMITS, START)
    levels = run(loop, [10.0] * 40 + [14.0] * 60, START, scene=scene, delay=delay, watch=decisions.append)
    assert levels[-1] - levels[39] == pytest.approx(4.0, abs=0.8)
    assert np.ptp(levels[-15:]) <= 0.1
    assert all(LIMITS.contain(decision.setting) for decision in decisions)
    assert not decisions[-1].reason.startswith(("unlike", "too"))


@pytest.mark.parametrize("policy_id", LEARNED)
def test_the_decision_takes_a_small_part_of_the_literal_step(policy_id: str) -> None:
    """2 ms are half of it on the slowest machine that tests are meant for."""
    policy, literal, frames = built(policy_id), ReferenceStep(), synthetic_frames()
    seen = observe(np.ascontiguousarray(frames[0][::2, ::2]))

    def median_s(step: Callable[[], object]) -> float:
        times = []
        for _ in range(15):
            begun = time.thread_time()
            step()
            times.append(time.thread_time() - begun)
        return statistics.median(times)

    assert median_s(lambda: policy.decide(replace(seen, looks=[look_at(seen.image)]))) < 0.4 * median_s(
        lambda: literal(frames[1], frames[0])
    )


@pytest.mark.parametrize("damage", [None, b"", b"no zip at all", b"PK\x05\x06" + bytes(18)])
def test_weights_that_are_missing_or_damaged_are_named(
    damage: bytes | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if damage is not None:
        (tmp_path / "zhang2024.npz").write_bytes(damage)
    monkeypatch.setattr(net_module, "files", lambda _package: tmp_path)
    with pytest.raises(ConfigurationError, match=r"no weights of zhang2024 .*: install again, or make them with"):
        trained_net.__wrapped__("zhang2024", "relu")
