"""What the demo keeps of each control step: numbers from every frame, and a small picture now and then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from autoexpose_daemon.control.decision import Decision
from autoexpose_daemon.control.picture.image import Shrinking
from imaging.exposure import ExposureSetting
from imaging.frames import StereoPair

_PICTURE_WIDTH = 180


@dataclass(frozen=True, slots=True)
class StepRecord:
    """One control step: when and how the left frame was taken, what of it is lost, and the decision."""

    trigger: int
    host_time_ns: int
    applied: ExposureSetting
    decided_level: float
    saturated_share: float
    black_share: float
    reason: str


class StepLog:
    """Observes the daemon's steps.

    Attributes
    ----------
    steps
        One for each decision.
    pairs_ns
        When the left frames of all complete pairs were taken, decided on or not (CLOCK_MONOTONIC).
    pictures
        Small pictures from the left camera, each with its time.
    """

    def __init__(self, picture_period_s: float) -> None:
        self.steps: list[StepRecord] = []
        self.pairs_ns: list[int] = []
        self.pictures: list[tuple[int, NDArray[np.uint8]]] = []
        self._picture_period_ns = picture_period_s * 1e9

    def __call__(self, pair: StereoPair, decision: Decision | None) -> None:
        """Keep a step; a pair without a decision only counts as a pair."""
        frame = pair.reference
        if len(pair.frames) > 1:
            self.pairs_ns.append(frame.host_time_ns)
        if decision is None:
            return
        self.steps.append(
            StepRecord(
                pair.trigger,
                frame.host_time_ns,
                frame.setting,
                decision.level,
                decision.saturated_share,
                decision.black_share,
                decision.reason,
            )
        )
        if not self.pictures or frame.host_time_ns - self.pictures[-1][0] >= self._picture_period_ns:
            grey = frame.grey8()
            size = (_PICTURE_WIDTH, round(grey.shape[0] * _PICTURE_WIDTH / grey.shape[1]))
            self.pictures.append((frame.host_time_ns, Shrinking(grey.shape, size).shrink(grey)))
