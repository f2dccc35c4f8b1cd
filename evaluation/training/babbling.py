"""Random exposures, from which a net sees what frames look like around and far from the right level."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from autoexpose_daemon.control.policies.learned.learned_policy import LearnedPolicy, Sight
from evaluation.training.episode import Episode
from imaging.exposure import ExposureSetting

FAR_STOPS = 7.0
"""Furthest from the right level."""

NEW_CHANCE = 0.25
"""Of another distance in a frame; otherwise it shrinks by half, stays, or wanders a little."""


def babbled_levels(right: Sequence[float], rng: np.random.Generator) -> list[float]:
    """A level for each frame (stops), given the right ones: held, near, far, and coming nearer, at random."""
    apart, level, levels = float(rng.uniform(-FAR_STOPS, FAR_STOPS)), right[0], []
    for wanted in right:
        chance = float(rng.random())
        if chance < NEW_CHANCE:
            apart = float(rng.uniform(-FAR_STOPS, FAR_STOPS)) * float(rng.random())
            level = wanted + apart
        elif chance < 0.5:
            apart /= 2
            level = wanted + apart
        elif chance < 0.6:
            level += float(rng.normal(0.0, 0.3))
        levels.append(level)
    return levels


def sights_of(policy: type[LearnedPolicy], episode: Episode, settings: Sequence[ExposureSetting]) -> list[Sight]:
    """What a policy remembers of each frame of an episode, taken with these settings."""
    return [
        Sight("left", setting.level, policy.features(episode.look(frame, setting)))
        for frame, setting in enumerate(settings)
    ]
